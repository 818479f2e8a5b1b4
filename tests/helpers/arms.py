"""Rigs with the simulated arm, which turns the sensor, and protocols with turns."""

from __future__ import annotations

import mmap
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from helpers.rigs import small_protocol
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import Rig
from tacbench_cad.lab.rig.stage import LimitedStage, RotatingStage
from tacbench_cad.lab.simulate.simulated_devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.simulate.simulated_stage import HOME_MM, SimulatedStage
from tacbench_cad.lab.study.spec import (
    Angles,
    GaugeSettings,
    Point,
    PrintedBlock,
    Protocol,
    RigSettings,
    SensorSettings,
    StageSettings,
    WorkFrame,
)
from tacbench_cad.spec.protocol import PressGrid

#: A block that is turned by a quarter turn on the stage.
ARM_RIG = RigSettings(
    stage=StageSettings(
        driver="simulated",
        origin_mm=(110.0, 80.0, 40.0),
        quarter_turns=1,
        limits_mm=((0.0, 200.0), (0.0, 200.0), (0.0, 100.0)),
        travel_mm_s=100.0,
        approach_mm_s=20.0,
    ),
    gauge=GaugeSettings(driver="simulated"),
    sensor=SensorSettings(driver="simulated"),
)
#: The time of the arm.
CLOCK = Clock(speed=10.0)
_POSE = struct.Struct("6d")


class LastingArm(SimulatedStage):
    """An arm that stays where it is when its program is killed. A file has its position and its angles.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            path.write_bytes(_POSE.pack(*HOME_MM, 0.0, 0.0, 0.0))
        with path.open("r+b") as file:
            self._file = mmap.mmap(file.fileno(), _POSE.size)
        x, y, z, rx, ry, rz = _POSE.unpack(self._file[:])
        super().__init__(CLOCK, (x, y, z), (rx, ry, rz))

    def _pose(self) -> tuple[Point, Angles]:
        summit, angles = super()._pose()
        self._file[:] = _POSE.pack(*summit, *angles)
        return summit, angles


def turning_protocol(**changes: Any) -> Protocol:
    """Return a protocol of two presses, each with a turn by 6 degrees in 3 s of rig time."""
    values: dict[str, Any] = {
        "grid": PressGrid(x_mm=(5.0, 8.0), y_mm=(20.0,)),
        "forces_n": (1.0,),
        "bands_n": (0.1,),
        "repeats": 1,
        "stationary_frames": 0,
        "clearance_mm": 2.0,
        "settle_s": 0.05,
        "motion": "roll",
        "motion_frames": 4,
        "turn_angle_deg": 6.0,
        "turn_direction_deg": 90.0,
        "turn_speed_deg_s": 2.0,
        **changes,
    }
    return small_protocol(**values)


@contextmanager
def rig_of(
    arm: RotatingStage, settings: RigSettings, block: PrintedBlock, frame: WorkFrame, clock: Clock = CLOCK
) -> Iterator[Rig]:
    """Make a rig of an arm that is already open, and of a simulated gauge and sensor."""
    stage = LimitedStage(arm, settings.stage.limits_mm, settings.stage.tilt_limit_deg)
    gauge = SimulatedGauge(stage.followed_mm, clock, rotation=stage.followed_deg)
    sensor = SimulatedSensor(stage.followed_mm, clock, rotation=stage.followed_deg, in_motion=lambda: stage.is_tracked)
    rig = Rig(stage=stage, gauge=gauge, sensor=sensor, clock=clock, settings=settings, following=(gauge, sensor))
    rig.put(block, frame)
    yield rig
