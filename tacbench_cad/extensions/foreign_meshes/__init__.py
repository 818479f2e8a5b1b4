"""Textures on regions of meshes that other programs made."""
