"""The height of a texture above a region of a face. Importing this module does not load the CAD kernel."""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.geometry.textured.field import Fade, Height
from tacbench_cad.geometry.texturing import DEPTH_RANGE_MM, Texturing
from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError, require_between

#: The material that must remain below a sunk texture, in mm.
FLOOR_MM = 0.4
#: The largest fraction by which frequencies may differ from multiples of a common one.
_COMMON = 1e-6
#: The fraction of a side by which a height map may be smaller.
_NEAR = 1e-9
#: The largest multiple of the common frequency that the lowest frequency may have.
_MAX_MULTIPLE = 12


def height_over(
    size_mm: tuple[float, float], is_closed: bool, texturing: Texturing, fade: Fade
) -> tuple[Height, tuple[float, float], int | None]:
    """Return the height of a texture above a region.

    Args:
        size_mm: The extents of the region along s and t.
        is_closed: Whether the region goes all the way around a cylinder.
        texturing: The settings.
        fade: How the texture ends.

    Returns:
        The height, the millimetres per unit of u and v, and the number of periods around a closed cylinder.

    Raises:
        InputError: The texture is flat over the region, or cannot close around the cylinder.
    """
    formula = texturing.texture.surface
    unit = texturing.unit_mm
    periods = None
    if is_closed:
        unit, periods = _closing(formula, unit, size_mm[0])
    s, t = size_mm
    placed = formula.mapped(unit, 1.0, texturing.origin_uv)
    _require_known(placed, size_mm, texturing.texture.name)
    surface = placed.over((0.0, s), (0.0, t))
    extremes = surface.extremes((0.0, s), (0.0, t))
    if extremes.high - extremes.low < 1e-9:
        raise InputError(
            "texture", texturing.texture.name, "is flat over this face; choose another texture or direction"
        )
    factor = texturing.factor(extremes.high - extremes.low)
    require_between("depth_mm", factor * (extremes.high - extremes.low), *DEPTH_RANGE_MM, " mm")
    start, zero = (-texturing.base_mm, extremes.high) if texturing.sunk else (texturing.base_mm, extremes.low)
    height = Height(
        surface=surface,
        start_mm=start,
        zero_mm=zero,
        far_mm=extremes.low if texturing.sunk else extremes.high,
        factor=factor,
        fade=fade,
        size_mm=size_mm,
    )
    return height, unit, periods


def around(texturing: Texturing, mm_per_unit: tuple[float, float], periods: int | None) -> str:
    """Return the number of periods around a cylinder in words, and how much they were stretched to close around it."""
    if periods is None:
        return ""
    stretch = mm_per_unit[0] / texturing.unit_mm[0] - 1.0
    return f", {periods} periods around it, stretched by {100.0 * stretch:+.2g} % to close"


def _require_known(surface: Surface, size_mm: tuple[float, float], name: str) -> None:
    """Check that a height map covers a region.

    Raises:
        InputError: It does not.
    """
    if not isinstance(surface, SplineSurface):
        return
    for axis, size, side in zip((surface.u, surface.v), size_mm, "xy", strict=True):
        low, high = axis.ends
        if not axis.repeats and (low > _NEAR * size or high < (1.0 - _NEAR) * size):
            covered = f"covers {low:.4g} to {high:.4g} mm along {side}, but the textured region {size:.4g} mm"
            raise InputError("texture", name, f"{covered}; choose a larger margin_mm, or let the texture repeat")


def _closing(surface: Surface, unit: tuple[float, float], around_mm: float) -> tuple[tuple[float, float], int | None]:
    """Return the millimetres per unit with which a texture closes around a cylinder, and its number of periods."""
    period = _period(surface)
    if period is None:
        return unit, None
    periods = max(1, round(around_mm / (unit[0] * period)))
    return (around_mm / (period * periods), unit[1]), periods


def _period(surface: Surface) -> float | None:
    """Return the period of a texture along u, in units; None if it does not depend on u."""
    if isinstance(surface, SplineSurface) and surface.u.repeats:
        low, high = surface.u.ends
        return high - low
    if isinstance(surface, WaveSum):
        frequencies = np.unique(np.abs(surface.table[surface.table[:, 0] != 0.0, 1]))
        frequencies = frequencies[frequencies > 0.0]
        if len(frequencies) == 0:
            return None
        for divisor in range(1, _MAX_MULTIPLE + 1):
            common = float(frequencies[0]) / divisor
            multiples = frequencies / common
            if np.all(np.abs(multiples - np.round(multiples)) < _COMMON * multiples):
                return 2.0 * math.pi / common
    raise InputError("texture", None, "has no period along x, so it cannot close around a cylinder")


def require_fade(length_mm: float, size_mm: tuple[float, float], is_closed: bool) -> None:
    """Check that the texture can fade out from both ends of a region.

    Raises:
        InputError: The fade is longer than half of the region.
    """
    shorter = size_mm[1] if is_closed else min(size_mm)
    if 2.0 * length_mm > shorter:
        raise InputError("fade_mm", length_mm, f"must be at most {shorter / 2.0:.4g} mm, half of the textured region")
