"""The rest position of a ball on the formula's surface: an independent check that uses values of the formula only.

A ball of radius R over (x, y) touches the surface when its centre is at ``c(x, y) = max of z(x + a, y + b) +
sqrt(R^2 - a^2 - b^2)`` over the disc ``a^2 + b^2 <= R^2``. A ball that can move sideways rests in a minimum of ``c``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats

#: Exports a texture (by number) to a target and returns the texture's folder.
Exported = Callable[[str, str], Path]
#: The ball of the tests, in mm.
BALL_MM = 0.5
#: How near to the formula's rest height a ball must come, in mm.
NEAR_MM = 0.05


def centre_height_mm(block: Block, x: float, y: float, radius_mm: float = BALL_MM, samples: int = 201) -> float:
    """Return z of the centre of a ball over (x, y) that touches the surface from above, in mm."""
    reach = math.sqrt(2.0 * radius_mm * min(radius_mm, 1.1 * block.relief_mm))
    a0, b0, half = 0.0, 0.0, min(reach, radius_mm)
    best = -math.inf
    for _ in range(4):
        a, b = (np.linspace(at - half, at + half, samples) for at in (a0, b0))
        inside = radius_mm**2 - a[:, None] ** 2 - b[None, :] ** 2
        x_at, y_at = x + a, y + b
        on = (x_at >= 0.0) & (x_at <= block.size_mm[0])
        over = (y_at >= 0.0) & (y_at <= block.size_mm[1])
        z = block.datum_mm + block.surface.grid(x_at, y_at) + np.sqrt(np.maximum(inside, 0.0))
        z[(inside < 0.0) | ~on[:, None] | ~over[None, :]] = -np.inf
        i, j = np.unravel_index(int(np.argmax(z)), z.shape)
        best, a0, b0, half = max(best, float(z[i, j])), float(a[i]), float(b[j]), half * 4.0 / samples
    return best


@cache
def valley_mm(block: Block, margin_mm: float = 4.0, radius_mm: float = BALL_MM) -> tuple[float, float, float]:
    """Return the rest position (x, y, z of the centre) of a ball in the lowest valley away from the border, in mm."""
    x, y = (np.arange(margin_mm, side - margin_mm, 0.05) for side in block.size_mm)
    z = block.surface.grid(x, y)
    i, j = np.unravel_index(int(np.argmin(z)), z.shape)
    return settled_mm(block, float(x[i]), float(y[j]), radius_mm)


def settled_mm(block: Block, x: float, y: float, radius_mm: float = BALL_MM) -> tuple[float, float, float]:
    """Return the rest position that a ball reaches downhill from (x, y), in mm."""
    step, best = 0.1, centre_height_mm(block, x, y, radius_mm)
    while step > 5e-4:
        tries = [(x + step * a, y + step * b) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        heights = [centre_height_mm(block, *place, radius_mm) for place in tries]
        k = int(np.argmin(heights))
        if heights[k] < best - 1e-9:
            (x, y), best = tries[k], heights[k]
        else:
            step /= 2.0
    return x, y, best


def places_mm(block: Block, count: int = 300, seed: int = 6) -> Floats:
    """Return random places (x, y) on the block, away from its borders, in mm, shape (count, 2)."""
    high = np.array(block.size_mm) - 0.2
    return np.random.default_rng(seed).uniform(0.2, high, (count, 2))


def steel_kg(radius_mm: float) -> float:
    """Return the mass of a steel ball, in kg."""
    return 7800.0 * 4.0 / 3.0 * math.pi * (radius_mm / 1e3) ** 3
