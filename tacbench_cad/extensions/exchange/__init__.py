"""Exchange of runs with other tools: their formats, data sets of others, and publication."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
