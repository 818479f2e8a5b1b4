"""Measuring at an end stop how wrong the position of a stage is."""

from __future__ import annotations

import math
from collections.abc import Callable

from tacbench_cad.lab.study.spec import Point

#: The distance in front of the expected position of a switch at which the search begins, in mm.
FRONT_MM = 0.3
#: The steps of the search in mm: first coarse, then fine.
COARSE_MM, FINE_MM = 0.1, 0.02
#: The largest distance beyond the expected position to which the carriage moves, in mm. Most switches allow less than
#: 1 mm of motion after they have closed.
BEYOND_MM = 0.6
#: The largest error that is measured, in mm, if the switch closes too early.
MAX_MM = 10.0
#: The speed of the way to the switches and the speed of the search, in mm/s.
WAY_MM_S, SEARCH_MM_S = 20.0, 5.0


class SwitchCheck:
    """Compares two homings at the end stops. It notices if the firmware does not report the switches that it uses."""

    def __init__(self) -> None:
        self._reported: bool | None = None

    def compare(self, measure: Callable[[], Point | None], home: Callable[[], None]) -> Point | None:
        """Measure the error of the position, and home.

        Args:
            measure: Returns the results of :func:`offset_at_switch` for x, y and z; None if it cannot measure.
            home: Homes the stage.

        Returns:
            The true minus the reported position in mm; None if it is unknown.
        """
        offset = measure() if self._reported is not False else None
        home()
        if offset is None:
            return None
        if self._reported is None and _is_beyond(offset):
            # The first homing was wrong, or the firmware homes with something else than the reported switches.
            again = measure()
            home()
            if again is None or _is_beyond(again):
                self._reported = False
                return None
        self._reported = True
        return offset


def _is_beyond(offset_mm: Point) -> bool:
    return any(abs(error) >= BEYOND_MM for error in offset_mm)


def offset_text(error_mm: float) -> str:
    """Return an error of :func:`offset_at_switch` for messages: ``0.25``, or ``at least 0.60`` at a limit."""
    is_limit = any(math.isclose(abs(error_mm), limit_mm, abs_tol=1e-6) for limit_mm in (BEYOND_MM, MAX_MM))
    return f"at least {abs(error_mm):.2f}" if is_limit else f"{error_mm:z.2f}"


def offset_at_switch(
    closed_at: Callable[[float], bool], switch_mm: float, towards: int, *, fine_mm: float = FINE_MM
) -> float:
    """Find the coordinate at which a switch closes, and return the error of the position along its axis.

    Args:
        closed_at: Moves the carriage along the axis to a coordinate, and returns whether the switch is closed there.
        switch_mm: The coordinate at which the switch closed when the stage was homed.
        towards: 1 if the carriage moves to the switch with increasing coordinates, otherwise -1.
        fine_mm: The smallest step, in mm.

    Returns:
        The true coordinate minus the reported coordinate in mm. The limits of the search, :data:`MAX_MM` towards the
        switch and :data:`BEYOND_MM` away from it, mean that the switch was not found: the true error is at least this.
    """

    def closed(distance_mm: float) -> bool:
        return closed_at(switch_mm + towards * distance_mm)

    distance = -FRONT_MM
    while closed(distance):
        if distance < -MAX_MM:
            return towards * MAX_MM
        distance = 2.0 * distance - COARSE_MM
    for step in (COARSE_MM, fine_mm):
        while not closed(distance + step):
            distance += step
            if distance > BEYOND_MM - fine_mm / 2.0:
                return -towards * BEYOND_MM
        closed(distance)
    return -towards * (distance + fine_mm / 2.0)


def offsets_at_switches(
    at_mm: Point,
    rest_mm: Point,
    switch_mm: Point,
    towards: tuple[int, int, int],
    move: Callable[[Point, float], Point],
    is_closed: Callable[[int], bool],
    *,
    fine_mm: float = FINE_MM,
) -> Point:
    """Search the switches of all axes, and return the true position minus the reported one, in mm.

    An axis z that is homed upwards is searched first, and one that is homed downwards last.

    Args:
        at_mm: The present position.
        rest_mm: A position near all switches at which none of them is closed.
        switch_mm: The coordinates at which the switches closed when the stage was homed.
        towards: See :func:`offset_at_switch`, for each axis.
        move: Moves to a position at a speed in mm/s.
        is_closed: Returns whether the switch of an axis is closed.
        fine_mm: The smallest step, in mm.
    """
    at, offsets = [*at_mm], [0.0, 0.0, 0.0]

    def go(axis: int, coordinate_mm: float, speed_mm_s: float) -> None:
        at[axis] = coordinate_mm
        move((at[0], at[1], at[2]), speed_mm_s)

    for axis in (2, 0, 1) if towards[2] > 0 else (0, 1, 2):

        def closed_at(coordinate_mm: float, axis: int = axis) -> bool:
            go(axis, coordinate_mm, SEARCH_MM_S)
            return is_closed(axis)

        go(axis, rest_mm[axis], WAY_MM_S)
        offsets[axis] = offset_at_switch(closed_at, switch_mm[axis], towards[axis], fine_mm=fine_mm)
        go(axis, rest_mm[axis], WAY_MM_S)
    return (offsets[0], offsets[1], offsets[2])
