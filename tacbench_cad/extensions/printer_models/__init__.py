"""Models of printers, computed from scans of their prints, and the corrections that follow from them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
