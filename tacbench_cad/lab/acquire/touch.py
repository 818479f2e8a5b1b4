"""First touch in depth mode: found by the gauge, by the sensor, or taught by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tacbench_cad.lab.acquire.force_search import ContactForce
from tacbench_cad.lab.acquire.safety import Carriage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.study.spec import Protocol
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats32

#: The number of frames of the free sensor from which its noise is estimated.
FREE_FRAMES = 8
#: The change of a frame is the mean of its largest changes, over this fraction of its values (at least one). A touch
#: first moves a few markers in the middle of the image.
LARGEST_FRACTION = 0.001
#: A frame shows touch if its change exceeds those of the free frames by this multiple of their standard deviation, and
#: by at least MIN_CHANGE.
CHANGE_DEVIATIONS = 6.0
#: The smallest excess of the change, as a fraction of the free frames' changes.
MIN_CHANGE = 0.2
#: The step of the fine search for touch, as a fraction of an approach step, after an approach step has found it.
FINE_FRACTION = 0.1

#: Lowers the sensor by a distance in mm (at most an approach step) and returns the height.
Down = Callable[[float], float]


#: Finds the height of first touch at a position, in mm of the work frame. Its arguments are the number of the position,
#: from 1, with the sensor above it at the travel height, and the function that lowers the sensor.
Touch = Callable[[int, Down], float]


def _by_steps(carriage: Carriage, protocol: Protocol, begin: Callable[[], None], touches: Callable[[], bool]) -> Touch:
    """Find touch with steps down, first coarse, then once more from above in finer steps.

    Args:
        carriage: The carriage of the sensor.
        protocol: The protocol with the approach step.
        begin: Called at the travel height, before the first step.
        touches: Returns whether the sensor touches at its present position.

    Returns:
        A function that returns the last free height of the fine steps.
    """
    step = protocol.steps.approach_step_mm

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
    """Find touch as the height where the settled force exceeds the free gauge's noise."""
    return _by_steps(carriage, protocol, lambda: None, lambda: force.settled().mean_n > force.touch_n)


def by_sensor(carriage: Carriage, protocol: Protocol, sensor: Sensor, clock: Clock) -> Touch:
    """Find touch as the height where a frame differs from the free sensor's mean by more than free frames do."""
    change = SensorChange()

    def read() -> Floats32:
        carriage.check()
        clock.sleep(protocol.steps.settle_s)
        return np.asarray(sensor.read(), dtype=np.float32)

    def begin() -> None:
        change.learn([read() for _ in range(FREE_FRAMES)])

    return _by_steps(carriage, protocol, begin, lambda: change.seen(read()))


def taught(heights_mm: Sequence[float], positions: int) -> Touch:
    """Use heights of touch that a person taught.

    Args:
        heights_mm: One for all positions, or one for each, in mm of the work frame.
        positions: The number of positions.

    Raises:
        InputError: The number of heights is neither one nor ``positions``, or a height is not a finite number.
    """
    if len(heights_mm) not in (1, positions) or not all(np.isfinite(heights_mm)):
        raise InputError(
            "first touch", list(heights_mm), f"must be one finite height in mm, or {positions}, one for each position"
        )
    return lambda position, _: heights_mm[position - 1 if len(heights_mm) > 1 else 0]


class SensorChange:
    """Distinguishes a touched sensor from a free one by the largest changes of its values."""

    def __init__(self) -> None:
        self._mean = np.zeros(0, dtype=np.float32)
        self._limit = 0.0

    def learn(self, free: Sequence[Floats32]) -> None:
        """Learn the noise from at least three frames of the free sensor.

        Each frame is compared with the mean of the others, as a later frame is compared with the mean of all.
        """
        count = len(free)
        self._mean = np.mean(free, axis=0, dtype=np.float32)
        # The difference to the mean of the others is count / (count - 1) times the difference to the mean of all.
        factor = count / (count - 1.0)
        changes = [factor * self._change(frame) for frame in free]
        middle = float(np.mean(changes))
        self._limit = middle + max(CHANGE_DEVIATIONS * float(np.std(changes, ddof=1)), MIN_CHANGE * middle)

    def seen(self, frame: Floats32) -> bool:
        """Return whether a frame differs from the free sensor."""
        return self._change(frame) > self._limit

    def _change(self, frame: Floats32) -> float:
        changes = np.abs(frame - self._mean).ravel()
        largest = max(1, round(LARGEST_FRACTION * changes.size))
        return float(np.mean(np.partition(changes, changes.size - largest)[-largest:]))
