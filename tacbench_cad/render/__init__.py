"""Modules that make images: shaded pictures, plots, dimension drawings and the 3D page."""
