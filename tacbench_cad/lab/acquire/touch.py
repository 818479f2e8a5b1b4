"""First touch in depth mode: felt by the gauge, seen by the sensor, or taught by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tacbench_cad.lab.acquire.forces import ContactForce
from tacbench_cad.lab.acquire.safety import Carriage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.study.spec import Protocol
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats32

#: Frames of the free sensor from which its noise is taken.
FREE_FRAMES = 8
#: The change of a frame is the mean of its largest changes, so many of all its numbers (at least one): touch moves a
#: few markers in the middle of the image first.
LARGEST_FRACTION = 0.001
#: A frame shows touch if its change is larger than those of the free frames by so many times their scatter, and by
#: this fraction at the least.
CHANGE_SPREADS = 6.0
#: How much larger it is at the least, as a fraction of the free frames' changes.
MIN_CHANGE = 0.2
#: Touch is found in steps of this fraction of an approach step, once an approach step has met it.
FINE_FRACTION = 0.1

#: Lowers the sensor by so many mm (an approach step at most) and returns the height.
Down = Callable[[float], float]


#: Finds the height of first touch at a place, in mm of the work frame. It gets the place's number, from 1, with the
#: sensor above it at the travel height, and lowers the sensor by the other argument.
Touch = Callable[[int, Down], float]


def _by_steps(carriage: Carriage, protocol: Protocol, begin: Callable[[], None], touches: Callable[[], bool]) -> Touch:
    """Steps down until something says that the sensor touches, then once more from above in finer steps.

    Args:
        carriage: Where the sensor is.
        protocol: Its approach step.
        begin: Is called at the travel height, before the first step.
        touches: Whether the sensor touches where it is.

    Returns:
        What gives the last free height of the fine steps.
    """
    step = protocol.approach_step_mm

    def find(position: int, down: Down) -> float:
        begin()
        while not touches():
            down(step)
        carriage.to_height(carriage.at[2] + 2.0 * step)
        while True:
            free = carriage.at[2]
            down(FINE_FRACTION * step)
            if touches():
                return free

    return find


def by_gauge(carriage: Carriage, protocol: Protocol, force: ContactForce) -> Touch:
    """Touch is where the settled force rises above the free gauge's noise."""
    return _by_steps(carriage, protocol, lambda: None, lambda: force.settled().mean_n > force.touch_n)


def by_sensor(carriage: Carriage, protocol: Protocol, sensor: Sensor, clock: Clock) -> Touch:
    """Touch is where a frame differs from the free sensor's mean by more than free frames do."""
    change = SensorChange()

    def read() -> Floats32:
        carriage.check()
        clock.sleep(protocol.settle_s)
        return np.asarray(sensor.read(), dtype=np.float32)

    def begin() -> None:
        change.learn([read() for _ in range(FREE_FRAMES)])

    return _by_steps(carriage, protocol, begin, lambda: change.seen(read()))


def taught(heights_mm: Sequence[float], positions: int) -> Touch:
    """Touch is where a person found it.

    Args:
        heights_mm: One for all positions, or one for each, in mm of the work frame.
        positions: How many positions there are.

    Raises:
        InputError: There are neither one nor ``positions`` heights, or one is no finite number.
    """
    if len(heights_mm) not in (1, positions) or not all(np.isfinite(heights_mm)):
        raise InputError(
            "first touch", list(heights_mm), f"must be one finite height in mm, or {positions}, one a position"
        )
    return lambda position, _: heights_mm[position - 1 if len(heights_mm) > 1 else 0]


class SensorChange:
    """Tells a touched sensor from a free one by the largest changes of its numbers."""

    def __init__(self) -> None:
        self._mean = np.zeros(0, dtype=np.float32)
        self._limit = 0.0

    def learn(self, free: Sequence[Floats32]) -> None:
        """Take frames of the free sensor, at least three.

        Each is compared with the mean of the others, as a later frame is compared with the mean of all.
        """
        count = len(free)
        self._mean = np.mean(free, axis=0, dtype=np.float32)
        # The mean of the others differs from one frame by count / (count - 1) times what the mean of all does.
        factor = count / (count - 1.0)
        changes = [factor * self._change(frame) for frame in free]
        middle = float(np.mean(changes))
        self._limit = middle + max(CHANGE_SPREADS * float(np.std(changes, ddof=1)), MIN_CHANGE * middle)

    def seen(self, frame: Floats32) -> bool:
        """Whether a frame is not one of the free sensor."""
        return self._change(frame) > self._limit

    def _change(self, frame: Floats32) -> float:
        changes = np.abs(frame - self._mean).ravel()
        largest = max(1, round(LARGEST_FRACTION * changes.size))
        return float(np.mean(np.partition(changes, changes.size - largest)[-largest:]))
