"""Meshes and solids of parts, each with proved bounds of its error."""
