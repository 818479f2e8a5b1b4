"""Plates for printers, and what a slicer makes of a block: its G-code compared with the formula."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
