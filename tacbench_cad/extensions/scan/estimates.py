"""The results of a fit of a scan: the pose, every parameter with its interval, the points and the printed waves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.spec import Wave
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: What is fitted: the pose; also the scale along x, y and z; also the skew.
Fit = Literal["pose", "scale", "square"]
FITS: tuple[Fit, ...] = get_args(Fit)
#: Half of the width of an interval of 95 %, in standard errors.
HALF_WIDTH = 1.959963984540054


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """The estimate of one parameter.

    Args:
        name: Such as ``shift_x_mm``, ``rotation_z_deg``, ``scale_x``, ``skew_xy``, ``base_mm``, ``wall_offset_mm``.
            Rotations are small rotations of the print about the centre of the block, added to the pose. A shift has
            the value of the pose, and the standard error of the centre of the block, so that it does not depend on
            where the scanner has its origin.
        value: The value. If it is not determined, it is the start or the nominal value.
        standard_error: The standard error; infinite if the scan does not determine the value.
        determined: Whether the scan determines the value.
    """

    name: str
    value: float
    standard_error: float
    determined: bool

    @property
    def low(self) -> float:
        """The lower end of the interval of 95 %."""
        return self.value - HALF_WIDTH * self.standard_error

    @property
    def high(self) -> float:
        """The upper end of the interval of 95 %."""
        return self.value + HALF_WIDTH * self.standard_error


@dataclass(frozen=True, kw_only=True)
class WaveEstimate:
    """How much of a wave of the formula was printed.

    Args:
        wave: The wave of the formula, in mm over the block frame.
        wavelength_mm: Its length.
        direction_deg: The angle of its direction from the x axis, from -90 (excluded) to 90 degrees.
        amplitude_ratio: The printed amplitude divided by the amplitude of the formula. For a wave that cannot be told
            from noise, only its component in phase with the formula counts.
        ratio_low: The lower end of its interval of 95 %.
        ratio_high: The upper end of its interval of 95 %.
        standard_error: The standard error of the ratio.
        phase_deg: The phase of the printed wave relative to the formula.
        phase_low_deg: The lower end of its interval of 95 %.
        phase_high_deg: The upper end of its interval of 95 %.
        is_scale_reference: Whether the scale along z comes from this wave, so that its ratio is 1 by definition.
        is_shift_reference: Whether a shift comes from this wave, so that its phase is 0 by definition.
        determined: Whether the scan determines the wave.
    """

    wave: Wave
    wavelength_mm: float
    direction_deg: float
    amplitude_ratio: float
    ratio_low: float
    ratio_high: float
    standard_error: float
    phase_deg: float
    phase_low_deg: float
    phase_high_deg: float
    is_scale_reference: bool = False
    is_shift_reference: bool = False
    determined: bool = True

    @property
    def amplitude_mm(self) -> float:
        """The amplitude in the formula."""
        return abs(self.wave.amplitude)


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanFit:
    """A scan fitted to a block.

    Args:
        fit: What was fitted.
        pose: The pose, with the scale and the skew.
        parameters: The estimates.
        on_top: The points that belong to the top, shape (n,).
        on_walls: The points that belong to a wall, shape (n,).
        used: The points of the top and of walls that are not outliers, shape (n,).
        deviation_mm: The signed distance of every point from the nearest surface of the block along its outward normal,
            after the pose, the scale and the skew are undone, shape (n,). It is ``nan`` for a point that belongs to
            neither the top nor a wall.
        noise_mm: The standard deviation of single points about the printed surface.
        half_turn: Whether the scan decides between the pose and the pose turned by half a turn about z.
        alternatives: Other poses that explain the scan as well as ``pose``: after a half turn, a shift by a
            wavelength, or upside down. Empty if the scan decides.
        waves: How much of each wave was printed. Empty if the texture is not a sum of waves.
        correlation: The factor by which the standard errors were increased because neighbouring residuals are
            correlated; at least 1.
    """

    fit: Fit
    pose: Pose
    parameters: tuple[Estimate, ...]
    on_top: Bools
    on_walls: Bools
    used: Bools
    deviation_mm: Floats
    noise_mm: float
    half_turn: Literal["decided", "undecidable"]
    alternatives: tuple[Pose, ...] = ()
    waves: tuple[WaveEstimate, ...] = ()
    correlation: float = 1.0

    def parameter(self, name: str) -> Estimate:
        """Return the estimate with a name.

        Raises:
            InputError: The fit has no such parameter.
        """
        for estimate in self.parameters:
            if estimate.name == name:
                return estimate
        raise InputError("parameter", name, f"must be one of {', '.join(p.name for p in self.parameters)}")

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The names of the parameters that the scan does not determine."""
        return tuple(p.name for p in self.parameters if not p.determined)


def wave_direction_deg(wave: Wave) -> float:
    """Return the angle of a wave's direction from the x axis, from -90 (excluded) to 90 degrees."""
    angle = math.degrees(math.atan2(wave.g, wave.f))
    return angle - 180.0 if angle > 90.0 else angle + 180.0 if angle <= -90.0 else angle
