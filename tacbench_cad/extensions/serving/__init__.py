"""Pages that the program serves to a browser."""
