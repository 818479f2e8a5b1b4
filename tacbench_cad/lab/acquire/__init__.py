"""Pressing of blocks: one press, one block, a whole study, and the protection of sensor and block."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
