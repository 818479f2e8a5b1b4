"""The 3D page: what it shows (scene) and how it is written (page)."""
