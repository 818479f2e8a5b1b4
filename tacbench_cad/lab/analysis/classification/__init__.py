"""The classification of textures: protocols, splits, estimators and accuracies."""
