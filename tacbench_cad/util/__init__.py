"""Tools that every part of the project uses: errors, input and output files, child processes, optional packages."""
