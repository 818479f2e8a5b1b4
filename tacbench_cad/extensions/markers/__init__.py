"""The markers of a tactile sensor in its frames, and their displacements as features of presses."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
