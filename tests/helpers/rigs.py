"""Rigs of test doubles, and the settings with which blocks are pressed on them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from typing import Any

from helpers.fakes import FakeGauge, FakeSensor, FakeStage, Plate, SlidingStage
from tacbench_cad.lab.acquire.force_search import ContactForce
from tacbench_cad.lab.acquire.press import Presser
from tacbench_cad.lab.acquire.safety import Carriage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import OpenRig
from tacbench_cad.lab.rig.stage import LimitedStage
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.study.spec import (
    GaugeSettings,
    HolderRim,
    PlannedBlock,
    PrintedBlock,
    Protocol,
    RigSettings,
    SensorSettings,
    StageSettings,
    Study,
    WorkFrame,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

#: Waits take no time.
AT_ONCE = Clock(speed=1e12)
LIMITS = ((-100.0, 300.0), (-100.0, 300.0), (-50.0, 50.0))


def small_protocol(**changes: Any) -> Protocol:
    """Return a protocol of 16 presses (four positions, two forces, two repeats) without checks of the position."""
    values: dict[str, Any] = {
        "grid": PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0)),
        "forces_n": (0.08045, 1.91295),
        "bands_n": (0.00195, 0.00985),
        "depths_mm": (0.35, 1.2),
        "stationary_frames": 3,
        "home_every": 0,
        **changes,
    }
    return Protocol().changed(**values)


def printed(texture: int = 1, copy: int = 1) -> PrintedBlock:
    return PrintedBlock(block=Block.of(texture), printer="bambu-p1p", filament="pla-minus", copy=copy)


def study_of(protocol: Protocol, *textures: int) -> Study:
    levels = tuple(range(1, protocol.levels + 1))
    blocks = tuple(PlannedBlock(printed=printed(texture), levels=levels) for texture in textures)
    return Study(blocks=blocks, protocol=protocol)


def rig_settings(**stage: Any) -> RigSettings:
    values: dict[str, Any] = {"driver": "grbl", "limits_mm": LIMITS, **stage}
    return RigSettings(
        stage=StageSettings(**values), gauge=GaugeSettings(driver="serial"), sensor=SensorSettings(driver="opencv")
    )


class FakeRig:
    """A rig of test doubles that a test may open several times."""

    def __init__(self, *, plate: Plate | None = None, gauge: bool = True, slides: bool = False, **stage: Any) -> None:
        self.plate = plate or Plate()
        self.stage = SlidingStage(**stage) if slides else FakeStage(**stage)
        self.gauge: FakeGauge | None = FakeGauge(self.stage, self.plate, noise_n=0.0003) if gauge else None
        self.sensor = FakeSensor(self.stage, self.plate)
        self.opened = 0

    def rig(self, settings: RigSettings | None = None) -> OpenRig:
        return OpenRig(
            stage=LimitedStage(self.stage, LIMITS),
            gauge=self.gauge,
            sensor=self.sensor,
            clock=AT_ONCE,
            settings=settings or rig_settings(),
        )

    def opener(self, settings: RigSettings, block: PrintedBlock, frame: WorkFrame) -> AbstractContextManager[OpenRig]:
        return self._open(settings)

    @contextmanager
    def _open(self, settings: RigSettings) -> Iterator[OpenRig]:
        self.opened += 1
        with self.stage, self.sensor:
            yield self.rig(settings)

    def presser(self, protocol: Protocol) -> Presser:
        """Return the press loop on this rig, with a tared gauge."""
        carriage = Carriage(self.stage, WorkFrame(origin_mm=(0.0, 0.0, 0.0)), protocol, HolderRim())
        force = None if self.gauge is None else ContactForce(self.gauge, carriage, protocol, AT_ONCE)
        if force is not None:
            force.tare()
        return Presser(protocol, carriage, force, None)


def info_of(rig: OpenRig, protocol: Protocol, texture: int = 1, **changes: Any) -> RunInfo:
    info = RunInfo(
        printed=printed(texture),
        levels=tuple(range(1, protocol.levels + 1)),
        protocol=protocol,
        grid_spacing="own",
        holder=HolderRim(),
        frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
        slot=0,
        **rig.info,
    )
    return replace(info, **changes)
