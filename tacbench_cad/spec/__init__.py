"""What a thing is, in numbers: textures, blocks, press grids, labels. NumPy only, no geometry."""
