"""Import of anybody's data as run folders: a module for each kind of source, one for columns, one for groups."""
