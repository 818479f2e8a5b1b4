"""The error of the kernel's default area of a patch, computed before the patch exists.

For areas and volumes, Open CASCADE uses Gauss' rule. The number of points along each axis of a face follows from its
degree and its knots, but is at most :data:`KERNEL_POINTS`. The area of steep waves needs many points. This module
applies the kernel's rule to the formula, so that a block can be divided into patches whose areas are correct.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
from numpy.polynomial.legendre import leggauss

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.types import Floats

#: The largest number of Gauss points along an axis of a face for the kernel's default area and volume.
KERNEL_POINTS = 61
#: The largest number of patches along an axis for which the error is computed.
_MAX_PATCHES = 14
#: The number of rows of points in one array operation.
_ROWS_AT_A_TIME = 64


def wave_table(surface: Surface) -> Floats:
    """Return the plane waves of a surface as rows ``amplitude, f, g, phase``, shape (n, 4)."""
    waves = surface.plane_waves or ()
    return np.array([(w.amplitude, w.f, w.g, w.phase) for w in waves], dtype=np.float64).reshape(-1, 4)


def area_error(block: Block, patches: tuple[int, int]) -> float:
    """Return the error of the top's area by the kernel's rule, relative to the area of the whole block.

    The reference is the area with twice as many patches along each axis. For a large block, only the corner of the top
    at the origin is used.

    Args:
        block: The block.
        patches: The numbers of patches along x and y.
    """
    surface = block.surface
    areas = []
    for more in (1, 2):
        taken = [min(count, _MAX_PATCHES) for count in patches]
        ends = [side * few / count for side, few, count in zip(block.size_mm, taken, patches, strict=True)]
        (x, weight_x), (y, weight_y) = (_gauss(end, more * few) for end, few in zip(ends, taken, strict=True))
        areas.append(sum(float(np.dot(weight_x[rows], area)) for rows, area in _strips(surface, x, y, weight_y)))
    (x_side, y_side), flat = block.size_mm, ends[0] * ends[1]
    rest = (x_side * y_side + 2.0 * (x_side + y_side) * block.solid_datum_mm) * flat / (x_side * y_side)
    return abs(areas[0] - areas[1]) / (areas[1] + rest)


def _strips(surface: Surface, x: Floats, y: Floats, weight_y: Floats) -> Iterator[tuple[slice, Floats]]:
    """Integrate ``sqrt(1 + |gradient|^2)`` along y at each x, for some rows at a time, which fit into the cache.

    The calculation uses single precision and no threads, because an accuracy of 1e-5 is enough, and because it takes
    only milliseconds.
    """
    amplitude, f, g, phase = wave_table(surface).T
    weights = weight_y.astype(np.float32)
    separable = surface.is_separable
    squares_x = (surface.along_u(x, 1) ** 2 + 1.0).astype(np.float32) if separable else None
    squares_y = (surface.along_v(y, 1) ** 2).astype(np.float32) if separable else None
    along_y = None if separable else np.exp(1j * np.outer(g, y))
    for start in range(0, len(x), _ROWS_AT_A_TIME):
        rows = slice(start, start + _ROWS_AT_A_TIME)
        if squares_x is not None and squares_y is not None:
            stretch = np.add.outer(squares_x[rows], squares_y)
        else:
            along_x = np.exp(1j * (np.outer(x[rows], f) + phase)) * amplitude
            slopes = [np.real((along_x * k) @ along_y).astype(np.float32) for k in (f, g)]
            stretch = slopes[0] ** 2 + slopes[1] ** 2 + np.float32(1.0)
        np.sqrt(stretch, out=stretch)
        yield rows, np.einsum("ij,j->i", stretch, weights).astype(np.float64)


def _gauss(length: float, patches: int) -> tuple[Floats, Floats]:
    """Return the points and weights of Gauss' rule with :data:`KERNEL_POINTS` points on each patch of [0, length]."""
    points, weights = _rule()
    width = length / patches
    places = (np.arange(patches)[:, None] + (points + 1.0) / 2.0) * width
    return places.ravel(), np.tile(weights * width / 2.0, patches)


@cache
def _rule() -> tuple[Floats, Floats]:
    points, weights = leggauss(KERNEL_POINTS)
    return points, weights
