"""Stages, gauges and sensors that do as they should, and copies of each with one defect."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import DeviceLostError, OutOfRangeError, RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.stage import Closing

Point = tuple[float, float, float]
TRAVEL_MM = 100.0


class GoodStage(Closing):
    """A stage whose carriage moves in time. Its firmware refuses targets outside of 0 to 100 mm."""

    def __init__(self, clock: Clock | None = None) -> None:
        self.identity, self.simulated = "good stage 1.0", "stage (test double)"
        self.clock = clock or Clock()
        self.start = self.target = (50.0, 50.0, 50.0)
        self.began_s = self.ends_s = 0.0
        self.stopped, self.open = False, True

    def home(self) -> None:
        self.start = self.target = (50.0, 50.0, 50.0)
        self.ends_s, self.stopped = 0.0, False

    def carriage(self) -> Point:
        part = 1.0
        if (now := self.clock.now_s()) < self.ends_s:
            part = (now - self.began_s) / (self.ends_s - self.began_s)
        x, y, z = (a + part * (b - a) for a, b in zip(self.start, self.target, strict=True))
        return (x, y, z)

    def position(self) -> Point:
        if not self.open:
            raise DeviceLostError("good stage: is closed")
        return self.carriage()

    def begin(self, target: Point, speed_mm_s: float) -> None:
        if not all(0.0 <= value <= TRAVEL_MM for value in target):
            self.refuse(target)
        self.start = self.carriage()
        self.target, self.began_s = self.limited(target), self.clock.now_s()
        self.ends_s = self.began_s + math.dist(self.start, target) / speed_mm_s

    def refuse(self, target: Point) -> None:
        raise OutOfRangeError(f"good stage: {target} is beyond its limits")

    def limited(self, target: Point) -> Point:
        return target

    def wait(self) -> None:
        while self.clock.now_s() < self.ends_s:
            self.clock.sleep(0.01)
            if self.stopped:
                raise RigError("good stage: was stopped on request")

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        if self.stopped:
            raise RigError("good stage: was stopped; home it first")
        self.begin(target_mm, speed_mm_s)
        self.wait()
        return self.position()

    def stop(self) -> None:
        at = self.carriage()
        self.start = self.target = at
        self.stopped = True

    def close(self) -> None:
        self.open = False


class Inches(GoodStage):
    """Reports its position in inches."""

    def position(self) -> Point:
        x, y, z = super().position()
        return (x / 25.4, y / 25.4, z / 25.4)


class MmPerMinute(GoodStage):
    """Takes the speed as mm/min."""

    def begin(self, target: Point, speed_mm_s: float) -> None:
        super().begin(target, speed_mm_s / 60.0)


class NotBlocking(GoodStage):
    """Returns when the move has begun."""

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        self.begin(target_mm, speed_mm_s)
        return target_mm


class SilentClamp(GoodStage):
    """Goes to the end of its travel and says nothing."""

    def refuse(self, target: Point) -> None:
        pass

    def limited(self, target: Point) -> Point:
        x, y, z = (min(max(value, 0.0), TRAVEL_MM) for value in target)
        return (x, y, z)


class WrongClass(GoodStage):
    """Raises an exception that the program does not know."""

    def refuse(self, target: Point) -> None:
        raise ValueError(f"{target} is beyond the limits")


class StopIgnored(GoodStage):
    """Moves on after a stop."""

    def stop(self) -> None:
        pass


class MovesOn(GoodStage):
    """Says that it was stopped, but the carriage moves on."""

    def stop(self) -> None:
        self.stopped = True


class NoRecovery(GoodStage):
    """Cannot be homed after a stop."""

    def home(self) -> None:
        if self.stopped:
            raise OSError("arm is locked")


class Coarse(GoodStage):
    """Cannot make small moves."""

    def limited(self, target: Point) -> Point:
        x, y, z = (round(value / 0.05) * 0.05 for value in target)
        return (x, y, z)


class UsableAfterClose(GoodStage):
    """Reports a position although it is closed."""

    def close(self) -> None:
        pass


class NoIdentity(GoodStage):
    """Does not say which device it is."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self.identity = ""


#: Each wrong stage with the checks that it must fail, and no others.
STAGES: dict[type[GoodStage], set[str]] = {
    GoodStage: set(),
    Inches: {"unit", "small move"},
    MmPerMinute: {"speed"},
    NotBlocking: {"blocking", "stop"},
    SilentClamp: {"limits"},
    WrongClass: {"limits"},
    StopIgnored: {"stop"},
    MovesOn: {"stop"},
    NoRecovery: {"recovery"},
    Coarse: {"small move"},
    UsableAfterClose: {"close"},
    NoIdentity: {"identity"},
}


class GoodGauge(Closing):
    """A gauge with a little noise; ``mass_g`` lies on it."""

    factor, late = 1.0, False

    def __init__(self, clock: Clock | None = None) -> None:
        self.identity, self.simulated, self.calibration = "good gauge", "gauge (test double)", {}
        self.clock = clock or Clock()
        self.random = np.random.default_rng(1)
        self.mass_g, self.zero_n, self.open = 0.0, 0.0, True

    def put(self, mass_g: float) -> None:
        self.mass_g = mass_g

    def samples(self, window_s: float) -> Any:
        self.clock.sleep(window_s)
        force_n = self.factor * 9.80665e-3 * self.mass_g
        return force_n + self.random.normal(0.0, 0.001, max(1, round(80 * window_s)))

    def read(self, window_s: float) -> Force:
        if not self.open:
            raise DeviceLostError("good gauge: is closed")
        values = self.samples(window_s)
        return Force(mean_n=float(values.mean()) - self.zero_n, spread_n=float(values.std()), samples=len(values))

    def tare(self) -> None:
        self.zero_n += self.read(0.5).mean_n

    def close(self) -> None:
        self.open = False


class WrongSign(GoodGauge):
    """Is negative in compression."""

    factor = -1.0


class Grams(GoodGauge):
    """Returns grams."""

    factor = 1000.0 / 9.80665


class Buffered(GoodGauge):
    """Returns the samples that have arrived before the call."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self.buffer: Any = None

    def samples(self, window_s: float) -> Any:
        values = super().samples(window_s)
        self.buffer, before = values, self.buffer
        return values if before is None else before


class NoWindow(GoodGauge):
    """Returns at once."""

    def samples(self, window_s: float) -> Any:
        return super().samples(0.0)


class Number(GoodGauge):
    """Returns a number instead of a force."""

    def read(self, window_s: float) -> Force:
        return super().read(window_s).mean_n  # type: ignore[return-value]


class NoTare(GoodGauge):
    """Has a constant force and no tare."""

    def samples(self, window_s: float) -> Any:
        return super().samples(window_s) + 0.5

    def tare(self) -> None:
        pass


#: Each wrong gauge with the checks that it must fail, and no others.
GAUGES: dict[type[GoodGauge], set[str]] = {
    GoodGauge: set(),
    WrongSign: {"sign"},
    Grams: {"unit"},
    Buffered: {"fresh samples"},
    NoWindow: {"window"},
    NoTare: {"tare"},
}


class GoodSensor(Closing):
    """A camera whose frames are noise."""

    channels = "rgb"

    def __init__(self, clock: Clock | None = None) -> None:
        self.name, self.units, self.shape = "good sensor", "counts", (12, 16, 3)
        self.simulated = "sensor (test double)"
        self.settings: dict[str, Any] = {"requested": {}, "actual": {}}
        self.random, self.count, self.open = np.random.default_rng(2), 0, True

    def frame(self) -> Any:
        return self.random.integers(0, 255, self.shape, dtype=np.uint8)

    def read(self) -> Any:
        if not self.open:
            raise DeviceLostError("good sensor: is closed")
        self.count += 1
        return self.frame()

    def close(self) -> None:
        self.open = False


class ChangingShape(GoodSensor):
    """Returns frames of another size from the fifth on."""

    def frame(self) -> Any:
        return super().frame()[: 12 if self.count < 5 else 10]


class SharedMemory(GoodSensor):
    """Writes each frame to the same array."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self.memory = np.zeros(self.shape, dtype=np.uint8)

    def frame(self) -> Any:
        self.memory[:] = super().frame()
        return self.memory


class Frozen(GoodSensor):
    """Returns the same picture for ever."""

    def frame(self) -> Any:
        return np.full(self.shape, 7, dtype=np.uint8)


class NotPlain(GoodSensor):
    """Has an array among its settings."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(clock)
        self.settings = {"requested": {}, "actual": {"gain": np.zeros(3)}}


class NothingYet(GoodSensor):
    """Returns None until its first frame has arrived."""

    def frame(self) -> Any:
        return None if self.count == 1 else super().frame()


#: Each wrong sensor with the checks that it must fail, and no others.
SENSORS: dict[type[GoodSensor], set[str]] = {
    GoodSensor: set(),
    ChangingShape: {"shape"},
    SharedMemory: {"memory"},
    Frozen: {"fresh frames"},
    NotPlain: {"settings"},
    NothingYet: {"read"},
}

Factory = Callable[..., Any]
