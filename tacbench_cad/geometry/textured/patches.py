"""The textured surface over the rectangle around an area, as spline patches with a bound of their error.

A wave along a face is a product of two exponentials, one along s and one along t. The same is true after it fades out
by half a period of a cosine, and after it is wound around a cylinder: a point of the cross-section is
``(R + h) exp(i s / R)``, again a sum of exponentials. So the proof of :mod:`tacbench_cad.geometry.splines.curve`
holds for all of them. A fade along any other outline is not such a sum. It is interpolated on a
grid, and its error is measured.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry.splines.curve import Axis, basis
from tacbench_cad.geometry.splines.kernelrule import wave_table
from tacbench_cad.geometry.splines.patches import AIM, DEGREE, MAX_SPANS, MIN_SPANS, WAVES_PER_PATCH, spans_needed
from tacbench_cad.geometry.textured.height import Height
from tacbench_cad.spec.spline import greville
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Complexes, Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid

#: The largest number of poles of all patches of an area.
MAX_POLES = 1_500_000
#: The spans on the length of a fade, or on the finest wave, with which the search for a grid begins.
_SPANS_AT_FIRST = 2.5
#: The largest number of spans of a sampled patch, approximately. The kernel's volume of larger patches is wrong.
_MAX_SAMPLED_SPANS = 32
#: The number of steps of the error test between two neighbouring knots.
_TEST_STEPS = 3
#: The factor of the largest measured error, because the error can be a little larger between the tested points.
_BETWEEN = 1.25

#: The poles of each patch (i, j), shape (count, count): heights on a plane, complex points on a cylinder.
Poles = dict[tuple[int, int], Floats | Complexes]


@dataclass(frozen=True, eq=False)
class PatchGrid:
    """Spline patches over the rectangle around an area.

    Args:
        height: The height of the texture.
        s: The patches along s.
        t: The patches along t.
        values: The poles.
        error_mm: The bound of the distance between the patches and the formula.
        is_proved: Whether the bound is proved; otherwise it is the largest error on a fine grid.
    """

    height: Height
    s: Axis
    t: Axis
    values: Poles
    error_mm: float
    is_proved: bool

    def solid_from(self, other_mm: float) -> TopoDS_Solid:
        """Return the solid between the patches and a constant height, in the coordinates of the part."""
        from tacbench_cad.geometry.splines.patch_solid import solid_between

        area, poles = self.height.area, {}
        for (i, j), values in self.values.items():
            s, t = self.s.abscissae_mm(i)[:, None], self.t.abscissae_mm(j)[None, :]
            flat = area.frame.radius_mm is None
            poles[i, j] = area.frame.world(s, t, np.real(values)) if flat else area.frame.world(values, t)
        above = other_mm < self.height.range_mm[0]
        return solid_between(poles, (self.s, self.t), area.frame, other_mm, is_above=above, is_closed=area.is_closed)


def patches_of(height: Height) -> PatchGrid:
    """Return patches within the tolerance of the formula.

    Raises:
        InputError: The tolerance needs too many poles.
    """
    tolerance = height.texturing.tolerance_mm
    exact = height.fading is not None and height.surface.plane_waves is not None
    axes, values, error = _exact(height, tolerance) if exact else _sampled(height, tolerance)
    closed = height.area.is_closed
    for (i, j), own in sorted(values.items()):  # neighbours get the same poles, which differ by rounding
        if i + 1 < axes[0].patches:
            values[i + 1, j][0] = own[-1]
        elif closed:
            own[-1] = values[0, j][0]
        if j + 1 < axes[1].patches:
            values[i, j + 1][:, 0] = own[:, -1]
    return PatchGrid(height, *axes, values, error, exact)


@dataclass(frozen=True, eq=False)
class _Waves:
    """A sum of exponentials ``c exp(i (f s + g t))``. On a plane, its real part is the height."""

    c: Complexes
    f: Floats
    g: Floats

    def times(self, factors: list[tuple[complex, float]], axis: int) -> _Waves:
        """Multiply by a sum of exponentials along one axis, given as pairs of coefficient and frequency."""
        c = np.concatenate([self.c * factor for factor, _ in factors])
        more = np.repeat([frequency for _, frequency in factors], len(self.c))
        f, g = np.tile(self.f, len(factors)), np.tile(self.g, len(factors))
        return _Waves(c, f + more, g) if axis == 0 else _Waves(c, f, g + more)

    def plus(self, constant: float) -> _Waves:
        """Add a constant."""
        return _Waves(np.append(self.c, constant), np.append(self.f, 0.0), np.append(self.g, 0.0))


def _exact(height: Height, tolerance_mm: float) -> tuple[tuple[Axis, Axis], Poles, float]:
    """Return the patches of a sum of waves without a fade, or with a fade towards the sides of a rectangle."""
    lines = [_lines(height, axis, count) for axis, count in enumerate(_patch_counts(height))]
    zones = [_zones(height, axis, lines[axis]) for axis in (0, 1)]
    kinds = {(a, b): _in_zone(height, (a, b)) for a in set(zones[0]) for b in set(zones[1])}
    spans = []
    for axis in (0, 1):
        widest = float(np.diff(lines[axis]).max())
        turns = [(w.c, (w.f, w.g)[axis] * widest) for w in kinds.values()]
        spans.append(max(spans_needed(turn, np.abs(c), AIM * tolerance_mm / 2.0) for c, turn in turns))
    s, t = (Axis(lines[axis], basis(DEGREE, min(spans[axis], MAX_SPANS))) for axis in (0, 1))
    _require_few(s, t, tolerance_mm, max(spans) > MAX_SPANS)
    error = max(_bound(waves, s, t) for waves in kinds.values())
    if not error <= tolerance_mm:
        raise InputError("tolerance_mm", tolerance_mm, f"is too fine; the bound of the error is {error:.2g} mm")
    values: Poles = {}
    factors = {kind: (s.poles(waves.f) * waves.c, t.poles(waves.g)) for kind, waves in kinds.items()}
    for i, a in enumerate(zones[0]):
        for j, b in enumerate(zones[1]):
            along_s, along_t = factors[a, b]
            poles = along_s[i] @ along_t[j].T
            values[i, j] = np.real(poles) if height.area.frame.radius_mm is None else poles
    return (s, t), values, error


def _patch_counts(height: Height) -> list[int]:
    """Return the numbers of patches along s and t, so that no patch has too many waves for the kernel's areas."""
    finest, least = height.surface.highest_frequency, (3 if height.area.is_closed else 1, 1)
    waves = [size * f / math.tau for size, f in zip(height.area.size_mm, finest, strict=True)]
    return [max(few, math.ceil(count / WAVES_PER_PATCH)) for few, count in zip(least, waves, strict=True)]


def _lines(height: Height, axis: int, count: int) -> Floats:
    """Return the lines between about so many patches, among them those at which a fade begins."""
    step = height.area.size_mm[axis] / count
    runs = [
        np.linspace(low, high, math.ceil((high - low) / step - 1e-9) + 1)
        for low, high in itertools.pairwise(height.breaks(axis).tolist())
    ]
    return np.unique(np.concatenate(runs))


def _zones(height: Height, axis: int, lines: Floats) -> list[int]:
    """Return for each patch whether it lies where the texture begins (-1) or ends (1) to fade, or between (0)."""
    breaks = height.breaks(axis)
    if len(breaks) == 2:
        return [0] * (len(lines) - 1)
    middles = (lines[:-1] + lines[1:]) / 2.0
    return [-1 if middle < breaks[1] else 1 if middle > breaks[-2] else 0 for middle in middles]


def _in_zone(height: Height, zones: tuple[int, int]) -> _Waves:
    """Return the exponentials in a zone of the fade."""
    table = wave_table(height.surface)
    amplitude, f, g, phase = table[table[:, 0] != 0.0].T
    result = _Waves(-1j * height.factor * amplitude * np.exp(1j * phase), f, g).plus(-height.factor * height.zero_mm)
    for axis, zone in enumerate(zones):
        if zone:
            turn = np.pi / height.fade_mm
            shift = np.exp(-1j * turn * (0.0 if zone < 0 else height.area.size_mm[axis]))
            result = result.times([(0.5, 0.0), (-0.25 * shift, turn), (-0.25 / shift, -turn)], axis)
    result = result.plus(height.start_mm)
    radius, side = height.area.frame.radius_mm, height.area.frame.side
    if radius is None:
        return result
    c = np.asarray(side / 2.0 * np.concatenate([result.c, np.conj(result.c)]), dtype=np.complex128)
    both = _Waves(c, np.concatenate([result.f, -result.f]), np.concatenate([result.g, -result.g])).plus(radius)
    return both.times([(1.0, side / radius)], 0)


def _bound(waves: _Waves, s: Axis, t: Axis) -> float:
    """Return the proved bound of the distance between patches and formula; see :func:`..splines.patches.patches`."""
    weight = np.abs(waves.c)
    both = (waves.f != 0.0) & (waves.g != 0.0)
    single, unit = np.zeros(len(weight)), np.ones(1)
    for frequency in set(waves.f[both].tolist()):
        single[both & (waves.f == frequency)] = s.error(np.array([frequency]), unit)
    rounding = 8.0 * np.finfo(float).eps * float(weight.sum())
    return float(s.error(waves.f, weight) + t.error(waves.g, weight * (1.0 + single)) + rounding)


def _sampled(height: Height, tolerance_mm: float) -> tuple[tuple[Axis, Axis], Poles, float]:
    """Return the patches of any height by interpolation on a grid. Their error is measured on a finer grid."""
    size, counts, density = height.area.size_mm, _patch_counts(height), _SPANS_AT_FIRST
    waves = [math.tau / max(f, 1e-9) for f in height.surface.highest_frequency]
    finest = [min(size[k], waves[k], height.fade_mm or math.inf) for k in (0, 1)]
    while True:
        need = [math.ceil(size[k] / finest[k] * density / _MAX_SAMPLED_SPANS) for k in (0, 1)]
        lines = [_lines(height, k, max(counts[k], need[k])) for k in (0, 1)]
        spans = [max(MIN_SPANS, math.ceil(np.diff(lines[k]).max() / finest[k] * density)) for k in (0, 1)]
        s, t = (Axis(lines[k], basis(DEGREE, spans[k])) for k in (0, 1))
        _require_few(s, t, tolerance_mm, False)
        values, error = _interpolated(height, (s, t))
        if error <= AIM * tolerance_mm:
            return (s, t), values, error
        density *= min(2.5, max(1.15, (error / (AIM * tolerance_mm)) ** 0.2))


def _interpolated(height: Height, axes: tuple[Axis, Axis]) -> tuple[Poles, float]:
    """Interpolate on the whole grid with simple knots, and return the poles of each patch and the largest error."""
    from scipy.interpolate import BSpline, make_interp_spline

    def exact(s: Floats, t: Floats) -> Floats | Complexes:
        heights, frame = height.grid(s, t), height.area.frame
        return heights if frame.radius_mm is None else frame.section(s[:, None], heights)

    knots, places, to_patches, tests = [], [], [], []
    for axis in axes:
        breaks = np.concatenate([axis.lines[:1], *(axis.knots_mm(i)[1:] for i in range(axis.patches))])
        own = np.concatenate([[breaks[0]] * DEGREE, breaks, [breaks[-1]] * DEGREE])
        knots.append(own)
        places.append(np.clip(greville(own, DEGREE), breaks[0], breaks[-1]))
        local = np.linalg.inv(axis.basis.values(axis.basis.greville))
        to_patches.append(
            [local @ BSpline.design_matrix(axis.abscissae_mm(i), own, DEGREE) for i in range(axis.patches)]
        )
        fractions = np.arange(_TEST_STEPS) / _TEST_STEPS
        tests.append(np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * fractions).ravel(), breaks[-1]))
    along_s = make_interp_spline(places[0], exact(places[0], places[1]), k=DEGREE, t=knots[0], axis=0).c
    poles = make_interp_spline(places[1], along_s.T, k=DEGREE, t=knots[1], axis=0).c.T
    left, right = (BSpline.design_matrix(test, own, DEGREE) for test, own in zip(tests, knots, strict=True))
    off = np.abs((right @ (left @ poles).T).T - exact(tests[0], tests[1]))
    if height.fading is None:
        off = off[height.area.inside(tests[0][:, None], tests[1][None, :])]
    values: Poles = {
        (i, j): (to_patches[1][j] @ (to_patches[0][i] @ poles).T).T
        for i in range(axes[0].patches)
        for j in range(axes[1].patches)
    }
    return values, _BETWEEN * float(off.max())


def _require_few(s: Axis, t: Axis, tolerance_mm: float, too_fine: bool) -> None:
    poles = s.pole_count * t.pole_count
    if too_fine or poles > MAX_POLES:
        need = "more than 64 spans on a patch" if too_fine else f"{poles / 1e6:.2g} million poles"
        raise InputError(
            "tolerance_mm",
            tolerance_mm,
            f"needs {need}, but {MAX_POLES / 1e6:g} million poles are the maximum; use a coarser tolerance, a shorter "
            "region or a texture with fewer waves",
        )
