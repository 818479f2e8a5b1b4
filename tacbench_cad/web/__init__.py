"""Pages that the program serves to the browser of the same machine."""
