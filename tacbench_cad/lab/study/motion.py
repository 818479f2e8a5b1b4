"""The motion of the sensor in contact after a press: a slide, a roll or a tilt, from its start to its end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from tacbench_cad.lab.study.rotation import UPRIGHT, Turn, towards
from tacbench_cad.lab.study.spec import Angles, Point, Protocol, plus


@dataclass(frozen=True, kw_only=True)
class Course:
    """The course of a motion in the work frame.

    Args:
        at: Returns the summit and the angles of the sensor after a fraction of the motion, from 0 to 1.
        seconds: The duration at the speed of the protocol.
    """

    at: Callable[[float], tuple[Point, Angles]]
    seconds: float


def turn_of(protocol: Protocol, start_mm: Point, angles_deg: Angles = UPRIGHT) -> Turn:
    """Return the turn of a roll or a tilt.

    Args:
        protocol: The protocol.
        start_mm: The summit at the start, in the work frame.
        angles_deg: The angles at the start. They differ from 0 by the errors of the stage.
    """
    to_deg = towards(protocol.turn_direction_deg, protocol.turn_angle_deg)
    if protocol.motion == "tilt":
        return Turn(summit_mm=start_mm, from_deg=angles_deg, to_deg=to_deg)
    x, y = protocol.contact_shift_mm
    radius = protocol.turn_radius_mm
    return Turn(summit_mm=start_mm, from_deg=angles_deg, to_deg=to_deg, above_mm=radius, by_mm=(x, y, 0.0))


def course_of(protocol: Protocol, start_mm: Point) -> Course:
    """Return the course of the motion after a press.

    Args:
        protocol: The protocol, with a motion.
        start_mm: The summit of the press, in the work frame.
    """
    if protocol.motion in ("roll", "tilt"):
        turn = turn_of(protocol, start_mm)
        return Course(at=turn.at, seconds=turn.angle_deg / protocol.turn_speed_deg_s)
    x, y = protocol.slide_mm

    def at(fraction: float) -> tuple[Point, Angles]:
        return plus(start_mm, (fraction * x, fraction * y, 0.0)), UPRIGHT

    return Course(at=at, seconds=math.hypot(x, y) / protocol.slide_speed_mm_s)
