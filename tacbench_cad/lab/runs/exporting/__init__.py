"""Runs as other tools read them: a module for each format, one list of formats, one description of the columns."""
