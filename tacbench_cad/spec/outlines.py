"""The area of closed outlines in the plane, and whether a point lies inside them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from tacbench_cad.util.types import Floats


def area_mm2(*outlines: Floats) -> float:
    """Return the area of closed outlines (n, 2), in mm^2. The area of a clockwise outline is subtracted."""
    total = 0.0
    for outline in outlines:
        x, y = outline.T
        total += float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0
    return total


def is_inside(point: Floats, outlines: Iterable[Floats]) -> bool:
    """Whether a point (2,) lies inside closed outlines, by the even-odd rule."""
    crossings = 0
    for outline in outlines:
        a, b = outline, np.roll(outline, -1, axis=0)
        spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
        a, b = a[spans], b[spans]
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        crossings += int(np.count_nonzero(x > point[0]))
    return crossings % 2 == 1
