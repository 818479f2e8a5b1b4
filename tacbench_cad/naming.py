"""How numbers stand in file names and labels."""

from __future__ import annotations

import numpy as np


def decimal(value: float) -> str:
    """The shortest decimals that give the number back exactly, without an exponent: ``0.5``, ``1``, ``0.00001``."""
    return np.format_float_positional(value, trim="-")
