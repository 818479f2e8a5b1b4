"""What a sensor can tell apart: protocols, splits, accuracies."""
