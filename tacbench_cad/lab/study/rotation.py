"""Rotations of the sensor: angles, matrices, rotation vectors, and the directions in which a sensor tilts.

The angles of a rotation are those of the TacTip toolchains: degrees around the fixed axes x, y and z of the work frame,
first around x, then y, then z (extrinsic xyz Euler angles, ``sxyz``). They are all 0 for a sensor that points straight
down. A matrix turns column vectors of the same frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.lab.study.spec import Angles, Point, WorkFrame, minus
from tacbench_cad.spec.protocol import DOME_RADIUS_MM
from tacbench_cad.util.types import Floats

#: The angles of a sensor that points straight down.
UPRIGHT: Angles = (0.0, 0.0, 0.0)
#: A sensor whose angle to the vertical is smaller than this, in degrees, counts as upright. Arms reach 0.05 degrees.
UPRIGHT_DEG = 0.1


def matrix(angles_deg: Angles) -> Floats:
    """Return the matrix of a rotation, shape (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix())


def angles_of(turn: Floats) -> Angles:
    """Return the angles of a matrix. At 90 degrees around y, the angle around z is 0."""
    sin_y = min(max(-float(turn[2, 0]), -1.0), 1.0)
    if abs(sin_y) > 1.0 - 1e-12:
        around_x, around_z = math.atan2(-turn[1, 2], turn[1, 1]), 0.0
    else:
        around_x, around_z = math.atan2(turn[2, 1], turn[2, 2]), math.atan2(turn[1, 0], turn[0, 0])
    return (math.degrees(around_x), math.degrees(math.asin(sin_y)), math.degrees(around_z))


def from_vector(vector_rad: tuple[float, ...]) -> Floats:
    """Return the matrix of a rotation vector: the direction is the axis, the length the angle in radians."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector_rad).as_matrix())


def to_vector(turn: Floats) -> tuple[float, float, float]:
    """Return the rotation vector of a matrix in radians; its length is at most pi."""
    from scipy.spatial.transform import Rotation

    x, y, z = (float(value) for value in Rotation.from_matrix(turn).as_rotvec())
    return (x, y, z)


def towards(direction_deg: float, angle_deg: float) -> Angles:
    """Return the angles of an upright sensor that is turned around a horizontal axis.

    Args:
        direction_deg: The direction in which the top of the sensor leans, and in which a dome rolls, counter-clockwise
            from the x axis.
        angle_deg: The angle of the turn.
    """
    direction, angle = math.radians(direction_deg), math.radians(angle_deg)
    return angles_of(from_vector((-angle * math.sin(direction), angle * math.cos(direction), 0.0)))


def leaning(axis: Floats) -> Floats:
    """Return the turn around a horizontal axis that brings an upright sensor's axis to a direction.

    Args:
        axis: The unit vector from the summit along the sensor's axis.
    """
    x, y, z = (float(value) for value in axis)
    sideways = math.hypot(x, y)
    if sideways == 0.0:
        return np.eye(3) if z > 0.0 else matrix((180.0, 0.0, 0.0))
    angle = math.atan2(sideways, z) / sideways
    return from_vector((-angle * y, angle * x, 0.0))


def angle_between(first_deg: Angles, second_deg: Angles) -> float:
    """Return the angle of the turn from one orientation to another, in degrees, from 0 to 180."""
    return math.degrees(math.hypot(*to_vector(matrix(second_deg) @ matrix(first_deg).T)))


def tilt(angles_deg: Angles) -> float:
    """Return the angle between the axis of the sensor and the vertical, in degrees."""
    return math.degrees(math.acos(min(max(float(matrix(angles_deg)[2, 2]), -1.0), 1.0)))


def above(summit_mm: Point, angles_deg: Angles, distance_mm: float) -> Point:
    """Return the point on the sensor's axis at a distance above its summit: the dome's centre at the dome's radius."""
    x, y, z = (float(value) for value in np.asarray(summit_mm) + distance_mm * matrix(angles_deg)[:, 2])
    return (x, y, z)


def lowest(summit_mm: Point, angles_deg: Angles, radius_mm: float = DOME_RADIUS_MM) -> Point:
    """Return the lowest point of the dome, a sphere. For an upright sensor, it is the summit."""
    if angles_deg == UPRIGHT:
        return summit_mm
    x, y, z = above(summit_mm, angles_deg, radius_mm)
    return (x, y, z - radius_mm)


@dataclass(frozen=True, kw_only=True)
class Turn:
    """A turn about a point on the sensor's axis, around one axis, while this point moves in a straight line.

    Args:
        summit_mm: The summit at the start.
        from_deg: The angles at the start.
        to_deg: The angles at the end.
        above_mm: The distance of the point above the summit: 0 for the summit itself.
        by_mm: The motion of the point.
    """

    summit_mm: Point
    from_deg: Angles
    to_deg: Angles
    above_mm: float = 0.0
    by_mm: Point = (0.0, 0.0, 0.0)

    @property
    def angle_deg(self) -> float:
        """The angle of the whole turn, from 0 to 180 degrees."""
        return math.degrees(math.hypot(*self._vector))

    def at(self, fraction: float) -> tuple[Point, Angles]:
        """Return the summit and the angles after a fraction of the turn, from 0 to 1."""
        x, y, z = (fraction * value for value in self._vector)
        angles = angles_of(from_vector((x, y, z)) @ self._start) if 0.0 < fraction < 1.0 else self._end(fraction)
        x, y, z = (a + fraction * b for a, b in zip(self._point_mm, self.by_mm, strict=True))
        return above((x, y, z), angles, -self.above_mm), angles

    def _end(self, fraction: float) -> Angles:
        return self.from_deg if fraction <= 0.0 else self.to_deg

    @cached_property
    def _start(self) -> Floats:
        return matrix(self.from_deg)

    @cached_property
    def _vector(self) -> tuple[float, float, float]:
        return to_vector(matrix(self.to_deg) @ self._start.T)

    @cached_property
    def _point_mm(self) -> Point:
        return above(self.summit_mm, self.from_deg, self.above_mm)


def in_stage(frame: WorkFrame, turn: Turn) -> Turn:
    """Convert a turn from the work frame of a block to the stage's frame."""
    return Turn(
        summit_mm=frame.to_stage(turn.summit_mm),
        from_deg=in_stage_frame(frame, turn.from_deg),
        to_deg=in_stage_frame(frame, turn.to_deg),
        above_mm=turn.above_mm,
        by_mm=minus(frame.to_stage(turn.by_mm), frame.origin_mm),
    )


def in_work_frame(frame: WorkFrame, angles_deg: Angles) -> Angles:
    """Convert angles from the stage's frame to the work frame of a block, which can be turned by quarter turns."""
    return _in_frame(-90.0 * frame.quarter_turns, angles_deg)


def in_stage_frame(frame: WorkFrame, angles_deg: Angles) -> Angles:
    """Convert angles from the work frame of a block to the stage's frame."""
    return _in_frame(90.0 * frame.quarter_turns, angles_deg)


def _in_frame(turn_deg: float, angles_deg: Angles) -> Angles:
    if turn_deg == 0.0 or angles_deg == UPRIGHT:
        return angles_deg
    turn = matrix((0.0, 0.0, turn_deg))
    return angles_of(turn @ matrix(angles_deg) @ turn.T)
