"""One axis of a top within a tolerance: the allowed tube around a sum of sines, and the fit with the fewest lines."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacbench_cad.geometry.meshing.certify import SPARE, Allowance, AxisProof, derivatives, prove_axis
from tacbench_cad.geometry.meshing.tube import fewest_links
from tacbench_cad.spec.sines import Sines
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The number of samples of the tube for each link.
SAMPLES_PER_LINK = 20
#: The number of points for each radian of the finest wave from which the density of samples is computed.
PLAN_PER_RADIAN = 3.0


@dataclass(frozen=True, kw_only=True)
class SineAxis:
    """A sum of sines along one side of a block.

    Args:
        sines: The sum p, in mm.
        length_mm: The length of the side.
        peak_mm: A position where p has its maximum. The fit has the same height there, and is nowhere higher.
        peak_height_mm: The maximum of p.
    """

    sines: Sines
    length_mm: float
    peak_mm: float
    peak_height_mm: float

    def links_needed(self, allowance: Allowance) -> float:
        """Estimate the number of links of a fit: the integral of ``sqrt(|p''| / (16 w))``. The tube is 2 w wide."""
        t, slope, second, third = self._plan()
        bend = np.hypot(second, third / (2.0 * self._finest))
        return float(_integral(t, np.sqrt(bend / allowance.half_width(slope)))[-1]) / 4.0

    @property
    def _finest(self) -> float:
        return float(np.max(np.abs(self.sines.frequency)))

    def _plan(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return points along the side, and the first three derivatives at these points."""
        count = int(np.clip(PLAN_PER_RADIAN * self._finest * self.length_mm, 50, 200_000))
        t = np.linspace(0.0, self.length_mm, count)
        slope, second, third = derivatives(self.sines, t, [1, 2, 3])
        return t, slope, second, third

    def fit(self, allowance: Allowance) -> tuple[Floats, Floats, AxisProof]:
        """Find the fit with the fewest lines within an allowance, and prove that it is within the allowance.

        Returns:
            The positions of the lines (float32 values) and the heights, shape (n,) each, and the proof.

        Raises:
            InputError: The rounding of the positions alone exceeds the allowance.
        """
        aim = allowance
        while True:
            at, height = self._fewest(aim)
            proof = prove_axis(self.sines, at, height, allowance)
            distance = proof.distance(allowance.fraction)
            if distance <= allowance.tolerance_mm:
                return at, height, proof
            aim = replace(aim, tolerance_mm=min(0.9985, allowance.tolerance_mm / distance) * aim.tolerance_mm)
            if aim.tolerance_mm < 0.5 * allowance.tolerance_mm:
                raise InputError("tolerance", allowance.tolerance_mm, "is too fine for lines in single precision")

    def _fewest(self, allowance: Allowance) -> tuple[Floats, Floats]:
        t = self._samples(allowance)
        value, slope, second, third = derivatives(self.sines, t, [0, 1, 2, 3])
        slope, second, third = np.abs(slope), np.abs(second), np.abs(third)
        whole = allowance.half_width(slope)
        gap = np.diff(t)
        widest = np.maximum(np.append(gap, 0.0), np.append(0.0, gap))
        # subtract the possible effect of the formula and the tube between two samples, and of rounded positions
        spare = (second + allowance.bend(slope, slope, second, third)) * widest**2 / 8.0
        spare += 2.0 * np.spacing(np.float32(self.length_mm)) * np.sqrt(second * whole)
        below, above = (
            np.maximum((1.0 - SPARE) * half - spare, 0.25 * half) for half in allowance.half_widths(self.sines, t)
        )
        low = np.minimum(value - below, self.peak_height_mm)
        high = np.minimum(value + above, self.peak_height_mm)
        low[np.searchsorted(t, self.peak_mm)] = self.peak_height_mm
        at, height = fewest_links(t, low, high)
        return _rounded(at, height, self.peak_height_mm)

    def _samples(self, allowance: Allowance) -> Floats:
        """Return samples such that each interval uses the same fraction of the tube. The peak is one of them."""
        t, slope, second, third = self._plan()
        slope, second, third = np.abs(slope), np.abs(second), np.abs(third)
        bend = np.hypot(second, third / (2.0 * self._finest)) + allowance.bend(slope, slope, second, third)
        density = np.sqrt(bend / allowance.half_width(slope)) * (SAMPLES_PER_LINK / 4.0) + 1e-9
        total = _integral(t, density)
        count = max(16, math.ceil(total[-1]))
        samples = np.interp(np.linspace(0.0, total[-1], count), total, t)
        near = np.abs(samples - self.peak_mm) < 1e-9 * self.length_mm
        near[[0, -1]] = False
        samples = samples[~near]
        if self.peak_mm in (samples[0], samples[-1]):
            return np.asarray(samples)
        return np.insert(samples, np.searchsorted(samples, self.peak_mm), self.peak_mm)


def _integral(t: Floats, density: Floats) -> Floats:
    """Return the running integral by the trapezoid rule, from 0, with the shape of ``t``."""
    return np.append(0.0, np.cumsum(np.diff(t) * (density[1:] + density[:-1]) / 2.0))


def _rounded(at: Floats, height: Floats, peak: float) -> tuple[Floats, Floats]:
    """Move each vertex to a float32 position along its following link. The highest vertex has the peak's height."""
    places = at.astype(np.float32).astype(np.float64)
    keep = np.append(True, np.diff(places) > 0.0)
    at, height, places = at[keep], height[keep], places[keep]
    slope = np.diff(height) / np.diff(at)
    rounded = height + np.append(slope, slope[-1]) * (places - at)
    rounded = np.minimum(rounded, peak)
    rounded[np.argmax(rounded)] = peak
    return places, rounded
