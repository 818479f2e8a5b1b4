"""Drivers of the devices of a rig: stages, force gauges and sensors, each with a small interface."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
