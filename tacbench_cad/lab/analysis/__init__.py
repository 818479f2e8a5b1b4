"""The analysis of a study: how repeatable the prints are, and which textures a sensor can tell apart."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
