"""The relief of a block as spline patches: how many, of which degree, with how many poles, and what is proved of them.

No CAD kernel is needed here; :mod:`tacbench_cad.geometry.brep` makes the solid from these patches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from tacbench_cad.geometry.mesh import Certificate
from tacbench_cad.geometry.splines.kernelrule import area_error
from tacbench_cad.geometry.splines.spline import Axis, basis
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Complexes, Floats

#: A surface that would need more poles than this is refused.
MAX_POLES = 4_000_000
#: Tolerances below this, ten times the kernel's own, are refused.
FINEST_TOLERANCE_MM = 1e-6
#: Polynomial degree of the splines, along an axis without waves as well. Texture 4 of preset paper takes 136,000 poles
#: with degree 5 and 110,000 with 7 or 9, but what is then done with it takes longer with every degree. With 5, 7 and 9:
#: the kernel's volume 1.5, 2.0 and 3.0 s, a hole 2.7, 3.1 and 4.3 s, a mesh of 20,000 nodes by gmsh 20, 39 and 53 s.
DEGREE = 5
#: Fewest spans on a patch, also along an axis without waves: the kernel's default volume takes as many points as twice
#: the spans times (degree + 1) along y, for both axes of a face; with 5 spans that is 60 of at most 61.
MIN_SPANS = 5
#: More spans on a patch are not tried: an axis that needs more gets more patches.
MAX_SPANS = 64
#: Waves of the finest kind on one patch, at most. More leave the kernel's area and volume wrong, fewer make it slow.
WAVES_PER_PATCH = 6.5
#: Error of the kernel's area of the top, relative to the area of the block, that is let pass.
AREA_ERROR = 5e-5
#: The part of the tolerance that is aimed at: a tenth more poles, half the ripple in the area.
AIM = 0.5
#: Waves above which no other tolerance is tried for the sake of a better message.
_MAX_WAVES_PLANNED = 1500


@dataclass(frozen=True, eq=False)
class Patches:
    """Spline patches over the rectangle of a block. Build them with :func:`patches`.

    Args:
        surface: The formula in mm.
        datum_mm: z of the formula's zero.
        x: The axis x.
        y: The axis y.
        certificate: What is proved of the distance between patches and formula.
        key_patches: Patches of either axis within the key's square; 0 without a key.
    """

    surface: WaveSum
    datum_mm: float
    x: Axis
    y: Axis
    certificate: Certificate
    key_patches: int

    @property
    def pole_count(self) -> int:
        """Poles of the whole surface; those at the joints are shared."""
        return self.x.pole_count * self.y.pole_count

    @cached_property
    def profiles_mm(self) -> tuple[Floats, Floats] | None:
        """Of a separable surface ``p(x) + q(y)``: poles of p with the datum, and of q; (patches, count) each."""
        if not self.surface.is_separable:
            return None
        p, q = self.surface.along_u, self.surface.along_v
        return self.datum_mm + self.x.sines(p), self.y.sines(q)

    @cached_property
    def _factors(self) -> tuple[Complexes, Complexes]:
        amplitude, f, g, phase = self.surface.table.T
        return self.x.poles(f) * (amplitude * np.exp(1j * phase)), self.y.poles(g)

    def heights_mm(self, i: int, j: int) -> Floats:
        """Heights z of the poles of patch (i, j) in mm, shape (count x, count y).

        B-splines sum to one, so ``a_i + b_j`` are the poles of ``S_p(x) + S_q(y)``. A surface that is not separable
        is a sum of products of exponentials, and so are its poles.
        """
        if self.profiles_mm is not None:
            along_x, along_y = self.profiles_mm
            return np.asarray(along_x[i][:, None] + along_y[j][None, :], dtype=np.float64)
        factor_x, factor_y = self._factors
        return np.asarray(self.datum_mm + np.imag(factor_x[i] @ factor_y[j].T), dtype=np.float64)

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Heights z of the patches at the points (x, y), all in mm; one-dimensional arrays of one length."""
        i = np.clip(np.searchsorted(self.x.lines, x, side="right") - 1, 0, self.x.patches - 1)
        j = np.clip(np.searchsorted(self.y.lines, y, side="right") - 1, 0, self.y.patches - 1)
        z = np.empty(len(x))
        for one in np.unique(i * self.y.patches + j):
            a, b = divmod(int(one), self.y.patches)
            here = (i == a) & (j == b)
            left = self.x.basis.values(self._unit(self.x, a, x[here]))
            right = self.y.basis.values(self._unit(self.y, b, y[here]))
            z[here] = np.einsum("ki,ij,kj->k", left, self.heights_mm(a, b), right)
        return z

    @staticmethod
    def _unit(axis: Axis, patch: int, at: Floats) -> Floats:
        low, high = axis.lines[patch], axis.lines[patch + 1]
        return np.asarray(np.clip((at - low) / (high - low), 0.0, 1.0), dtype=np.float64)


def patches(block: Block, tolerance_mm: float) -> Patches:
    """Patches that stay within a tolerance of the formula everywhere.

    The error of the surface is at most ``sum A (E_x + (1 + E_x) E_y)`` over the waves, E_x and E_y being the errors
    of the splines of their factors: for ``P_x, P_y`` the two projections, ``F - P_x P_y F`` is ``(F - P_x F)`` plus
    ``P_x (F - P_y F)``. For a wave along one axis the other error is zero.

    Args:
        block: The block.
        tolerance_mm: Greatest distance along z in mm.

    Raises:
        InputError: The tolerance is not allowed, or needs more than :data:`MAX_POLES` poles.
    """
    if not (math.isfinite(tolerance_mm) and tolerance_mm >= FINEST_TOLERANCE_MM):
        raise InputError("step-tolerance", tolerance_mm, f"must be at least {FINEST_TOLERANCE_MM:g} mm")
    plan = _plan(block, tolerance_mm)
    if plan.poles > MAX_POLES:
        raise InputError("step-tolerance", tolerance_mm, _too_many(block, tolerance_mm, plan.poles))
    x, y = plan.axes(block)
    bound = _bound(block.surface, x, y)
    if not bound <= tolerance_mm:
        raise InputError("step-tolerance", tolerance_mm, f"is too fine; rounding alone may reach {bound:.1g} mm")
    return Patches(
        surface=block.surface,
        datum_mm=block.solid_datum_mm,
        x=x,
        y=y,
        certificate=Certificate(distance_mm=bound, vertical_mm=bound),
        key_patches=plan.key_patches,
    )


@dataclass(frozen=True)
class _Plan:
    """How the axes are cut, as numbers only.

    Args:
        patches: Patches along x and y outside of the key's square.
        key_patches: Patches of either axis within it.
        spans: Spans on each patch along x and y.
    """

    patches: tuple[int, int]
    key_patches: int
    spans: tuple[int, int]

    @property
    def poles(self) -> int:
        """Poles of the whole surface."""
        along = [(self.patches[i] + self.key_patches) * (DEGREE + self.spans[i] - 1) + 1 for i in (0, 1)]
        return along[0] * along[1]

    def axes(self, block: Block) -> tuple[Axis, Axis]:
        """Both axes; the key's square ends x and begins y."""
        (x, y), key, square = block.size_mm, block.key_mm or 0.0, self.key_patches
        steps = key * np.arange(square + 1) / max(square, 1)
        along_x = np.concatenate([_steps(x - key, self.patches[0]), (x - key) + steps[1:]])
        along_y = np.concatenate([steps[:-1], key + _steps(y - key, self.patches[1])])
        along_x[-1], along_y[-1] = x, y
        return (
            Axis(along_x, basis(DEGREE, self.spans[0])),
            Axis(along_y, basis(DEGREE, self.spans[1])),
        )


def _steps(length: float, count: int) -> Floats:
    return np.asarray(length * np.arange(count + 1) / count, dtype=np.float64)


def _plan(block: Block, tolerance_mm: float) -> _Plan:
    """Patches for a tolerance; half of what is aimed at belongs to each axis.

    Where even the fewest spans make more than :data:`MAX_POLES` poles, that plan is returned.
    """
    table = block.surface.table[block.surface.table[:, 0] != 0.0]
    amplitude = np.abs(table[:, 0])
    frequency = (np.abs(table[:, 1]), np.abs(table[:, 2]))
    fraction = AIM * tolerance_mm / 2.0
    finest = [_finest(amplitude, f, fraction / 4.0) for f in frequency]
    limit = 1024.0 * max(float(f.max()) for f in frequency)
    while max(finest) <= limit:
        patches, in_key = _patches(block, finest)
        least = _Plan(patches, in_key, (MIN_SPANS, MIN_SPANS))
        if least.poles > MAX_POLES:
            return least
        along_x = _spans(frequency[0] * _widest(block, 0, patches, in_key), amplitude, fraction)
        weight = amplitude
        if along_x <= MAX_SPANS and not block.surface.is_separable:
            turn = frequency[0] * _widest(block, 0, patches, in_key)
            single = [basis(DEGREE, along_x).error(turn[[k]], np.ones(1)) for k in range(len(turn))]
            weight = amplitude * (1.0 + np.array(single))
        along_y = _spans(frequency[1] * _widest(block, 1, patches, in_key), weight, fraction)
        if max(along_x, along_y) <= MAX_SPANS:
            return _Plan(patches, in_key, (along_x, along_y))
        finest = [fine * (2.0 if n > MAX_SPANS else 1.0) for fine, n in zip(finest, (along_x, along_y), strict=True)]
    raise InputError("step-tolerance", tolerance_mm, "is too fine for the rounding of this surface")


def _finest(amplitude: Floats, frequency: Floats, rest: float) -> float:
    """The frequency above which all amplitudes together are at most ``rest``."""
    order = np.argsort(-frequency)
    above = np.cumsum(amplitude[order])
    first = int(np.searchsorted(above, rest, side="right"))
    return float(frequency[order[min(first, len(order) - 1)]])


def _patches(block: Block, finest: list[float]) -> tuple[tuple[int, int], int]:
    """Patches along x and y outside of the key's square, and of either axis within it.

    The kernel's default area takes few points on a face (see :mod:`.kernelrule`). Where waves are
    steep, :data:`WAVES_PER_PATCH` on a patch are too many for that, and more patches are made.

    Args:
        block: The block.
        finest: Along x and y the frequency in radians per mm that counts.
    """
    (x, y), key = block.size_mm, block.key_mm or 0.0
    on_patch = WAVES_PER_PATCH

    def count(length: float, axis: int) -> int:
        return max(1, math.ceil(length * finest[axis] / (2.0 * math.pi * on_patch) - 1e-9))

    while on_patch > 1.0 and area_error(block, (count(x, 0), count(y, 1))) > AREA_ERROR:
        on_patch /= 1.25
    in_key = max(count(key, 0), count(key, 1)) if key else 0
    return (count(x - key, 0), count(y - key, 1)), in_key


def _widest(block: Block, axis: int, patches: tuple[int, int], in_key: int) -> float:
    """Width of the widest patch along an axis in mm."""
    key = block.key_mm or 0.0
    return max((block.size_mm[axis] - key) / patches[axis], key / max(in_key, 1))


def _spans(turn: Floats, weight: Floats, fraction: float) -> int:
    """The fewest spans on one patch that keep the error within a fraction; one more than :data:`MAX_SPANS` if none do.

    On spans of which one holds the part a < 1/2 of a wave, a spline takes the wave for its alias with 1 - a as well, so
    that its error is near ``2 (a / (1 - a))^(degree + 1)``. From there one or two steps find the number.
    """
    if not np.any(turn):
        return MIN_SPANS
    tried = np.arange(MIN_SPANS, MAX_SPANS + 1)
    part = np.minimum(np.abs(turn) / (2.0 * math.pi * tried[:, None]), 0.5)
    near = 2.0 * (part / (1.0 - part)) ** (DEGREE + 1) @ weight
    enough = np.flatnonzero(near <= fraction)
    found = int(tried[enough[0]]) if len(enough) else MAX_SPANS

    @cache
    def error(spans: int) -> float:
        return basis(DEGREE, spans).error(turn, weight)

    while error(found) > fraction:
        if found == MAX_SPANS:
            return MAX_SPANS + 1
        further = math.ceil(found * (error(found) / fraction) ** (1.0 / (DEGREE + 1)))
        found = min(max(found + 1, further), MAX_SPANS)
    while found > MIN_SPANS and error(found - 1) <= fraction:
        found -= 1
    return found


def _bound(surface: WaveSum, x: Axis, y: Axis) -> float:
    """The proved vertical bound of :func:`patches`."""
    amplitude, f, g, phase = np.abs(surface.table.T)
    first = x.error(f, amplitude)
    one = np.ones(1)
    single = np.zeros(len(f)) if surface.is_separable else np.array([x.error(f[[k]], one) for k in range(len(f))])
    second = y.error(g, amplitude * (1.0 + single))
    rounding = 4.0 * np.finfo(float).eps * float(amplitude @ (1.0 + np.abs(phase)))
    return float(first + second + rounding)


def _too_many(block: Block, tolerance_mm: float, poles: int) -> str:
    """What a solid would need, and the tolerance that would do."""
    need = f"the solid would need at least {poles / 1e6:.3g} million poles, {MAX_POLES / 1e6:g} million is the most"
    if len(block.surface.waves) > _MAX_WAVES_PLANNED:
        return f"{need}; use a coarser --step-tolerance"
    coarser = tolerance_mm
    while coarser < block.relief_mm / 12.0:
        coarser = float(f"{coarser * 3.0:.1g}")
        if _plan(block, coarser).poles <= MAX_POLES:
            return f"{need}; --step-tolerance {coarser:g} would do"
    return f"{need}; no tolerance would do"
