"""Test doubles of a rig: a stage that arrives at once, an elastic plate, and a gauge and a sensor pressed on it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.rig.stage import Closing, no_report
from tacbench_cad.lab.study.spec import Point


@dataclass(frozen=True, kw_only=True)
class Plate:
    """An elastic load: ``F = stiffness * depth ** power`` below ``top(x, y)``, in N and mm of the stage's frame."""

    top: Callable[[float, float], float] = lambda _x, _y: 0.0
    stiffness: float = 0.47
    power: float = 1.5

    def force_n(self, at: Point) -> float:
        depth = self.top(at[0], at[1]) - at[2]
        return float(self.stiffness * depth**self.power) if depth > 0.0 else 0.0

    def stiffness_n_per_mm(self, force_n: float) -> float:
        """Return the tangent stiffness at the force ``force_n``."""
        depth = (force_n / self.stiffness) ** (1.0 / self.power)
        return self.power * self.stiffness * depth ** (self.power - 1.0)


class FakeStage(Closing):
    """A stage in memory.

    Args:
        at: The first position, in mm.
        step_mm: The resolution; 0 for exact positions.
        faults: The errors to raise, by the number of the call (calls of all kinds are counted together, from 1). A
            move that raises an error stops halfway.
        dead_after: The number of the first failing call, and the error that it and every later call raises.

    Attributes:
        slips: For numbers of calls, the axis (0 to 2) that slips halfway through the move, and by how many mm.
        stalls: For numbers of calls, the axis whose motor does not turn during the move.
        measures_offset: Whether homing measures the error that the position had before.
        true: The true position in mm, which the stage does not know after a slip. Homing makes it known again.
        true_path: The true positions after all moves.
    """

    def __init__(
        self,
        at: Point = (0.0, 0.0, 20.0),
        *,
        step_mm: float = 0.0,
        faults: Mapping[int, Exception] | None = None,
        dead_after: tuple[int, Exception] | None = None,
    ) -> None:
        self.identity = "fake stage 1.0"
        self.simulated = "fake stage"
        self.at = at
        self.step_mm = step_mm
        self.faults = dict(faults or {})
        self.dead_after = dead_after
        self.path: list[Point] = [at]
        self.slips: dict[int, tuple[int, float]] = {}
        self.stalls: dict[int, int] = {}
        self.measures_offset = False
        self.true = at
        self.true_path: list[Point] = [at]
        self.calls = 0
        self.homed = 0
        self.stopped = 0
        self.closed = False
        self.on_move: Callable[[Point], None] = lambda _: None

    def _call(self) -> Exception | None:
        self.calls += 1
        if self.dead_after is not None and self.calls >= self.dead_after[0]:
            raise self.dead_after[1]
        return self.faults.pop(self.calls, None)

    def home(self) -> None:
        self._call()
        self.homed += 1
        self.true = (self.at[0], self.at[1], self.true[2])
        self._go((self.at[0], self.at[1], 20.0))
        self.true = self.at

    def home_offset_mm(self) -> Point | None:
        x, y, z = (true - at for true, at in zip(self.true, self.at, strict=True))
        self.home()
        return (x, y, z) if self.measures_offset else None

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        error = self._call()
        if self.step_mm:
            x, y, z = (round(coordinate / self.step_mm) * self.step_mm for coordinate in target_mm)
            target_mm = (x, y, z)
        if error is not None:
            x, y, z = ((a + b) / 2.0 for a, b in zip(self.at, target_mm, strict=True))
            self._go((x, y, z))
            raise error
        self._go(target_mm)
        self.on_move(target_mm)
        return self.at

    def _go(self, target_mm: Point) -> None:
        true = [true + b - a for true, a, b in zip(self.true, self.at, target_mm, strict=True)]
        if self.calls in self.stalls:
            axis = self.stalls[self.calls]
            true[axis] = self.true[axis]
        if self.calls in self.slips:
            axis, by_mm = self.slips[self.calls]
            true[axis] += by_mm
        self.true = (true[0], true[1], true[2])
        self.true_path.append(self.true)
        self.at = target_mm
        self.path.append(target_mm)

    def position(self) -> Point:
        error = self._call()
        if error is not None:
            raise error
        return self.at

    def stop(self) -> None:
        self.stopped += 1

    def close(self) -> None:
        self.closed = True


class SlidingStage(FakeStage):
    """A stage that needs time for a sideways move in contact, and moves in step with the frames of a sensor.

    Args:
        parts: The number of parts of the move.
        frames_each: The number of frames that the sensor delivers after each part.
        reports: Whether the stage reports its position after each part.

    Attributes:
        slides: The number of slides.
        on_part: Called with the number of each part, from 1, before it.
    """

    def __init__(self, *, parts: int = 12, frames_each: int = 2, reports: bool = True, **stage: Any) -> None:
        super().__init__(**stage)
        self._parts, self._frames_each = parts, frames_each
        self._reports = reports
        self._report: Callable[[Point], None] = no_report
        self.slides = 0
        self.on_part: Callable[[int], None] = lambda _: None
        self._allowed: int | None = None
        self._turn = threading.Condition()

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        if target_mm[:2] == self.at[:2] or target_mm[2] >= 2.0:
            return super().move(target_mm, speed_mm_s)
        self.slides += 1
        start, stopped = self.at, self.stopped
        try:
            for part in range(1, self._parts + 1):
                self.on_part(part)
                x, y, z = (a + part / self._parts * (b - a) for a, b in zip(start, target_mm, strict=True))
                self._go((x, y, z))
                if self._reports:
                    self._report(self.at)
                with self._turn:
                    self._allowed = self._frames_each
                    self._turn.notify_all()
                    while self._allowed and self.stopped == stopped:
                        self._turn.wait(0.01)
                if self.stopped > stopped:
                    raise RigError("the move was stopped on request")
        finally:
            with self._turn:
                self._allowed = None
                self._turn.notify_all()
        return self.at

    def report_to(self, receive: Callable[[Point], None]) -> None:
        self._report = receive

    @staticmethod
    def pause() -> None:
        """Let the other threads work. A device that answers at once would keep them from it."""
        time.sleep(0.001)

    def wait_for_turn(self) -> None:
        """Let the sensor wait during a slide until the stage has made its next part."""
        self.pause()
        with self._turn:
            while self._allowed == 0:
                self._turn.wait()
            if self._allowed is not None:
                self._allowed -= 1
                self._turn.notify_all()


class FakeGauge(Closing):
    """A gauge on the plate under a stage.

    Args:
        stage: The stage that moves the sensor.
        plate: The load under the sensor.
        noise_n: The standard deviation of a sample.
        drift_n: A function of the number of earlier samples; its value is added to each sample.
        faults: The error to raise, or the value to return, by the number of the sample from 1.
    """

    def __init__(
        self,
        stage: FakeStage,
        plate: Plate,
        *,
        noise_n: float = 0.0,
        drift_n: Callable[[int], float] = lambda _: 0.0,
        faults: Mapping[int, Exception | float] | None = None,
        seed: int = 0,
    ) -> None:
        self.identity = "fake gauge"
        self.simulated = "fake gauge"
        self.calibration: dict[str, object] = {}
        self.stage = stage
        self.plate = plate
        self.noise_n = noise_n
        self.drift_n = drift_n
        self.faults = dict(faults or {})
        self.readings: list[float] = []
        self.tared = 0
        self.closed = False
        self.temperature_c: float | None = None
        self._offset = 0.0
        self._random = np.random.default_rng(seed)

    def _now(self) -> float:
        noise = self.noise_n * float(self._random.standard_normal()) if self.noise_n else 0.0
        return self.plate.force_n(self.stage.true) + self.drift_n(len(self.readings)) + noise

    def read(self, window_s: float) -> Force:
        if isinstance(self.stage, SlidingStage):
            self.stage.pause()
        fault = self.faults.pop(len(self.readings) + 1, None)
        value = fault if isinstance(fault, float) else self._now() - self._offset
        self.readings.append(value)
        if isinstance(fault, Exception):
            raise fault
        return Force(mean_n=value, spread_n=self.noise_n, samples=1, temperature_c=self.temperature_c)

    def tare(self) -> None:
        self.tared += 1
        self._offset = self._now()

    def close(self) -> None:
        self.closed = True


class FakeSensor(Closing):
    """An image sensor: a noisy pattern whose middle grows brighter with the force on it.

    Args:
        stage: The stage that moves the sensor.
        plate: The load under the sensor.
        faults: The error to raise, by the number of the frame from 1.
        size: The height and width of a frame, in pixels.
    """

    def __init__(
        self,
        stage: FakeStage,
        plate: Plate,
        *,
        faults: Mapping[int, Exception] | None = None,
        size: tuple[int, int] = (48, 64),
        seed: int = 0,
    ) -> None:
        self.name = "fake sensor"
        self.units = "counts"
        self.shape: tuple[int, ...] = size
        self.simulated = "fake sensor"
        self.settings: dict[str, Any] = {"requested": {"exposure": 5}, "actual": {"exposure": 5}}
        self.stage = stage
        self.plate = plate
        self.faults = dict(faults or {})
        self.count = 0
        self.closed = False
        self._random = np.random.default_rng(seed)
        self._pattern = 60.0 * (np.indices(size).sum(axis=0) % 8 < 3) + 40.0

    def read(self) -> Frame:
        if isinstance(self.stage, SlidingStage):
            self.stage.wait_for_turn()
        self.count += 1
        fault = self.faults.pop(self.count, None)
        if fault is not None:
            raise fault
        image = self._pattern.copy()
        image[20:28, 28:36] *= 1.0 + 5.0 * self.plate.force_n(self.stage.true)
        image += 1.4 * self._random.standard_normal(self.shape)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def close(self) -> None:
        self.closed = True
