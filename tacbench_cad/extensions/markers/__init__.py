"""The region of the sensor in a camera's frame, and the positions of the sensor's markers."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
