"""The wavelengths of a block's surface, and the part of its relief that a nozzle can print."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM, TOLERANCE_MM, Tolerance
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.types import Bools, Floats

#: The largest number of samples along a side for the Fourier transform of a spline surface.
_MAX_SAMPLES = 1024
#: Waves with less than this fraction of the variance do not count for the finest ridge of a spline surface.
_NEGLIGIBLE = 0.01
#: The smallest change of a wave's angle that is reported, in degrees.
_TURNED_DEG = 1.0


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The variance of a surface at each wavelength.

    Args:
        wavelength_mm: The wavelengths, ascending, shape (n,).
        variance_mm2: The variance of the height that waves of this length contribute, shape (n,).
        waves: The number of waves of the formula; None for a spline.
    """

    wavelength_mm: Floats
    variance_mm2: Floats
    waves: int | None

    @property
    def finest_ridge_mm(self) -> float:
        """Half of the shortest wavelength. For a spline, 1 % of the variance may have shorter waves."""
        if self.waves is not None:
            return float(self.wavelength_mm[0]) / 2.0
        below = np.cumsum(self.variance_mm2) / self.variance_mm2.sum()
        return float(self.wavelength_mm[np.searchsorted(below, _NEGLIGIBLE)]) / 2.0

    def printable(self, nozzle_mm: float) -> float:
        """Return the fraction of the variance that belongs to waves whose ridges are as wide as the nozzle or wider."""
        return float(self.variance_mm2[self._is_printable(nozzle_mm)].sum() / self.variance_mm2.sum())

    def printable_waves(self, nozzle_mm: float) -> int | None:
        """Return the number of such waves; None if the surface is not a sum of waves."""
        return None if self.waves is None else int(self._is_printable(nozzle_mm).sum())

    def _is_printable(self, nozzle_mm: float) -> Bools:
        return np.asarray(self.wavelength_mm >= 2.0 * nozzle_mm)

    def bands(self) -> list[tuple[float, float, float]]:
        """Return the fraction of the variance in each octave of wavelengths: lower and upper end in mm, fraction."""
        octave = np.floor(np.log2(self.wavelength_mm / 0.1) + 1e-9)
        total = self.variance_mm2.sum()
        rows = []
        for number in np.unique(octave).tolist():
            fraction = float(self.variance_mm2[octave == number].sum() / total)
            if fraction >= 5e-5:
                rows.append((0.1 * 2.0**number, 0.2 * 2.0**number, fraction))
        return rows


def printable_heights(surface: Surface, x: Floats, y: Floats, nozzle_mm: float) -> Floats:
    """Return the heights of a surface without the waves whose ridges are narrower than the nozzle.

    The waves of a sum are left out exactly. For a spline, they are left out of a cosine transform of the heights.

    Args:
        surface: The surface in mm.
        x: The lines of the grid along x in mm, evenly spaced, shape (n,).
        y: The lines of the grid along y in mm, evenly spaced, shape (m,).
        nozzle_mm: The diameter of the nozzle.

    Returns:
        The heights in mm, shape (n, m).
    """
    if (waves := surface.plane_waves) is not None:
        highest = math.pi / nozzle_mm
        return WaveSum(tuple(w for w in waves if math.hypot(w.f, w.g) <= highest)).grid(x, y)
    from scipy.fft import dctn, idctn

    weights = dctn(surface.grid(x, y), type=1)
    turns = [np.arange(len(lines)) / (2.0 * (lines[-1] - lines[0])) for lines in (x, y)]
    weights[np.hypot(turns[0][:, None], turns[1][None, :]) > 0.5 / nozzle_mm] = 0.0
    return np.asarray(idctn(weights, type=1), dtype=np.float64)


def spectrum(block: Block) -> Spectrum:
    """Return the spectrum of a block's surface: exactly for a sum of waves, by a Fourier transform for a spline.

    Before the transform, a plane is subtracted and the edges are faded out by a Hann window.
    """
    surface = block.surface
    if (waves := surface.plane_waves) is not None:
        moving = [w for w in waves if w.amplitude and (w.f or w.g)]
        rows = [(2.0 * math.pi / math.hypot(w.f, w.g), w.amplitude**2 / 2.0) for w in moving]
        table = np.array(sorted(rows))
        return Spectrum(table[:, 0], table[:, 1], len(rows))
    # a cubic spline has two poles more than knots; a surface without knots gets the most samples
    counts = [min(max(len(lines) + 2, 64), _MAX_SAMPLES) if len(lines) else _MAX_SAMPLES for lines in surface.breaks]
    steps = [side / count for side, count in zip(block.size_mm, counts, strict=True)]
    x, y = (
        np.asarray((np.arange(count) + 0.5) * step, dtype=np.float64) for count, step in zip(counts, steps, strict=True)
    )
    z = surface.grid(x, y)
    window = np.multiply.outer(np.hanning(counts[0]), np.hanning(counts[1]))
    plane = np.stack([np.ones(z.size), np.repeat(x, len(y)), np.tile(y, len(x))], axis=1)
    weights = np.sqrt(window.ravel())
    fit = np.linalg.lstsq(plane * weights[:, None], z.ravel() * weights, rcond=None)[0]
    power = np.abs(np.fft.fft2((z - (plane @ fit).reshape(z.shape)) * window)) ** 2
    power[0, 0] = 0.0
    turns = np.hypot(np.fft.fftfreq(counts[0], steps[0])[:, None], np.fft.fftfreq(counts[1], steps[1])[None, :]).ravel()
    order = np.argsort(-turns)[:-1]
    scale = 1.0 / (power.size * float((window**2).sum()))
    return Spectrum(1.0 / turns[order], power.ravel()[order] * scale, None)


def error_note(block: Block) -> str | None:
    """Return a sentence about a texture whose own error needs larger tolerances than the default ones, or None."""
    error = block.surface.error
    if 2.0 * error <= TOLERANCE_MM and error <= STEP_TOLERANCE_MM:
        return None
    needs = f"a STEP file needs a tolerance of at least {error:.2g} mm (here {block.step_tolerance_mm:g} mm)"
    if isinstance(block.sampling, Tolerance):
        needs += f", and a mesh {2.0 * error:.2g} mm (here {block.sampling.mm:g} mm)"
    own = f"{block.texture.name}: the texture itself lies within {error:.2g} mm of its equation"
    return f"{own} ({block.surface.evidence}), so {needs}"


def turned_note(block: Block) -> str | None:
    """Return a sentence about an oblique wave whose angle on the block is not that of the formula, or None.

    The angle changes if a unit has different lengths in mm along x and y.
    """
    waves = block.surface.plane_waves
    if waves is None:
        return None
    per_x, per_y = block.mm_per_unit[:2]
    changes = []
    for w in waves:
        if w.amplitude and w.f and w.g:
            printed, drawn = math.atan2(w.g, w.f), math.atan2(w.g * per_y, w.f * per_x)
            changes.append((round(abs(printed - drawn), 9), math.degrees(drawn) % 180.0, math.degrees(printed) % 180.0))
    largest = max(changes, key=lambda change: change[0], default=(0.0, 0.0, 0.0))
    if largest[0] < math.radians(_TURNED_DEG):
        return None
    _, drawn, printed = largest
    return (
        f"{block.texture.name}: a wave at {drawn:.0f} degrees in the formula lies at {printed:.0f} degrees on the "
        f"block, because a unit is {per_x:.4g} mm along x and {per_y:.4g} mm along y; for exact angles, set the same "
        "mm_per_unit along both, or give wavelength_mm and angle_deg"
    )
