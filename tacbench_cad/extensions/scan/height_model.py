"""Heights and slopes of a block's formula at millions of points, with changed amplitudes and phases of its waves."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from tacbench_cad.spec import Block, Surface, Wave, WaveSum
from tacbench_cad.util.types import Floats

#: The number of values in a table for each period of the shortest wave, and at most.
_STEPS_IN_WAVE = 40
_MAX_TABLE = 200_000
#: How far tables reach beyond the block, as a fraction of its side.
_BEYOND = 0.5


@dataclass(frozen=True, eq=False)
class _Table:
    """A function of one variable and its derivative, by cubic interpolation between equally spaced values.

    With 40 values in the shortest period, the error is below 2e-6 of the amplitude.

    Args:
        start: The first place.
        step: The distance of neighbouring places.
        value: The values.
        slope: The slopes, times ``step``.
        scatter: The variance of the values within the blur about each place, divided by the squared blur. If the blur
            is small, this is the squared slope.
    """

    start: float
    step: float
    value: Floats
    slope: Floats
    scatter: Floats

    @classmethod
    def of(cls, waves: Floats, ends: tuple[float, float], changes: Floats, kept: Floats, blur_mm: float) -> _Table:
        """Sum a table.

        Args:
            waves: The amplitude, the angular frequency and the phase of each wave along the axis, shape (m, 3).
            ends: The first and the last place.
            changes: The changes of the waves; see :class:`Relief`, shape (m, 2).
            kept: The fraction of every wave that the blur leaves, shape (m,).
            blur_mm: The standard deviation of the noise along x and y.
        """
        (amplitude, frequency, phase), (low, high) = waves.T, ends
        highest = float(np.max(np.abs(frequency), initial=2.0 * math.pi / (high - low)))
        step = max(2.0 * math.pi / highest / _STEPS_IN_WAVE, (high - low) / _MAX_TABLE)
        angle = np.arange(low, high + 2.0 * step, step)[:, None] * frequency + phase
        sine, cosine = np.sin(angle), np.cos(angle)
        a, b = (amplitude[:, None] * np.add(changes, (1.0, 0.0))).T
        shown = kept * a, kept * b
        value = sine @ shown[0] + cosine @ shown[1]
        slope = cosine @ (frequency * shown[0]) - sine @ (frequency * shown[1])
        scatter = slope**2
        if blur_mm > 2.0 * step:
            from scipy.ndimage import gaussian_filter1d

            exact = sine @ a + cosine @ b
            mean = gaussian_filter1d(exact, blur_mm / step, mode="nearest")
            square = gaussian_filter1d(exact**2, blur_mm / step, mode="nearest")
            scatter = np.maximum(square - mean**2, 0.0) / blur_mm**2
        return cls(low, step, value, slope * step, scatter)

    def scattered(self, t: Floats) -> Floats:
        """Return the scatter at places, from the nearest value."""
        index = np.clip((t - self.start) / self.step + 0.5, 0.0, len(self.scatter) - 1.0).astype(np.int32)
        return self.scatter[index]

    def __call__(self, t: Floats) -> tuple[Floats, Floats]:
        place = np.clip((t - self.start) / self.step, 0.0, len(self.value) - 1.001)
        index = place.astype(np.int32)
        place -= index
        first, before, after = self.value[index], self.slope[index], self.slope[index + 1]
        rise = self.value[index + 1] - first
        square, cube = 3.0 * rise - 2.0 * before - after, before + after - 2.0 * rise
        value = first + place * (before + place * (square + place * cube))
        return value, (before + place * (2.0 * square + 3.0 * place * cube)) / self.step


@dataclass(frozen=True, eq=False)
class Relief:
    """The formula of a block as it was printed, as far as that is known.

    A wave ``A sin(s)`` of the formula becomes ``A ((1 + a) sin(s) + b cos(s))``. Noise along x and y blurs the heights
    that a scan shows, because each height appears at a wrong place: with the standard deviation ``blur_mm``, a wave of
    the angular frequency k keeps the fraction ``exp(-(k blur)^2 / 2)``.

    Args:
        surface: The formula in mm over the block frame.
        datum_mm: The height of the formula's zero above the underside.
        size_mm: The sides of the block.
        changes: The numbers a and b of each wave, shape (waves, 2).
        shortest_mm: The shortest wavelength that a fit may change. On pixels, waves shorter than two of them look like
            longer ones.
        blur_mm: The standard deviation of the noise along x and y.
    """

    surface: Surface
    datum_mm: float
    size_mm: tuple[float, float]
    changes: Floats
    blur_mm: float = 0.0
    shortest_mm: float = 0.0

    @classmethod
    @lru_cache(maxsize=16)
    def of(cls, block: Block) -> Relief:
        """Return the relief of a block as designed."""
        count = len(block.surface.waves) if isinstance(block.surface, WaveSum) else 0
        return cls(block.surface, block.datum_mm, block.size_mm, np.zeros((count, 2)))

    def changed(self, changes: Floats, blur_mm: float) -> Relief:
        """Return the relief with other changes and another blur."""
        return replace(self, changes=changes, blur_mm=blur_mm)

    @cached_property
    def kept(self) -> Floats:
        """The fraction of each wave that the blur leaves, shape (waves,)."""
        if not isinstance(self.surface, WaveSum):
            return np.zeros(0)
        frequency = np.hypot(*self.surface.table[:, 1:3].T)
        return np.asarray(np.exp(-0.5 * (frequency * self.blur_mm) ** 2))

    @cached_property
    def _shown(self) -> Surface:
        if not isinstance(self.surface, WaveSum) or not (self.blur_mm or self.changes.any()):
            return self.surface
        shown = []
        for wave, (a, b), fraction in zip(self.surface.waves, self.changes, self.kept, strict=True):
            amplitude, phase = wave.amplitude * math.hypot(1.0 + a, b) * fraction, wave.phase + math.atan2(b, 1.0 + a)
            shown.append(Wave(amplitude=amplitude, f=wave.f, g=wave.g, phase=phase))
        return WaveSum(tuple(shown))

    @cached_property
    def _tables(self) -> tuple[_Table, _Table] | None:
        """The tables along x and along y, if every wave runs along one of the axes; None otherwise."""
        if not (isinstance(self.surface, WaveSum) and self.surface.is_separable):
            return None
        table, tables = self.surface.table, []
        for axis, side in enumerate(self.size_mm):
            own = (table[:, 2] != 0.0) == bool(axis)
            ends = (-_BEYOND * side, (1.0 + _BEYOND) * side)
            waves = table[own][:, [0, 1 + axis, 3]]
            tables.append(_Table.of(waves, ends, self.changes[own], self.kept[own], self.blur_mm))
        return tables[0], tables[1]

    def __call__(self, x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the height above the underside and its slopes along x and y at points, each of shape (n,)."""
        if self._tables is not None:
            (p, px), (q, qy) = self._tables[0](x), self._tables[1](y)
            return self.datum_mm + p + q, px, qy
        if not isinstance(self._shown, WaveSum):
            x, y = np.clip(x, 0.0, self.size_mm[0]), np.clip(y, 0.0, self.size_mm[1])
        return (self.datum_mm + self._shown(x, y), *self._shown.gradient(x, y))

    def scatter(self, x: Floats, y: Floats, slope2: Floats) -> Floats:
        """Return the variance of the height by noise along x and y of the size of the blur, divided by its square.

        Without a blur, this is the squared slope. Beside a step that is narrower than the blur it is larger, and on the
        step it is smaller.
        """
        if self._tables is None or self.blur_mm == 0.0:
            return slope2
        return self._tables[0].scattered(x) + self._tables[1].scattered(y)

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """The indices of the waves that have an amplitude and a direction."""
        if not isinstance(self.surface, WaveSum):
            return ()
        return tuple(i for i, w in enumerate(self.surface.waves) if w.amplitude != 0.0 and (w.f, w.g) != (0.0, 0.0))

    @cached_property
    def fitted(self) -> tuple[int, ...]:
        """The indices of the moving waves that a fit may change."""
        if not self.shortest_mm:
            return self.moving
        length = 2.0 * math.pi / np.hypot(*self.surface.table[list(self.moving), 1:3].T)  # type: ignore[attr-defined]
        return tuple(i for i, mm in zip(self.moving, length, strict=True) if mm >= self.shortest_mm)

    def columns(self, x: Floats, y: Floats) -> Floats:
        """Return the derivatives of the height by the numbers a and then b of each fitted wave, shape (n, 2 m)."""
        assert isinstance(self.surface, WaveSum)
        count = len(self.fitted)
        result = np.empty((len(x), 2 * count))
        for j, i in enumerate(self.fitted):
            amplitude, f, g, phase = self.surface.table[i]
            angle = phase + (f * x if f else 0.0) + (g * y if g else 0.0)
            result[:, j] = amplitude * self.kept[i] * np.sin(angle)
            result[:, count + j] = amplitude * self.kept[i] * np.cos(angle)
        return result

    @cached_property
    def rms_mm(self) -> float:
        """The root mean square of the formula about its mean over the block."""
        x, y = (np.linspace(0.0, side, 201) for side in self.size_mm)
        return float(np.std(self.surface.grid(x, y)))
