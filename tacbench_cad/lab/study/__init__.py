"""The description of a study: the blocks, the protocol and the rig, and the file that they are read from."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
