"""Printable tactile texture blocks from formulas, with their fixtures, press protocol and checks."""

__version__ = "0.1.0"
