"""The relief of a block as spline patches: their number, degree and poles, and proved bounds of their error.

This module does not need the CAD kernel. :mod:`tacbench_cad.geometry.brep` makes the solid from these patches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from tacbench_cad.geometry.mesh import Certificate
from tacbench_cad.geometry.splines.curve import Axis, basis
from tacbench_cad.geometry.splines.exact import PieceAxis
from tacbench_cad.geometry.splines.fit import Fit, Task, fit_both, short_decimal
from tacbench_cad.geometry.splines.kernelrule import area_error, wave_table
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Complexes, Floats

#: The largest allowed number of poles of a surface.
MAX_POLES = 4_000_000
#: The smallest allowed tolerance, in mm. It is ten times the tolerance of the kernel.
FINEST_TOLERANCE_MM = 1e-6
#: The polynomial degree of the splines, also along an axis without waves. Texture 4 of preset paper needs 90,000 poles
#: with degree 5, and 83,000 with degree 7. But with degree 7 the kernel's volume takes 2.1 s instead of 1.5 s, and a
#: mesh of 3,400 nodes by gmsh takes 6.0 s instead of 4.6 s.
DEGREE = 5
#: The smallest number of spans on a patch, also along an axis without waves. For both axes of a face, the kernel's
#: default volume uses a number of points that is twice the number of spans along y times (degree + 1). With 5 spans,
#: these are 60 points; the kernel's maximum is 61.
MIN_SPANS = 5
#: The largest number of spans on a patch. An axis that needs more spans gets more patches.
MAX_SPANS = 64
#: The largest number of the finest waves on a patch. With more waves, the kernel's area and volume are wrong. With
#: fewer waves, the kernel is slow.
WAVES_PER_PATCH = 6.5
#: The number of waves on a patch with which the search begins. Gentle waves need no more patches than these.
_WAVES_AT_FIRST = 1.25**2 * WAVES_PER_PATCH
#: The allowed error of the kernel's area of the top, relative to the area of the block.
AREA_ERROR = 5e-5
#: The fraction of the tolerance that the splines of exponentials aim for. With 0.5, there are 10 % more poles, and the
#: ripple in the area is half as large.
AIM = 0.5
#: The poles of a separable surface are multiples of a power of ten, which is at most this fraction of the tolerance.
_ROUNDING_OF_POLES = 1e-2
#: The lines between patches are multiples of a power of ten, which is at most this fraction of the width of a patch.
_ROUNDING_OF_LINES = 0.01
#: The number of planned poles up to which a separable surface has equal spans as well, because its file is small.
_MAX_POLES_OF_SMALL_FILES = 10_000
#: The fraction of the planned spans that the fit of a separable surface usually needs.
_SPANS_AT_FIRST = 0.8
#: The largest number of waves for which an error message suggests another tolerance.
_MAX_WAVES_PLANNED = 1500


@dataclass(frozen=True, eq=False)
class Patches:
    """Spline patches over the rectangle of a block. Create them with :func:`patches`.

    Args:
        surface: The formula in mm.
        datum_mm: The z of the formula's zero.
        x: The axis along x.
        y: The axis along y.
        certificate: The proved bounds of the distance between the patches and the formula.
        profiles_mm: If the surface is ``p(x) + q(y)``, the poles of p, including the datum, and of q, each with the
            shape (patches, count); otherwise None.
    """

    surface: Surface
    datum_mm: float
    x: Axis | PieceAxis
    y: Axis | PieceAxis
    certificate: Certificate
    profiles_mm: tuple[Floats, Floats] | None = None

    @property
    def pole_count(self) -> int:
        """The number of poles of the whole surface. Poles at joints are counted once."""
        return self.x.pole_count * self.y.pole_count

    @cached_property
    def _factors(self) -> tuple[Complexes, Complexes]:
        assert isinstance(self.x, Axis)
        assert isinstance(self.y, Axis)
        amplitude, f, g, phase = wave_table(self.surface).T
        return self.x.poles(f) * (amplitude * np.exp(1j * phase)), self.y.poles(g)

    def heights_mm(self, i: int, j: int) -> Floats:
        """Return the heights z of the poles of patch (i, j) in mm, shape (count x, count y).

        B-splines sum to one, so ``a_i + b_j`` are the poles of ``S_p(x) + S_q(y)``. A surface that is not separable is
        a sum of products of exponentials, and its poles are the sums of the products of their poles.
        """
        if self.profiles_mm is not None:
            along_x, along_y = self.profiles_mm
            return np.asarray(along_x[i][:, None] + along_y[j][None, :], dtype=np.float64)
        factor_x, factor_y = self._factors
        return np.asarray(self.datum_mm + np.imag(factor_x[i] @ factor_y[j].T), dtype=np.float64)

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return the heights z of the patches at the points (x, y), in mm. All arrays are one-dimensional."""
        i = np.clip(np.searchsorted(self.x.lines, x, side="right") - 1, 0, self.x.patches - 1)
        j = np.clip(np.searchsorted(self.y.lines, y, side="right") - 1, 0, self.y.patches - 1)
        z = np.empty(len(x))
        for number in np.unique(i * self.y.patches + j):
            a, b = divmod(int(number), self.y.patches)
            here = (i == a) & (j == b)
            left = self.x.values(a, self._unit(self.x, a, x[here]))
            right = self.y.values(b, self._unit(self.y, b, y[here]))
            z[here] = np.einsum("ki,ij,kj->k", left, self.heights_mm(a, b), right)
        return z

    @staticmethod
    def _unit(axis: Axis | PieceAxis, patch: int, at: Floats) -> Floats:
        low, high = axis.lines[patch], axis.lines[patch + 1]
        return np.asarray(np.clip((at - low) / (high - low), 0.0, 1.0), dtype=np.float64)


def patches(block: Block, tolerance_mm: float) -> Patches:
    """Make patches that are within a tolerance of the formula everywhere.

    The error of the surface is at most the sum of ``A (E_x + (1 + E_x) E_y)`` over the waves. E_x and E_y are the
    errors of the splines of the factors of a wave. The reason is that with the two projections ``P_x`` and ``P_y``,
    ``F - P_x P_y F = (F - P_x F) + P_x (F - P_y F)``. For a wave along one axis, the error along the other axis is
    zero.

    Args:
        block: The block.
        tolerance_mm: The largest allowed distance along z, in mm.

    Raises:
        InputError: The tolerance is not allowed, or needs more than :data:`MAX_POLES` poles.
    """
    if not (math.isfinite(tolerance_mm) and tolerance_mm >= FINEST_TOLERANCE_MM):
        raise InputError("step-tolerance", tolerance_mm, f"must be at least {FINEST_TOLERANCE_MM:g} mm")
    plan = _plan(block, tolerance_mm)
    if plan.poles > MAX_POLES:
        raise InputError("step-tolerance", tolerance_mm, _too_many(block, tolerance_mm, plan.poles))
    x: Axis | PieceAxis
    y: Axis | PieceAxis
    profiles = None
    if block.surface.is_separable and plan.poles > _MAX_POLES_OF_SMALL_FILES:
        fits = _fits(block, plan, tolerance_mm)
        x, y, profiles = fits[0].axis, fits[1].axis, (fits[0].poles_mm, fits[1].poles_mm)
        bound = fits[0].error_mm + fits[1].error_mm
    else:
        x, y = plan.axes(block)
        bound = _bound(block.surface, x, y)
        if block.surface.is_separable:
            p, q = block.surface.along_u, block.surface.along_v
            profiles = (block.solid_datum_mm + x.sines(p), y.sines(q))
    if not bound <= tolerance_mm:
        raise InputError("step-tolerance", tolerance_mm, f"is too fine; rounding alone may reach {bound:.1g} mm")
    return Patches(
        surface=block.surface,
        datum_mm=block.solid_datum_mm,
        x=x,
        y=y,
        certificate=Certificate(distance_mm=bound, vertical_mm=bound),
        profiles_mm=profiles,
    )


@dataclass(frozen=True)
class _Plan:
    """The numbers of patches and spans of both axes.

    Args:
        patches: The numbers of patches along x and y.
        spans: The numbers of spans on each patch along x and y.
    """

    patches: tuple[int, int]
    spans: tuple[int, int]

    @property
    def poles(self) -> int:
        """The number of poles of the whole surface."""
        along = [self.patches[i] * (DEGREE + self.spans[i] - 1) + 1 for i in (0, 1)]
        return along[0] * along[1]

    def lines(self, block: Block, rounded: bool) -> tuple[Floats, Floats]:
        """Return the ends of the patches along x and y.

        Args:
            block: The block.
            rounded: Whether to round the distances between the lines to few decimals.
        """
        x, y = (_steps(side, count, rounded) for side, count in zip(block.size_mm, self.patches, strict=True))
        return x, y

    def axes(self, block: Block) -> tuple[Axis, Axis]:
        """Return both axes with equal spans."""
        along_x, along_y = self.lines(block, rounded=False)
        return Axis(along_x, basis(DEGREE, self.spans[0])), Axis(along_y, basis(DEGREE, self.spans[1]))


def _steps(length: float, count: int, rounded: bool) -> Floats:
    steps = length * np.arange(count + 1) / count
    if rounded and count > 1:
        unit = short_decimal(_ROUNDING_OF_LINES * length / count)
        steps[1:-1] = np.round(steps[1:-1] / unit) * unit
    steps[-1] = length
    return np.asarray(steps, dtype=np.float64)


def _fits(block: Block, plan: _Plan, tolerance_mm: float) -> tuple[Fit, Fit]:
    """Fit both halves of a separable surface; see :mod:`.fit`. The plan is for equal spans, which are more spans."""
    halves = ((block.surface.along_u, block.solid_datum_mm), (block.surface.along_v, 0.0))
    unit = short_decimal(_ROUNDING_OF_POLES * tolerance_mm)
    tasks = [
        Task(half, offset, lines, DEGREE, unit)
        for (half, offset), lines in zip(halves, plan.lines(block, rounded=True), strict=True)
    ]
    starts = (round(_SPANS_AT_FIRST * plan.spans[0]), round(_SPANS_AT_FIRST * plan.spans[1]))
    fits = fit_both((tasks[0], tasks[1]), tolerance_mm, starts, (MIN_SPANS, MIN_SPANS), MAX_SPANS)
    if fits is None:
        raise InputError("step-tolerance", tolerance_mm, "is too fine for the rounding of this surface")
    return fits


def _plan(block: Block, tolerance_mm: float) -> _Plan:
    """Plan the patches for a tolerance. Each axis gets half of the intended error.

    If even the smallest number of spans gives more than :data:`MAX_POLES` poles, the plan with these spans is returned.
    """
    table = wave_table(block.surface)
    table = table[table[:, 0] != 0.0]
    amplitude = np.abs(table[:, 0])
    frequency = (np.abs(table[:, 1]), np.abs(table[:, 2]))
    fraction = AIM * tolerance_mm / 2.0
    finest = [_finest(amplitude, f, fraction / 4.0) for f in frequency]
    limit = 1024.0 * max(float(f.max()) for f in frequency)
    while max(finest) <= limit:
        patches = _patches(block, finest)
        widths = [side / count for side, count in zip(block.size_mm, patches, strict=True)]
        smallest = _Plan(patches, (MIN_SPANS, MIN_SPANS))
        if smallest.poles > MAX_POLES:
            return smallest
        along_x = spans_needed(frequency[0] * widths[0], amplitude, fraction)
        weight = amplitude
        if along_x <= MAX_SPANS and not block.surface.is_separable:
            turn = frequency[0] * widths[0]
            single = [basis(DEGREE, along_x).error(turn[[k]], np.ones(1)) for k in range(len(turn))]
            weight = amplitude * (1.0 + np.array(single))
        along_y = spans_needed(frequency[1] * widths[1], weight, fraction)
        if max(along_x, along_y) <= MAX_SPANS:
            return _Plan(patches, (along_x, along_y))
        finest = [fine * (2.0 if n > MAX_SPANS else 1.0) for fine, n in zip(finest, (along_x, along_y), strict=True)]
    raise InputError("step-tolerance", tolerance_mm, "is too fine for the rounding of this surface")


def _finest(amplitude: Floats, frequency: Floats, rest: float) -> float:
    """Return the frequency above which the sum of all amplitudes is at most ``rest``."""
    order = np.argsort(-frequency)
    above = np.cumsum(amplitude[order])
    first = int(np.searchsorted(above, rest, side="right"))
    return float(frequency[order[min(first, len(order) - 1)]])


def _patches(block: Block, finest: list[float]) -> tuple[int, int]:
    """Return the numbers of patches along x and y.

    The kernel's default area uses few points on a face (see :mod:`.kernelrule`). If the waves are steep, the area of a
    patch with many waves is not accurate enough, so more patches are made.

    Args:
        block: The block.
        finest: The highest relevant frequencies along x and y, in radians per mm.
    """
    on_patch = _WAVES_AT_FIRST
    while True:
        waves = [side * fine / (2.0 * math.pi) for side, fine in zip(block.size_mm, finest, strict=True)]
        x, y = (max(1, math.ceil(count / on_patch - 1e-9)) for count in waves)
        if on_patch <= 1.0 or area_error(block, (x, y)) <= AREA_ERROR:
            return x, y
        on_patch /= 1.25


def spans_needed(turn: Floats, weight: Floats, fraction: float) -> int:
    """Return the smallest number of spans on a patch that keeps the error within a limit in mm.

    The result is :data:`MAX_SPANS` + 1 if no allowed number is enough. If a span holds the fraction a < 1/2 of a wave,
    a spline cannot distinguish the wave from its alias with the fraction 1 - a, and its error is about
    ``2 (a / (1 - a))^(degree + 1)``. This estimate is the start value; usually one or two more steps are needed.
    """
    if not np.any(turn):
        return MIN_SPANS
    tried = np.arange(MIN_SPANS, MAX_SPANS + 1)
    part = np.minimum(np.abs(turn) / (2.0 * math.pi * tried[:, None]), 0.5)
    near = 2.0 * (part / (1.0 - part)) ** (DEGREE + 1) @ weight
    enough = np.flatnonzero(near <= fraction)
    number = int(tried[enough[0]]) if len(enough) else MAX_SPANS

    @cache
    def error(spans: int) -> float:
        return basis(DEGREE, spans).error(turn, weight)

    while error(number) > fraction:
        if number == MAX_SPANS:
            return MAX_SPANS + 1
        further = math.ceil(number * (error(number) / fraction) ** (1.0 / (DEGREE + 1)))
        number = min(max(number + 1, further), MAX_SPANS)
    while number > MIN_SPANS and error(number - 1) <= fraction:
        number -= 1
    return number


def _bound(surface: Surface, x: Axis, y: Axis) -> float:
    """Return the proved bound of the vertical error; see :func:`patches`."""
    amplitude, f, g, phase = np.abs(wave_table(surface).T)
    first = x.error(f, amplitude)
    unit = np.ones(1)
    single = np.zeros(len(f)) if surface.is_separable else np.array([x.error(f[[k]], unit) for k in range(len(f))])
    second = y.error(g, amplitude * (1.0 + single))
    rounding = 4.0 * np.finfo(float).eps * float(amplitude @ (1.0 + np.abs(phase)))
    return float(first + second + rounding)


def _too_many(block: Block, tolerance_mm: float, poles: int) -> str:
    """Return a message with the number of poles that a solid would need, and a tolerance that is large enough."""
    need = (
        f"the solid would need at least {poles / 1e6:.3g} million poles, but {MAX_POLES / 1e6:g} million is the maximum"
    )
    if len(wave_table(block.surface)) > _MAX_WAVES_PLANNED:
        return f"{need}; use a coarser --step-tolerance"
    coarser = tolerance_mm
    while coarser < block.relief_mm / 12.0:
        coarser = float(f"{coarser * 3.0:.1g}")
        if _plan(block, coarser).poles <= MAX_POLES:
            return f"{need}; use --step-tolerance {coarser:g}"
    return f"{need}; no tolerance is large enough"
