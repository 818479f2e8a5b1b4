"""The fixtures of frames from other software."""

from helpers.import_fixtures import images, noise, table

__all__ = ["images", "noise", "table"]
