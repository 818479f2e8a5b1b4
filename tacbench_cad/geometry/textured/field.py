"""The textured surface of a region: its formula, and spline patches with the bound of their error.

A wave along a face is a product of two exponentials, one along s and one along t. The same is true after it fades out
by half a period of a cosine, and after it is wound around a cylinder: a point of the cross-section is
``(R + h) exp(i s / R)``, again a sum of exponentials. So the proof of :mod:`tacbench_cad.geometry.splines.curve`
holds for all of them. A fade along any other outline is not such a sum. It is interpolated on a
grid, and its error is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.geometry.splines.curve import Axis, basis
from tacbench_cad.geometry.splines.patches import AIM, DEGREE, MAX_SPANS, MIN_SPANS, WAVES_PER_PATCH, spans_needed
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.spec.spline import greville
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Complexes, Floats

#: The largest number of poles of all patches of a region.
MAX_POLES = 1_500_000
#: The fraction of a patch by which the patches reach beyond the outline.
_BEYOND = 0.05
#: The smallest allowed distance of a line between patches from a corner of the outline, as a fraction of a patch.
_APART = 0.02
#: The spans on the length of a fade, or on the finest wave, with which the search for a grid begins.
_SPANS_AT_FIRST = 2.5
#: The largest number of spans of a sampled patch, approximately. The kernel's volume of larger patches is wrong.
_MAX_SAMPLED_SPANS = 32
#: The number of steps of the error test between two neighbouring knots.
_TEST_STEPS = 3
#: The factor of the largest measured error, because the error can be a little larger between the tested points.
_BETWEEN = 1.25


@dataclass(frozen=True, kw_only=True)
class Fade:
    """How the texture ends: it fades out towards the outline.

    Args:
        length_mm: The length of the fade, in mm; 0 for none.
        sides: On a rectangle, whether it fades towards the ends of s and of t. None for another outline.
        distances: For another outline, a function that returns the distances of points, shape (n, 2), from each part
            of the outline between two convex corners.
        inside: For another outline, a function that returns which points of a grid are inside of it.
    """

    length_mm: float
    sides: tuple[bool, bool] | None = None
    distances: Callable[[Floats], list[Floats]] | None = None
    inside: Callable[[Floats, Floats], Bools] | None = None


@dataclass(frozen=True, kw_only=True)
class Height:
    """The height of the texture above a region.

    Args:
        surface: The formula along s and t, in mm.
        start_mm: The height to which the texture fades, and its end that is nearer to the face.
        zero_mm: The value of the formula at ``start_mm``.
        far_mm: The value of the formula at the other end.
        factor: The factor of the formula.
        fade: How the texture ends.
        size_mm: The extents of the region along s and t.
    """

    surface: Surface
    start_mm: float
    zero_mm: float
    far_mm: float
    factor: float
    fade: Fade
    size_mm: tuple[float, float]

    @property
    def range_mm(self) -> tuple[float, float]:
        """The lowest and the highest point of the texture above the face, in mm."""
        far = self.start_mm + self.factor * (self.far_mm - self.zero_mm)
        return min(self.start_mm, far), max(self.start_mm, far)

    @property
    def depth_mm(self) -> float:
        """The difference between the highest and the lowest point of the texture, in mm."""
        return abs(self.factor * (self.far_mm - self.zero_mm))

    def grid(self, s: Floats, t: Floats) -> Floats:
        """Return the heights on a grid, shape (n, m), in mm."""
        values = self.surface.grid(s, t) if isinstance(self.surface, WaveSum) else self._beyond(s, t)
        return self._faded(values, self._window(s[:, None], t[None, :]))

    @property
    def own_error_mm(self) -> float:
        """The distance of the formula from what it represents, for example from a height map, in mm."""
        return abs(self.factor) * self.surface.error

    def _beyond(self, s: Floats, t: Floats) -> Floats:
        """Return the values on a grid that may reach a little beyond the region, where a spline is not known.

        There, it continues as its point reflection at the border, with the same slope.
        """
        (s_in, s_out), (t_in, t_out) = (
            (np.clip(at, 0.0, size), np.clip(2.0 * np.clip(at, 0.0, size) - at, 0.0, size))
            for at, size in zip((s, t), self.size_mm, strict=True)
        )
        edge, along_s = self.surface.grid(s_in, t_in), self.surface.grid(s_out, t_in)
        along_t, both = self.surface.grid(s_in, t_out), self.surface.grid(s_out, t_out)
        beyond_s, beyond_t = ((s_in != s)[:, None], (t_in != t)[None, :])
        values = np.where(beyond_s, 2.0 * edge - along_s, edge)
        mirrored = np.where(beyond_s, 2.0 * along_t - both, along_t)
        return np.where(beyond_t, 2.0 * values - mirrored, values)

    def at(self, s: Floats, t: Floats) -> Floats:
        """Return the heights at points, in mm. The arrays broadcast."""
        return self._faded(self.surface(s, t), self._window(s, t))

    def _faded(self, values: Floats, window: Floats | float) -> Floats:
        return np.asarray(self.start_mm + self.factor * (values - self.zero_mm) * window, dtype=np.float64)

    def _window(self, s: Floats, t: Floats) -> Floats | float:
        if not self.fade.length_mm:
            return 1.0
        if self.fade.distances is None:
            return np.asarray(self._along(0, s) * self._along(1, t))
        a, b = np.broadcast_arrays(s, t)
        window = np.ones(a.size)
        for distance in self.fade.distances(np.stack([a.ravel(), b.ravel()], axis=1)):
            near = distance < self.fade.length_mm
            part = distance[near] / self.fade.length_mm
            window[near] *= part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3)
        return window.reshape(a.shape)

    def _along(self, axis: int, at: Floats) -> Floats:
        """Return the factor of the fade along one axis of a rectangle."""
        assert self.fade.sides is not None
        if not self.fade.sides[axis]:
            return np.ones(np.shape(at))
        distance = np.minimum(at, self.size_mm[axis] - at)
        return np.asarray((1.0 - np.cos(np.pi * np.clip(distance / self.fade.length_mm, -1.0, 1.0))) / 2.0)


@dataclass(frozen=True, eq=False)
class PatchGrid:
    """Spline patches over a rectangle of s and t.

    Args:
        frame: The local coordinates.
        s: The patches along s.
        t: The patches along t.
        values: For each patch (i, j) the values of its poles, shape (count, count): the height on a plane, the complex
            point of the cross-section on a cylinder.
        error_mm: The bound of the distance between the patches and the formula.
        is_proved: Whether the bound is proved; otherwise it is the largest error on a fine grid.
        is_closed: Whether the patches go all the way around a cylinder.
    """

    frame: Frame
    s: Axis
    t: Axis
    values: dict[tuple[int, int], Floats | Complexes]
    error_mm: float
    is_proved: bool
    is_closed: bool

    def poles(self, i: int, j: int) -> Floats:
        """Return the poles of a patch in the coordinates of the part, shape (count, count, 3)."""
        return self._world(self.s.abscissae_mm(i)[:, None], self.t.abscissae_mm(j)[None, :], self.values[i, j])

    def points(self, i: int, j: int, s: Floats, t: Floats) -> Floats:
        """Return points of a patch in the coordinates of the part, shape (n, 3)."""
        (row, left), (column, right) = (
            axis.basis.local(np.clip((at - axis.lines[k]) / (axis.lines[k + 1] - axis.lines[k]), 0.0, 1.0))
            for axis, k, at in ((self.s, i, s), (self.t, j, t))
        )
        near = self.values[i, j][
            row[:, None, None] + np.arange(len(left))[:, None], column[:, None, None] + np.arange(len(right))
        ]
        return self._world(s, t, np.einsum("ak,kab,bk->k", left, near, right))

    def _world(self, s: Floats, t: Floats, values: Floats | Complexes) -> Floats:
        if self.frame.radius_mm is None:
            return self.frame.world(s, t, np.real(values))
        return self.frame.world(values, t)


@dataclass(frozen=True, kw_only=True, eq=False)
class Avoid:
    """The places that lines between patches must keep away from.

    Args:
        corners: The corners of the outline, and its extremes along s and t, shape (n, 2).
        outline: Points along each edge of the outline, shape (m, 2) each.
    """

    corners: Floats
    outline: Sequence[Floats]

    def along_t(self, s_lines: Floats, around_mm: float | None) -> Floats:
        """Return the coordinates t of the corners, and of the crossings of the outline with lines along t.

        Args:
            s_lines: The lines between patches along s. Patches must not have a corner on the outline.
            around_mm: The circumference if the region goes all the way around a cylinder.
        """
        places = [self.corners[:, 1]]
        for points in self.outline:
            for line in s_lines.tolist():
                off = points[:, 0] - line
                if around_mm is not None:
                    off = off - around_mm * np.round(off.mean() / around_mm)
                k = np.flatnonzero((off[:-1] < 0.0) != (off[1:] < 0.0))
                part = off[k] / (off[k] - off[k + 1])
                places.append(points[k, 1] + part * (points[k + 1, 1] - points[k, 1]))
        return np.concatenate(places)


def lines_along(length: float, patches: int, avoid: Floats, closed: bool) -> Floats:
    """Return the lines between patches. They keep away from the corners of the outline.

    Args:
        length: The extent of the region.
        patches: The number of patches.
        avoid: The coordinates that the lines must keep away from.
        closed: Whether the last line is the first line again, after one turn.
    """
    step = length / patches
    apart = _APART * step
    if closed:
        lines = np.linspace(0.0, length, patches + 1)
        tried = np.linspace(0.1, 0.9, 97) * step
        after = [np.mod(avoid[:, None] - lines - start, length) for start in tried]
        near = [np.minimum(gap, length - gap).min() for gap in after]
        return np.asarray(lines + tried[int(np.argmax(near))])
    lines = np.linspace(0.0, length, patches + 1)
    lines[[0, -1]] += np.array([-_BEYOND, _BEYOND]) * step
    for k in range(1, patches):
        tried = lines[k] + apart * np.array([0.0, *(sign * n for n in range(1, 11) for sign in (1, -1))])
        near = np.abs(tried[:, None] - avoid).min(axis=1)
        enough = np.flatnonzero(near >= apart)
        lines[k] = tried[enough[0] if len(enough) else int(np.argmax(near))]
    return lines


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


class ExactField:
    """The patches of a sum of waves without a fade, or with a fade towards the sides of a rectangle."""

    def __init__(self, height: Height, frame: Frame, closed: bool) -> None:
        self._height, self._frame, self._closed = height, frame, closed

    @cached_property
    def _waves(self) -> _Waves:
        """The height, without ``start_mm``, as exponentials of which the real part counts."""
        height = self._height
        assert isinstance(height.surface, WaveSum)
        amplitude, f, g, phase = height.surface.table.T
        moving = amplitude != 0.0
        c = -1j * height.factor * amplitude * np.exp(1j * phase)
        c, f, g = c[moving], f[moving], g[moving]
        return _Waves(np.append(c, -height.factor * height.zero_mm), np.append(f, 0.0), np.append(g, 0.0))

    def _zone(self, zones: tuple[int, int]) -> _Waves:
        """Return the exponentials in a zone of the fade: at the beginning (-1), in the middle (0), at the end (1)."""
        height, waves = self._height, self._waves
        for axis, zone in enumerate(zones):
            if zone:
                turn = np.pi / height.fade.length_mm
                start = 0.0 if zone < 0 else height.size_mm[axis]
                shift = np.exp(-1j * turn * start)
                waves = waves.times([(0.5, 0.0), (-0.25 * shift, turn), (-0.25 / shift, -turn)], axis)
        waves = _Waves(np.append(waves.c, height.start_mm), np.append(waves.f, 0.0), np.append(waves.g, 0.0))
        radius = self._frame.radius_mm
        if radius is None:
            return waves
        c = self._frame.side * np.concatenate([waves.c, np.conj(waves.c)]) / 2.0
        f, g = np.concatenate([waves.f, -waves.f]), np.concatenate([waves.g, -waves.g])
        both = _Waves(np.append(c, radius), np.append(f, 0.0), np.append(g, 0.0))
        return both.times([(1.0, self._frame.side / radius)], 0)

    @cached_property
    def _borders(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The coordinates at which the fade ends, along s and t. Without a fade, they lie outside of the region."""
        fade, ends = self._height.fade, []
        for axis, size in enumerate(self._height.size_mm):
            on = bool(fade.length_mm) and fade.sides is not None and fade.sides[axis]
            ends.append((fade.length_mm, size - fade.length_mm) if on else (-math.inf, math.inf))
        return ends[0], ends[1]

    def _zone_of(self, axis: int, lines: Floats) -> list[int]:
        low, high = self._borders[axis]
        middles = (lines[:-1] + lines[1:]) / 2.0
        return [-1 if middle < low else 1 if middle > high else 0 for middle in middles]

    def patches(self, tolerance_mm: float, avoid: Avoid) -> PatchGrid:
        """Return patches within a tolerance of the formula.

        Args:
            tolerance_mm: The largest distance between the patches and the formula.
            avoid: The places that lines between patches must keep away from.

        Raises:
            InputError: The tolerance needs too many poles.
        """
        counts = patch_counts(self._height)
        around = self._height.size_mm[0] if self._closed else None
        lines: list[Floats] = []
        for axis in (0, 1):
            closed = self._closed and axis == 0
            size = self._height.size_mm[axis]
            far = avoid.corners[:, 0] if axis == 0 else avoid.along_t(lines[0], around)
            if closed:
                count = max(counts[axis], 3)
                lines.append(lines_along(size, count, far, True))
                continue
            low, high = self._borders[axis]
            if math.isinf(low):
                lines.append(lines_along(size, counts[axis], far, False))
                continue
            own = lines_along(size, counts[axis], np.append(far, [low, high]), False)
            apart = 0.2 * size / counts[axis]
            inner = own[1:-1]
            inner = inner[(np.abs(inner - low) > apart) & (np.abs(inner - high) > apart)]
            own = np.concatenate([own[:1], inner, own[-1:]])
            lines.append(np.sort(np.concatenate([own, [low, high] if high - low > 1e-6 else [low]])))
        zones = [self._zone_of(axis, lines[axis]) for axis in (0, 1)]
        kinds = {(a, b): self._zone((a, b)) for a in set(zones[0]) for b in set(zones[1])}
        axes = self._axes(lines, kinds, tolerance_mm)
        error = max(_bound(waves, *axes) for waves in kinds.values())
        if not error <= tolerance_mm:
            raise InputError("tolerance_mm", tolerance_mm, f"is too fine; the bound of the error is {error:.2g} mm")
        values: dict[tuple[int, int], Floats | Complexes] = {}
        for (a, b), waves in kinds.items():
            along_s, along_t = axes[0].poles(waves.f) * waves.c, axes[1].poles(waves.g)
            for i in (k for k, zone in enumerate(zones[0]) if zone == a):
                for j in (k for k, zone in enumerate(zones[1]) if zone == b):
                    poles = along_s[i] @ along_t[j].T
                    values[i, j] = np.real(poles) if self._frame.radius_mm is None else poles
        _share(values, axes, self._closed)
        return PatchGrid(self._frame, *axes, values, error, True, self._closed)

    def _axes(
        self, lines: list[Floats], kinds: dict[tuple[int, int], _Waves], tolerance_mm: float
    ) -> tuple[Axis, Axis]:
        spans = []
        for axis in (0, 1):
            widest = float(np.diff(lines[axis]).max())
            need = [
                spans_needed((w.f, w.g)[axis] * widest, np.abs(w.c), AIM * tolerance_mm / 2.0) for w in kinds.values()
            ]
            spans.append(max(need))
        result = tuple(Axis(lines[axis], basis(DEGREE, min(spans[axis], MAX_SPANS))) for axis in (0, 1))
        _require_few(result[0], result[1], tolerance_mm, max(spans) > MAX_SPANS)
        return result[0], result[1]


class SampledField:
    """The patches of any height, by interpolation on a grid. Their error is measured on a finer grid."""

    def __init__(self, height: Height, frame: Frame, closed: bool) -> None:
        self._height, self._frame, self._closed = height, frame, closed

    def patches(self, tolerance_mm: float, avoid: Avoid) -> PatchGrid:
        """Return patches within a tolerance of the formula; see :meth:`ExactField.patches`."""
        counts, size = patch_counts(self._height), self._height.size_mm
        closed = (self._closed, False)
        finest = [
            min(
                size[k],
                math.tau / max(self._height.surface.highest_frequency[k], 1e-9),
                self._height.fade.length_mm or 1e9,
            )
            for k in (0, 1)
        ]
        density = _SPANS_AT_FIRST
        while True:
            fewest = [math.ceil(size[k] / finest[k] * density / _MAX_SAMPLED_SPANS) for k in (0, 1)]
            numbers = [max(counts[k], fewest[k], 3 if closed[k] else 1) for k in (0, 1)]
            lines = [lines_along(size[0], numbers[0], avoid.corners[:, 0], self._closed)]
            far = avoid.along_t(lines[0], size[0] if self._closed else None)
            lines.append(lines_along(size[1], numbers[1], far, False))
            spans = [max(MIN_SPANS, math.ceil(np.diff(lines[k]).max() / finest[k] * density)) for k in (0, 1)]
            axes = [Axis(lines[k], basis(DEGREE, spans[k])) for k in (0, 1)]
            _require_few(axes[0], axes[1], tolerance_mm, False)
            values, error = self._interpolated(axes)
            if error <= AIM * tolerance_mm:
                break
            density *= min(2.5, max(1.15, (error / (AIM * tolerance_mm)) ** 0.2))
        _share(values, (axes[0], axes[1]), self._closed)
        return PatchGrid(self._frame, axes[0], axes[1], values, error, False, self._closed)

    def _exact(self, s: Floats, t: Floats) -> Floats | Complexes:
        heights = self._height.grid(s, t)
        return heights if self._frame.radius_mm is None else self._frame.section(s[:, None], heights)

    def _interpolated(self, axes: list[Axis]) -> tuple[dict[tuple[int, int], Floats | Complexes], float]:
        """Interpolate on the whole grid with simple knots, and return the poles of each patch and the largest error."""
        from scipy.interpolate import BSpline, make_interp_spline

        whole, to_patches = [], []
        for axis in axes:
            inner = np.concatenate([axis.knots_mm(i)[1:] for i in range(axis.patches)])[:-1]
            knots = np.concatenate([[axis.lines[0]] * (DEGREE + 1), inner, [axis.lines[-1]] * (DEGREE + 1)])
            places = greville(knots, DEGREE)
            whole.append((knots, np.clip(places, axis.lines[0], axis.lines[-1])))
            local = np.linalg.inv(axis.basis.values(axis.basis.greville))
            to_patches.append(
                [local @ BSpline.design_matrix(axis.abscissae_mm(i), knots, DEGREE) for i in range(axis.patches)]
            )
        exact = self._exact(whole[0][1], whole[1][1])
        along_s = make_interp_spline(whole[0][1], exact, k=DEGREE, t=whole[0][0], axis=0).c
        poles = make_interp_spline(whole[1][1], along_s.T, k=DEGREE, t=whole[1][0], axis=0).c.T
        tests = [_between(knots[DEGREE:-DEGREE]) for knots, _ in whole]
        left, right = (
            BSpline.design_matrix(test, knots, DEGREE) for test, (knots, _) in zip(tests, whole, strict=True)
        )
        off = np.abs((right @ (left @ poles).T).T - self._exact(*tests))
        if self._height.fade.inside is not None:
            off = off[self._height.fade.inside(*tests)]
        error = _BETWEEN * float(off.max())
        values = {
            (i, j): (to_patches[1][j] @ (to_patches[0][i] @ poles).T).T
            for i in range(axes[0].patches)
            for j in range(axes[1].patches)
        }
        return values, error


def _between(breaks: Floats) -> Floats:
    """Return the ends of intervals and some points between them."""
    fractions = np.arange(_TEST_STEPS) / _TEST_STEPS
    return np.append((breaks[:-1, None] + np.diff(breaks)[:, None] * fractions).ravel(), breaks[-1])


def patch_counts(height: Height) -> tuple[int, int]:
    """Return the numbers of patches along s and t, so that no patch has too many waves for the kernel's areas."""
    finest = height.surface.highest_frequency
    counts = [
        max(1, math.ceil(size * f / (math.tau * WAVES_PER_PATCH)))
        for size, f in zip(height.size_mm, finest, strict=True)
    ]
    return counts[0], counts[1]


def _share(values: dict[tuple[int, int], Floats | Complexes], axes: tuple[Axis, Axis], closed: bool) -> None:
    """Give neighbouring patches the same poles on their common edge. Before, they differ by rounding."""
    for (i, j), own in sorted(values.items()):
        if i + 1 < axes[0].patches:
            values[i + 1, j][0] = own[-1]
        elif closed:
            own[-1] = values[0, j][0]
        if j + 1 < axes[1].patches:
            values[i, j + 1][:, 0] = own[:, -1]


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


def _bound(waves: _Waves, s: Axis, t: Axis) -> float:
    """Return the proved bound of the distance between patches and formula; see :func:`..splines.patches.patches`."""
    weight = np.abs(waves.c)
    first = s.error(waves.f, weight)
    both = (waves.f != 0.0) & (waves.g != 0.0)
    single, unit = np.zeros(len(weight)), np.ones(1)
    for frequency in set(waves.f[both].tolist()):
        single[both & (waves.f == frequency)] = s.error(np.array([frequency]), unit)
    second = t.error(waves.g, weight * (1.0 + single))
    rounding = 8.0 * np.finfo(float).eps * float(weight.sum())
    return float(first + second + rounding)
