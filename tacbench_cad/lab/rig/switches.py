"""Measuring at an end stop how wrong the position of a stage is."""

from __future__ import annotations

from collections.abc import Callable

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


def offset_at_switch(closed_at: Callable[[float], bool], switch_mm: float, towards: int) -> float:
    """Find the coordinate at which a switch closes, and return the error of the position along its axis.

    Args:
        closed_at: Moves the carriage along the axis to a coordinate, and returns whether the switch is closed there.
        switch_mm: The coordinate at which the switch closed when the stage was homed.
        towards: 1 if the carriage moves to the switch with increasing coordinates, otherwise -1.

    Returns:
        The true coordinate minus the reported coordinate in mm. It is at most 10 mm towards the switch, and at most
        0.6 mm away from it: then the switch did not close, and the true error can be larger.
    """

    def closed(distance_mm: float) -> bool:
        return closed_at(switch_mm + towards * distance_mm)

    distance = -FRONT_MM
    while closed(distance):
        if distance < -MAX_MM:
            return -towards * distance
        distance = 2.0 * distance - COARSE_MM
    for step in (COARSE_MM, FINE_MM):
        while not closed(distance + step):
            distance += step
            if distance >= BEYOND_MM:
                return -towards * distance
        closed(distance)
    return -towards * (distance + FINE_MM / 2.0)
