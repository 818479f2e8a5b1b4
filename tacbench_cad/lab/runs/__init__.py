"""Run folders. A run is one pass of the protocol over one printed block, stored in the layout of TacTip toolchains."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
