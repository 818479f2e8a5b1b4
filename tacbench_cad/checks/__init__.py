"""The checks of part files: verification of a file for a known part, and identification of any file."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
