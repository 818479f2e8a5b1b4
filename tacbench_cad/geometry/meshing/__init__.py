"""Meshes of blocks from their formulas, and proved bounds of the error of these meshes."""
