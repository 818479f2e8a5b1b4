"""Definitions of textures, blocks, press grids and labels as numbers. They need NumPy only, and no geometry."""
