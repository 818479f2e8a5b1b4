"""A plane wave, and sums of sines of one variable, with bounds, integrals and extremes."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.extremes import Extremes, search_rectangle
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The largest absolute error of the extremes of separable sums and of parallel waves.
EXTREMES_ERROR = 1e-9


@dataclass(frozen=True, kw_only=True)
class Wave:
    """A plane wave ``amplitude * sin(f u + g v + phase)``.

    Args:
        amplitude: Half of the peak-to-peak height.
        f: The angular frequency along u, in radians per unit.
        g: The angular frequency along v, in radians per unit.
        phase: The phase, in radians.

    Raises:
        InputError: A number is not finite.
    """

    amplitude: float
    f: float
    g: float
    phase: float = 0.0

    def __post_init__(self) -> None:
        for name in ("amplitude", "f", "g", "phase"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise InputError(f"wave {name}", value, "must be a finite number")


@dataclass(frozen=True, eq=False)
class Sines:
    """A sum of sines of one variable, ``s(t) = sum A sin(k t + phase)``.

    Args:
        amplitude: The amplitudes, shape (n,).
        frequency: The angular frequencies k, shape (n,).
        phase: The phases in radians, shape (n,).
    """

    amplitude: Floats
    frequency: Floats
    phase: Floats

    @classmethod
    def of(cls, terms: Iterable[tuple[float, float, float]]) -> Sines:
        """Make a sum from ``(amplitude, frequency, phase)`` triples. Without any triple it is zero."""
        table = np.array(list(terms), dtype=np.float64).reshape(-1, 3)
        return cls(table[:, 0].copy(), table[:, 1].copy(), table[:, 2].copy())

    @property
    def is_constant(self) -> bool:
        """Whether the sum does not depend on its variable."""
        return not np.any((self.amplitude != 0.0) & (self.frequency != 0.0))

    def __call__(self, t: ArrayLike, order: int = 0) -> Floats:
        """Return the value or the derivative of the given order at ``t``, with the shape of ``t``."""
        points = np.asarray(t, dtype=np.float64)
        total = np.zeros(points.shape)
        turn = order * (math.pi / 2.0)
        for a, k, phase in zip(self.amplitude, self.frequency, self.phase, strict=True):
            weight = a * k**order if order else a
            if weight != 0.0:
                total += weight * np.sin(k * points + (phase + turn))
        return total

    def bound(self, order: int) -> float:
        """Return an upper bound of ``|s^(order)|`` on the whole line: ``sum |A| |k|^order``."""
        return float(np.sum(np.abs(self.amplitude) * np.abs(self.frequency) ** order))

    def integral(self, low: float, high: float) -> float:
        """Return the integral from ``low`` to ``high`` in closed form.

        The integral of ``sin(k t + c)`` is ``(high - low) sin(k mid + c) sinc(k half)``, where ``mid`` and ``half``
        are the centre and half the length of the interval. This form is exact also for k close to 0.

        Args:
            low: The lower limit.
            high: The upper limit.
        """
        mid, half = (low + high) / 2.0, (high - low) / 2.0
        means = np.sin(self.frequency * mid + self.phase) * np.sinc(self.frequency * half / math.pi)
        return float((high - low) * np.sum(self.amplitude * means))

    def extremes(self, low: float, high: float, error: float = EXTREMES_ERROR) -> Extremes:
        """Find the lowest and the highest value over ``[low, high]``.

        Args:
            low: The lower end of the interval.
            high: The upper end of the interval.
            error: The largest allowed error of the two values, which is proved.

        Returns:
            The values, and the points ``(t, 0)`` at which the sum has them.
        """

        def function(u: ArrayLike, v: ArrayLike, order: tuple[int, int] = (0, 0)) -> Floats:
            return self(u, order[0]) * (0.0 if order[1] else 1.0)

        return search_rectangle(function, (self.bound(2), 0.0, 0.0), (low, high), (0.0, 0.0), error)
