"""The analysis of a study: how repeatable the prints are, and which textures a sensor can tell apart."""
