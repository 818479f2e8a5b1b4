"""The steps from the options of ``tacbench make`` to checked files in a folder."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
