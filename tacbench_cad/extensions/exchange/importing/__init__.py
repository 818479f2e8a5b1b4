"""Formats that ``tacbench import-frames`` reads beside images and arrays. There is one module for each."""
