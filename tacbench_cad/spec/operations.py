"""Operations on surfaces: sum, scale, turn, window, mask. They are methods of every surface.

Where the result is exactly a sum of waves or a spline, it is calculated exactly. Otherwise the result is sampled, and
its error is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tacbench_cad.spec.interpolation import sampled
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.spec.surface import Domain, Surface, Unit
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The error of a sampled result, as a fraction of the bound of its height.
SAMPLED_FRACTION = 1e-4
#: Two lines that are nearer than this fraction of the domain are the same line.
_SAME_LINE = 1e-6


def scaled(surface: Surface, factor: float) -> Surface:
    """Return a surface with its height multiplied by a factor."""
    if not math.isfinite(factor):
        raise InputError("factor", factor, "must be a finite number")
    return surface.mapped((1.0, 1.0), factor)


def added(surfaces: Sequence[Surface], domain: Domain | None = None) -> Surface:
    """Return the sum of surfaces.

    The sum of waves is a sum of waves. Splines with the same domain are added exactly. Anything else is sampled.

    Args:
        surfaces: The surfaces, all with the same unit.
        domain: The domain of a sampled sum; None for the common domain of the splines.

    Raises:
        InputError: Some surfaces are in mm and others in units, or the domain is missing.
    """
    common_unit(surfaces)
    waves = [surface.plane_waves for surface in surfaces]
    if None not in waves:
        return WaveSum(tuple(wave for each in waves for wave in each or ()), common_unit(surfaces))
    splines = [surface.spline for surface in surfaces if surface.spline is not None]
    domains = {(spline.u.ends, spline.v.ends, spline.u.repeats, spline.v.repeats) for spline in splines}
    if len(splines) == len(surfaces) and len(domains) == 1:
        total = splines[0]
        for spline in splines[1:]:
            total = _sum(total, spline)
        return total
    return _sampled(lambda u, v: sum((each(u, v) for each in surfaces), np.zeros(1)), surfaces, domain)


def turned(surface: Surface, angle_deg: float, domain: Domain | None = None) -> Surface:
    """Return a surface that is turned counter-clockwise about the origin.

    Args:
        surface: The surface.
        angle_deg: The angle in degrees.
        domain: The domain of the result, if the surface is a spline that repeats.
    """
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    if surface.plane_waves is not None:
        waves = (
            Wave(amplitude=w.amplitude, f=c * w.f - s * w.g, g=s * w.f + c * w.g, phase=w.phase)
            for w in surface.plane_waves
        )
        return WaveSum(tuple(waves), surface.unit)
    if surface.ends != (None, None):
        raise InputError("turn", angle_deg, "a height map can only be turned if it repeats along both sides")
    return _sampled(lambda u, v: surface(c * u + s * v, c * v - s * u), [surface], domain)


def windowed(surface: Surface, margin: float | tuple[float, float], domain: Domain | None = None) -> Surface:
    """Return a surface that fades out to the height 0 towards the edges of a domain.

    Args:
        surface: The surface.
        margin: The width over which it fades, along u and v, in the unit of the surface.
        domain: The domain; None for the domain of a spline.
    """
    (u0, u1), (v0, v1) = _domain([surface], domain)
    along_u, along_v = (margin, margin) if isinstance(margin, (int, float)) else margin
    for width, low, high in ((along_u, u0, u1), (along_v, v0, v1)):
        if not 0.0 < 2.0 * width <= high - low:
            raise InputError("margin", margin, f"must be above 0 and at most half of the length {high - low:g}")
    lines = ([u0 + along_u, u1 - along_u], [v0 + along_v, v1 - along_v])

    def fade(t: Floats, low: float, high: float, width: float) -> Floats:
        s = np.clip(np.minimum(t - low, high - t) / width, 0.0, 1.0)
        return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))

    def window(u: Floats, v: Floats) -> Floats:
        return np.asarray(surface(u, v) * fade(u, u0, u1, along_u) * fade(v, v0, v1, along_v))

    return _sampled(window, [surface], ((u0, u1), (v0, v1)), lines)


def masked(surface: Surface, mask: Callable[[Floats, Floats], Floats], domain: Domain | None = None) -> Surface:
    """Return a surface multiplied by a mask.

    Args:
        surface: The surface.
        mask: A function of u and v with values from 0 to 1. It must be continuous.
        domain: The domain; None for the domain of a spline.
    """
    return _sampled(lambda u, v: surface(u, v) * mask(u, v), [surface], domain)


def as_spline(surface: Surface, error: float) -> SplineSurface:
    """Return a spline through a surface, or the surface itself if it is a spline.

    Args:
        surface: The surface.
        error: The largest allowed distance of the spline from the surface.

    Raises:
        InputError: The surface has no ends, or needs too many samples.
    """
    if surface.spline is not None:
        return surface.spline
    u, v = surface.ends
    if u is None or v is None:
        allowed = "has no ends, so no spline can be made of it; window it, or use Texture.from_function"
        raise InputError("surface", str(surface), allowed)
    lines = surface.creases[0].tolist(), surface.creases[1].tolist()
    spline = sampled(surface, u=u, v=v, error=error, creases=lines, unit=surface.unit)
    return replace(spline, error=spline.error + surface.error)


def _sum(first: SplineSurface, second: SplineSurface) -> SplineSurface:
    """Return the exact sum of splines with the same domain, by inserting the knots of each into the other."""
    poles, axes = [first.poles, second.poles], []
    for which in (0, 1):
        pair = [(first.u, second.u), (first.v, second.v)][which]
        if pair[0].degree != pair[1].degree:
            raise InputError("sum", None, "splines of different degrees cannot be added")
        turned_poles = [np.moveaxis(each, which, 0) for each in poles]
        for mine, other in ((0, 1), (1, 0)):
            for at in pair[other].breaks[1:-1].tolist():
                times = int(np.count_nonzero(np.abs(pair[other].knots - at) <= 1e-12 * abs(pair[other].ends[1])))
                axis, turned_poles[mine] = pair[mine].inserted(turned_poles[mine], at, times)
                pair = (axis, pair[1]) if mine == 0 else (pair[0], axis)
        poles = [np.moveaxis(each, 0, which) for each in turned_poles]
        axes.append(SplineAxis(pair[0].knots, pair[0].degree, pair[0].repeats))
    evidence = first.evidence if second.evidence == "proved" else second.evidence
    error = first.error + second.error
    return replace(first, u=axes[0], v=axes[1], poles=poles[0] + poles[1], error=error, evidence=evidence)


def common_unit(surfaces: Sequence[Surface]) -> Unit:
    """Return the unit of surfaces.

    Raises:
        InputError: Some are in mm and others in units.
    """
    units = {surface.unit for surface in surfaces}
    if len(units) > 1:
        allowed = 'some are in mm and others in units; bring them to mm with mapped((x, y), z, unit="mm")'
        raise InputError("surfaces", None, allowed)
    return units.pop() if units else "units"


def _domain(surfaces: Sequence[Surface], domain: Domain | None) -> Domain:
    """Return the given domain, or the common part of those of the surfaces."""
    if domain is not None:
        return domain
    ends = []
    for along in zip(*(each.ends for each in surfaces), strict=True):
        fixed = [interval for interval in along if interval is not None]
        if not fixed:
            break
        ends.append((max(low for low, _ in fixed), min(high for _, high in fixed)))
    if len(ends) < 2:
        raise InputError("domain", None, "is missing; give domain=((u low, u high), (v low, v high)) of the result")
    return ends[0], ends[1]


def _sampled(
    function: Callable[[Floats, Floats], Floats],
    surfaces: Sequence[Surface],
    domain: Domain | None,
    lines: tuple[Sequence[float], Sequence[float]] = ((), ()),
) -> SplineSurface:
    """Return a sampled function of surfaces, with their errors added to its own. Their creases are kept.

    Args:
        function: The function.
        surfaces: The surfaces that it calls.
        domain: The domain; None for the common domain of the splines.
        lines: Further lines along u and v at which the sampling must begin anew, because the function changes there.
    """
    u, v = ends = _domain(surfaces, domain)
    known = [each.over(u, v) for each in surfaces]
    creases = []
    for i, (low, high) in enumerate(ends):
        # the creases come first: of two lines at almost the same place, the second is left out
        kept = [low, high]
        for at in (*(at for each in known for at in each.creases[i].tolist()), *lines[i]):
            if min(abs(at - other) for other in kept) > _SAME_LINE * (high - low):
                kept.append(at)
        creases.append(sorted(kept[2:]))
    error = SAMPLED_FRACTION * sum(each.amplitude_sum for each in surfaces)
    result = sampled(function, u=u, v=v, error=error, creases=(creases[0], creases[1]), unit=common_unit(surfaces))
    return replace(result, error=result.error + sum(each.error for each in surfaces))
