"""Colours of signed deviations: blue below the formula, white on it, red above it."""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.util.types import Bytes, Floats

#: The name of matplotlib's map with the same colours.
MAP = "RdBu_r"
#: The colours from the largest negative to the largest positive deviation, evenly spaced.
_ANCHORS = np.array(
    [(5, 48, 97), (67, 147, 195), (209, 229, 240), (247, 247, 247), (253, 219, 199), (214, 96, 77), (103, 0, 31)],
    dtype=np.float64,
)
#: The fraction of the deviations that lie within the scale.
_SHOWN = 0.99


def reach_mm(deviation_mm: Floats) -> float:
    """Return a round number that 99 % of the deviations do not exceed, as the end of a symmetric colour scale."""
    sizes = np.abs(deviation_mm[np.isfinite(deviation_mm)])
    largest = float(np.quantile(sizes, _SHOWN)) if len(sizes) else 0.0
    if largest <= 0.0:
        return 0.001
    power = 10.0 ** math.floor(math.log10(largest))
    return next(step * power for step in (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0) if step * power >= largest)


def coloured(deviation_mm: Floats, reach: float) -> Bytes:
    """Return a colour for each deviation, shape (n, 3).

    Args:
        deviation_mm: The deviations, shape (n,).
        reach: The deviation with the strongest colour.
    """
    at = np.clip(deviation_mm / reach, -1.0, 1.0) * 0.5 + 0.5
    places = np.linspace(0.0, 1.0, len(_ANCHORS))
    return np.column_stack([np.interp(at, places, channel) for channel in _ANCHORS.T]).round().astype(np.uint8)
