"""Export of runs for other tools. There is one module for each format, a list of formats, and a list of columns."""
