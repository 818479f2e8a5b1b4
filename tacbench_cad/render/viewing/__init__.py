"""The 3D page: its content (scene) and its file (page)."""
