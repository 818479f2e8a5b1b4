"""The 3-D page: what it shows (scene) and how it is written (page)."""
