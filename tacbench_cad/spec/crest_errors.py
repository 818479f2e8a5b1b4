"""Lost crests and filled valleys: the errors of a printed surface at the peaks and valleys of its formula."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tacbench_cad.util.convert import NOT_STORED
from tacbench_cad.util.types import Bools, Floats

#: The largest horizontal distance between a peak or valley of the formula and its printed extremum, in mm.
NEAR_MM = 0.15


@dataclass(frozen=True, kw_only=True)
class Extrema:
    """The errors of all peaks or of all valleys.

    Args:
        count: The number of peaks or valleys of the formula, without the edge and without those that were not seen.
        missed: The number of peaks that are too low, or valleys that are too high, by more than one layer.
        mean_mm: The mean error; positive if peaks are too low or valleys too high.
        worst_mm: The largest error.
        missed_mm: The positions of the missed peaks or valleys in the block frame, shape (k, 2).
    """

    count: int
    missed: int
    mean_mm: float
    worst_mm: float
    missed_mm: Floats = field(metadata=NOT_STORED)


def peaks(
    formula_mm: Floats, printed_mm: Floats, inside: Bools, x_mm: Floats, y_mm: Floats, layer_mm: float
) -> Extrema:
    """Return the errors at the local maxima of a formula. A ridge counts as one maximum.

    Args:
        formula_mm: The heights of the formula, shape (n, m).
        printed_mm: The heights of the print, shape (n, m); NaN where they are unknown.
        inside: Whether a point is compared, shape (n, m).
        x_mm: The x coordinates of the grid, evenly spaced, shape (n,).
        y_mm: The y coordinates of the grid, shape (m,).
        layer_mm: The error from which a peak counts as missed: the height of a layer.
    """
    from scipy import ndimage

    # A texture that varies along one axis only has equal heights along its ridges, except for rounding.
    highest = formula_mm >= ndimage.maximum_filter(formula_mm, size=3) - 1e-9
    radius = max(1, round(NEAR_MM / (x_mm[1] - x_mm[0])))
    known = np.where(np.isnan(printed_mm), -np.inf, printed_mm)
    short = formula_mm - ndimage.maximum_filter(known, size=2 * radius + 1)
    labels, _ = ndimage.label(highest & inside, structure=np.ones((3, 3)))
    seen = (labels > 0) & np.isfinite(short)
    each = np.unique(labels[seen])
    if len(each) == 0:
        return Extrema(count=0, missed=0, mean_mm=0.0, worst_mm=0.0, missed_mm=np.zeros((0, 2)))
    errors = np.asarray(ndimage.mean(short, np.where(seen, labels, 0), each))
    missed = errors > layer_mm
    middles = np.array(ndimage.center_of_mass(labels > 0, labels, each)).astype(int).reshape(-1, 2)[missed]
    return Extrema(
        count=len(each),
        missed=int(missed.sum()),
        mean_mm=float(errors.mean()),
        worst_mm=float(errors.max()),
        missed_mm=np.column_stack([x_mm[middles[:, 0]], y_mm[middles[:, 1]]]),
    )


def valleys(
    formula_mm: Floats, printed_mm: Floats, inside: Bools, x_mm: Floats, y_mm: Floats, layer_mm: float
) -> Extrema:
    """Return the errors at the local minima of a formula; see :func:`peaks`."""
    return peaks(-formula_mm, -printed_mm, inside, x_mm, y_mm, layer_mm)
