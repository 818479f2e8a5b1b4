"""Import of other people's data as run folders. There is one module for each kind of source."""
