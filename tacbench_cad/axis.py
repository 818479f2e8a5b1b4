"""One axis of a top within a tolerance: the tube that a sum of sines allows and the fit with the fewest lines."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.certify import derivatives
from tacbench_cad.tube import fewest_links
from tacbench_cad.waves import Sines

Floats = NDArray[np.float64]

#: Samples of the tube for each link.
SAMPLES_PER_LINK = 24
#: Points for each radian of the finest wave at which the density of samples is planned.
PLAN_PER_RADIAN = 3.0


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A sum of sines along one side of a block.

    Args:
        sines: The sum p, in mm.
        length_mm: Length of the side.
        peak_mm: A place where p is highest: the fit is exactly as high there, and nowhere higher.
        peak_height_mm: The value of p there.
    """

    sines: Sines
    length_mm: float
    peak_mm: float
    peak_height_mm: float

    def links_needed(self, tolerance_mm: float, share: float) -> float:
        """About how many links a fit takes: the integral of ``sqrt(|p''| / (16 w))`` with the tube's half width w."""
        t, density = self._plan(tolerance_mm, share)
        return float(np.sum(np.diff(t) * (density[1:] + density[:-1]) / 2.0)) / 4.0

    def _plan(self, tolerance_mm: float, share: float) -> tuple[Floats, Floats]:
        """Points along the side and ``sqrt(|p''| / w)`` there, smoothed over the finest wave."""
        finest = float(np.max(np.abs(self.sines.frequency)))
        count = int(np.clip(PLAN_PER_RADIAN * finest * self.length_mm, 50, 200_000))
        t = np.linspace(0.0, self.length_mm, count)
        slope, second, third = derivatives(self.sines, t, [1, 2, 3])
        bend = np.hypot(second, third / (2.0 * finest))
        return t, np.sqrt(bend / _half_width(slope, tolerance_mm, share))

    def fit(self, tolerance_mm: float, share: float) -> tuple[Floats, Floats]:
        """Fewest lines with ``|fit - p| <= share tolerance sqrt(1 + p'^2 / share)``.

        Args:
            tolerance_mm: The whole tolerance.
            share: This axis's part of it.

        Returns:
            Lines (float32 values) and heights, each (n,).
        """
        t = self._samples(tolerance_mm, share)
        value, slope, second, third = derivatives(self.sines, t, [0, 1, 2, 3])
        half = _half_width(slope, tolerance_mm, share)
        bend = np.abs(second) + tolerance_mm * (second**2 + math.sqrt(share) * np.abs(third))
        gap = np.diff(t)
        widest = np.maximum(np.append(gap, 0.0), np.append(0.0, gap))
        half -= bend * widest**2 / 8.0  # what the formula may do between two samples
        half -= 2.0 * np.spacing(np.float32(self.length_mm)) * np.sqrt(np.abs(second) * half.clip(min=0.0))
        half = np.maximum(half, 0.25 * _half_width(slope, tolerance_mm, share))
        peak = self.peak_height_mm
        low, high = np.minimum(value - half, peak), np.minimum(value + half, peak)
        low[np.searchsorted(t, self.peak_mm)] = peak
        at, height = fewest_links(t, low, high)
        return _rounded(at, height, peak)

    def _samples(self, tolerance_mm: float, share: float) -> Floats:
        """Samples at equal steps of the planned density, the place of the peak among them."""
        t, density = self._plan(tolerance_mm, share)
        per_mm = density * (SAMPLES_PER_LINK / 4.0) + 1e-9
        total = np.append(0.0, np.cumsum(np.diff(t) * (per_mm[1:] + per_mm[:-1]) / 2.0))
        count = max(16, math.ceil(total[-1]))
        samples = np.interp(np.linspace(0.0, total[-1], count), total, t)
        near = np.abs(samples - self.peak_mm) < 1e-9 * self.length_mm
        near[[0, -1]] = False
        samples = samples[~near]
        if self.peak_mm in (samples[0], samples[-1]):
            return np.asarray(samples)
        return np.insert(samples, np.searchsorted(samples, self.peak_mm), self.peak_mm)


def _half_width(slope: Floats, tolerance_mm: float, share: float) -> Floats:
    return np.asarray(share * tolerance_mm * np.sqrt(1.0 + slope**2 / share))


def _rounded(at: Floats, height: Floats, peak: float) -> tuple[Floats, Floats]:
    """Move the vertices to float32 lines along the links that they begin; the highest is exactly the peak."""
    places = at.astype(np.float32).astype(np.float64)
    keep = np.append(True, np.diff(places) > 0.0)
    at, height, places = at[keep], height[keep], places[keep]
    slope = np.diff(height) / np.diff(at)
    moved = height + np.append(slope, slope[-1]) * (places - at)
    moved = np.minimum(moved, peak)
    moved[np.argmax(moved)] = peak
    return places, moved
