"""A height map as a sum of waves that repeats without a seam, so that a scanned fabric fits a block of any size."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.interpolation import checked_heights, pixel_steps
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The largest number of waves of a fit.
MAX_FITTED = 1000


@dataclass(frozen=True, kw_only=True)
class WaveFit:
    """The waves of a height map, and the difference that remains.

    Args:
        surface: The waves, in mm.
        period_mm: The lengths x and y after which the waves repeat.
        rms_mm: The root mean square of the difference from the seamless height map at its samples.
        largest_mm: The largest difference at its samples.
        seam_mm: The root mean square of the smooth function that was subtracted to make the height map seamless.
        explained: The fraction of the variance of the seamless height map that the waves have.
    """

    surface: WaveSum
    period_mm: tuple[float, float]
    rms_mm: float
    largest_mm: float
    seam_mm: float
    explained: float

    def __str__(self) -> str:
        x, y = self.period_mm
        return (
            f"{len(self.surface.waves)} waves, period {x:.4g} x {y:.4g} mm, rms error {self.rms_mm:.2g} mm, "
            f"at most {self.largest_mm:.2g} mm"
        )


def fit_waves(
    heights: ArrayLike,
    *,
    waves: int,
    mm_per_pixel: float | tuple[float, float] = 1.0,
    height_mm: float | tuple[float, float] | None = None,
) -> WaveFit:
    """Write a height map as a sum of waves.

    The height map is made seamless by the decomposition of Moisan (2011): a smooth function is subtracted, which
    contains the tilt and the differences between opposite edges. The waves are those of the Fourier transform with
    the largest amplitudes.

    Args:
        heights: The heights, as for :func:`tacbench_cad.spec.interpolation.height_map`.
        waves: The number of waves.
        mm_per_pixel: The distance of neighbouring columns, or of neighbouring columns and rows, in mm.
        height_mm: The heights to which the lowest and the highest value are scaled, or their difference; None if the
            values are in mm.

    Raises:
        InputError: The heights or a number are not allowed.
    """
    if isinstance(waves, bool) or not isinstance(waves, int) or not 1 <= waves <= MAX_FITTED:
        raise InputError("waves", waves, f"must be a whole number from 1 to {MAX_FITTED}")
    table = checked_heights(heights, height_mm)
    steps = pixel_steps(mm_per_pixel)
    level = table - table.mean()
    seamless = _periodic_part(level)
    n, m = seamless.shape
    spectrum = np.fft.fft2(seamless) / seamless.size
    rows, columns = np.fft.fftfreq(n, 1.0 / n), np.fft.fftfreq(m, 1.0 / m)
    # one of each two conjugate coefficients; a wave at the Nyquist frequency has no phase of its own
    used = (columns > 0.0) | ((columns == 0.0) & (rows[:, None] > 0.0))
    used &= (rows[:, None] != -n / 2.0) & (columns != -m / 2.0)
    amplitude = np.where(used, 2.0 * np.abs(spectrum), 0.0)
    chosen = np.argsort(-amplitude, axis=None, kind="stable")[:waves]
    chosen = chosen[amplitude.ravel()[chosen] > 0.0]
    made = []
    for i, j in zip(*np.unravel_index(chosen, amplitude.shape), strict=True):
        made.append(
            Wave(
                amplitude=float(amplitude[i, j]),
                f=float(2.0 * math.pi * rows[i] / (n * steps[0])),
                g=float(2.0 * math.pi * columns[j] / (m * steps[1])),
                phase=float(np.angle(spectrum[i, j]) + math.pi / 2.0),
            )
        )
    surface = WaveSum(tuple(made), "mm")
    x, y = (np.arange(count, dtype=np.float64) * step for count, step in zip((n, m), steps, strict=True))
    difference = seamless - seamless.mean() - surface.grid(x, y)
    variance = float(seamless.var())
    return WaveFit(
        surface=surface,
        period_mm=(n * steps[0], m * steps[1]),
        rms_mm=float(np.sqrt(np.mean(difference**2))),
        largest_mm=float(np.abs(difference).max()),
        seam_mm=float(np.std(level - seamless)),
        explained=1.0 - float(np.mean(difference**2)) / variance,
    )


def _periodic_part(heights: Floats) -> Floats:
    """Return the periodic part of the decomposition into a periodic and a smooth function."""
    n, m = heights.shape
    jumps = np.zeros_like(heights)
    across = heights[-1] - heights[0]
    jumps[0] += across
    jumps[-1] -= across
    along = heights[:, -1] - heights[:, 0]
    jumps[:, 0] += along
    jumps[:, -1] -= along
    first, second = (2.0 * np.cos(2.0 * math.pi * np.arange(count) / count) for count in (n, m))
    laplace = first[:, None] + second[None, :] - 4.0
    laplace[0, 0] = 1.0
    smooth = np.fft.fft2(jumps) / laplace
    smooth[0, 0] = 0.0
    return np.asarray(heights - np.real(np.fft.ifft2(smooth)))
