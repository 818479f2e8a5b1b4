"""Definitions of textures, blocks, press grids and labels as numbers. They need NumPy only, and no geometry.

Import the names from this module. Each name is loaded when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
