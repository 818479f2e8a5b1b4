"""The TacTip's skin: how far a deviation of the surface below the sensor moves its pins in the image.

The model is that of the simulated sensor. A deviation ``d(x, y)`` of the surface changes the overlap with the dome by
``d`` wherever they touch. The skin spreads the overlap: inside of the skin, the deviation is ``w = d * K``, and the
Fourier transform of ``K`` is ``(1 + q t) exp(-q t)`` for the wavenumber ``q = 2 pi / wavelength`` and the thickness
``t``. A pin is a lever of the length ``L`` that turns with the skin. Its tip therefore moves sideways by ``L grad w``,
and the camera sees this motion with ``focal length / distance`` px per mm.

A wave of the amplitude ``a`` moves the pins by at most ``a L q (1 + q t) exp(-q t)``. The skin is most sensitive to
waves of 6.2 mm. Of waves below 1 mm almost nothing is left.

The sensor is pressed to a given force, so that it does not feel the mean of the deviation.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.protocol import DOME_RADIUS_MM
from tacbench_cad.util.types import Floats

#: The radius of the dome's inside. The skin is the rest up to the outside.
INNER_RADIUS_MM = 18.4
#: The thickness of the skin.
SKIN_MM = DOME_RADIUS_MM - INNER_RADIUS_MM
#: The distance of the pins' tips from the dome's centre in mm, if only their position in the image is known.
TIP_RADIUS_MM = 17.48
#: The distance of the camera's pinhole from the dome's centre, on the side away from the summit, in mm.
CAMERA_BELOW_MM = 48.9
#: The focal length of the camera, in px.
FOCAL_PX = 601.0
#: The length of a pin from the middle of the skin to its tip, in mm.
LEVER_MM = (DOME_RADIUS_MM + INNER_RADIUS_MM) / 2.0 - TIP_RADIUS_MM
#: The motion in the image of a tip at the summit that moves sideways by 1 mm, in px.
PX_PER_MM = FOCAL_PX / (CAMERA_BELOW_MM + TIP_RADIUS_MM)
#: The shift of the pins from which a deviation counts as felt, in px: three standard deviations of a pin's position in
#: frames without motion. This standard deviation is 0.033 px along each axis for the noisiest of the simulated sensors.
FELT_PX = 0.1
#: The smallest fraction of the kernel's weight that must lie on known points.
_MIN_KNOWN = 0.7


def skin_transfer(wavenumber: ArrayLike, thickness_mm: float = SKIN_MM) -> Floats:
    """Return the fraction of a wave that is left inside of the skin.

    Args:
        wavenumber: The wavenumber ``2 pi / wavelength``, in radians per mm.
        thickness_mm: The thickness of the skin.
    """
    depth = np.asarray(wavenumber, dtype=np.float64) * thickness_mm
    return np.asarray((1.0 + depth) * np.exp(-depth))


def shift_px_per_mm(wavelength_mm: ArrayLike) -> Floats:
    """Return the largest shift of a pin for a wave with an amplitude of 1 mm.

    Args:
        wavelength_mm: The wavelength.
    """
    wavenumber = 2.0 * math.pi / np.asarray(wavelength_mm, dtype=np.float64)
    return np.asarray(PX_PER_MM * LEVER_MM * wavenumber * skin_transfer(wavenumber))


def pin_shifts_px(deviation_mm: Floats, step_mm: float) -> Floats:
    """Return the shift of a pin at each place of a deviation map.

    Args:
        deviation_mm: The deviation on a square grid, shape (n, m); NaN where it is unknown.
        step_mm: The distance of neighbouring points.

    Returns:
        The shifts, shape (n, m); NaN where the deviation is unknown over most of the neighbourhood.
    """
    from scipy import fft

    known = np.isfinite(deviation_mm)
    if not known.any():
        return np.full(deviation_mm.shape, np.nan)
    room = math.ceil(8.0 * SKIN_MM / step_mm)
    shape = [fft.next_fast_len(count + room, real=True) for count in deviation_mm.shape]
    along_x, along_y = fft.fftfreq(shape[0], step_mm), fft.rfftfreq(shape[1], step_mm)
    kernel = skin_transfer(2.0 * math.pi * np.hypot(along_x[:, None], along_y[None, :]))
    n, m = deviation_mm.shape

    def spread(values: Floats) -> Floats:
        return np.asarray(fft.irfft2(fft.rfft2(values, shape) * kernel, shape)[:n, :m])

    weight = spread(known.astype(np.float64))
    enough = weight > _MIN_KNOWN
    mean = float(deviation_mm[known].mean())
    inside = spread(np.where(known, deviation_mm - mean, 0.0)) / np.where(enough, weight, np.nan)
    slopes = np.gradient(inside, step_mm) if min(n, m) > 1 else (np.full((n, m), np.nan),) * 2
    return np.asarray(PX_PER_MM * LEVER_MM * np.hypot(*slopes))
