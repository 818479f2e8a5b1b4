"""Everything that makes an image: shaded pictures, plots, dimension drawings, the 3D page."""
