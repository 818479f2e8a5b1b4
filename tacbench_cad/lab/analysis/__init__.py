"""What the runs of a study say: how well printers print, and what a sensor can tell apart."""
