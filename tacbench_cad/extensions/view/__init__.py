"""The page that shows parts in 3D."""
