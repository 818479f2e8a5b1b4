"""Modules that make images: shaded pictures, plots and the 3D page."""
