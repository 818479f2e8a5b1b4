"""Runs on the simulated dome in which a motor slips once, at any moment and along any axis."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from helpers.fakes import Plate
from helpers.rigs import FakeRig, info_of, printed, small_protocol
from tacbench_cad.lab.acquire.block_presses import press_block
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.errors import ContactError, ForceLimitError, PositionLostError, RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.simulate.contact import DomeContact, contact_for
from tacbench_cad.lab.study.spec import HolderRim, Point
from tacbench_cad.spec.protocol import FORCE_SPREADS_N, FORCES_N, PressGrid

#: The smallest slip in mm.
MIN_SLIP_MM = 0.2
#: A press is at a wrong place if the position was wrong by more than this, in mm.
WRONG_MM = 0.1
#: Four positions, three forces: 12 presses.
PROTOCOL = small_protocol(
    grid=PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0)),
    forces_n=FORCES_N,
    bands_n=FORCE_SPREADS_N,
    repeats=1,
    stationary_frames=1,
    home_every=4,
    reference_every_s=1e7,
)


@cache
def dome(texture: int) -> DomeContact:
    """Return the simulated dome over a simulated print of a texture."""
    return contact_for(printed(texture), HolderRim())


@dataclass(frozen=True, kw_only=True)
class DomePlate(Plate):
    """The load of the simulated dome."""

    texture: int = 4

    def force_n(self, at: Point) -> float:
        return dome(self.texture).force_n(*at)


@dataclass(kw_only=True)
class Trial(PressProgress):
    """A run with at most one slip, resumed until it is complete.

    Args:
        texture: The number of the texture.
        folder: The run folder.
        slip: The axis and the length in mm of a slip on the way to a press.
        after_press: The number of the press before that one.

    Attributes:
        wrong_mm: The largest error of the position of each press when its frame was taken, by the number of the press.
        saved_wrong: The number of presses at a wrong place that were saved before the slip was found.
        errors: The errors of the sessions.
    """

    texture: int
    folder: Path
    slip: tuple[int, float] | None = None
    after_press: int = 6
    wrong_mm: dict[int, float] = field(default_factory=dict)
    saved_wrong: int = 0
    errors: list[RigError] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rig = FakeRig(plate=DomePlate(texture=self.texture))
        self.rig.stage.measures_offset = True
        self._read: Callable[[], Frame] = self.rig.sensor.read
        self.rig.sensor.read = self.read  # type: ignore[method-assign]
        self._now_mm = 0.0

    def read(self) -> Frame:
        stage = self.rig.stage
        self._now_mm = max(abs(true - at) for true, at in zip(stage.true, stage.at, strict=True))
        return self._read()

    def pressed(self, done: int, force: Force | None, in_band: bool | None, reading: Path) -> None:
        self.wrong_mm[int(reading.stem.split("_")[1])] = self._now_mm
        self.saved_wrong += self._now_mm > WRONG_MM
        if done == self.after_press and self.slip is not None:
            self.rig.stage.slips[self.rig.stage.calls + 2], self.slip = self.slip, None

    def run(self) -> Run:
        """Start the run, and resume it until it is complete."""
        opened = self.rig.rig()
        for _ in range(4):
            # A rig is homed when it is opened.
            self.rig.stage.home()
            try:
                with Signals() as signals:
                    press_block(
                        opened,
                        info_of(opened, PROTOCOL, self.texture),
                        self.folder,
                        signals=signals,
                        progress=self,
                        durable=False,
                    )
                break
            except (PositionLostError, ContactError, ForceLimitError) as error:
                self.errors.append(error)
        run = Run.open(self.folder)
        assert sorted(row.number for row in run.rows) == list(range(1, 13)), self.errors
        return run

    @property
    def unmarked(self) -> list[int]:
        """The presses at a wrong place that are still in the run."""
        return [row.number for row in Run.open(self.folder).rows if self.wrong_mm[row.number] > WRONG_MM]


def slipping(seed: int, folder: Path) -> tuple[Trial, int, float]:
    """Return a finished run with a slip, the axis and the length of the slip in mm. Presses begin at call 20."""
    dice = random.Random(seed)
    trial = Trial(texture=dice.randrange(1, 7), folder=folder)
    axis, by_mm = dice.randrange(3), dice.choice((-1.0, 1.0)) * dice.uniform(MIN_SLIP_MM, 2.0)
    trial.rig.stage.slips[dice.randrange(20, 400)] = (axis, by_mm)
    trial.run()
    return trial, axis, by_mm
