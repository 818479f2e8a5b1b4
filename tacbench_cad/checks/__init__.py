"""The checks of part files: verification of a file for a known part, and identification of any file."""
