"""Let a motor slip on a virtual rig, stop the run before the next check, and resume it: no wrong press stays in it."""

from __future__ import annotations

import random
import signal
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest
from helpers.cases import mostly_long
from helpers.emulated import emulated_study
from helpers.rig_here import launch
from helpers.rigs import small_protocol

from tacbench_cad.extensions.virtual_rig import VirtualRig, drivers
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.stage import LimitedStage
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.spec import Point, Study
from tacbench_cad.spec.protocol import PressGrid

pytestmark = pytest.mark.usefixtures("rig_time")
FIRMWARES = ("grbl", "grblhal", "marlin")
STOPS = ("ctrl-c", "two ctrl-c", "kill", "power cut", "sensor")
#: The largest error of a press that a check accepts, in mm: slip_mm and the resolution of the check with Marlin.
WRONG_MM = 0.22


class KilledError(BaseException):
    """The process is killed: no code runs that the run could rely on."""


@dataclass
class Trial(PressProgress):
    """A run with a slip and a stop, on a firmware that outlives the sessions, resumed until it is complete.

    Args:
        firmware: The firmware.
        stop: How the first session ends.
        fault: The slip.
        slip_after: The number of the press before the slip.
        stop_after: The number of the press before the stop.
    """

    firmware: str
    stop: str
    fault: Fault
    slip_after: int
    stop_after: int
    wrong_mm: dict[int, float] = field(default_factory=dict)
    messages: list[str] = field(default_factory=list)
    rig: VirtualRig | None = None
    close: Callable[[], None] = lambda: None
    pending: bool = True
    slipped: bool = False

    def launched(self, kind: str, **options: Any) -> VirtualRig:
        if self.rig is None:
            self.rig = launch(self.firmware, **{**options, "resets_on_open": False})
            self.close, self.rig.close = self.rig.close, lambda: None  # type: ignore[method-assign]
        return self.rig

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        assert self.rig is not None
        true, reported = self.rig.true_position(), self.rig.reported_position()
        number = int(image.stem.split("_")[1])
        self.wrong_mm[number] = max(abs(a - b) for a, b in zip(true, reported, strict=True))
        if done == self.slip_after and not self.slipped:
            self.slipped = True
            self.rig.inject(self.fault)
        if done == self.stop_after and self.pending:
            self.pending = False
            if "ctrl-c" in self.stop:
                signal.raise_signal(signal.SIGINT)
            elif self.stop == "sensor":
                raise RigError("the image is dark")
            else:
                raise KilledError

    def say(self, message: str) -> None:
        self.messages.append(message)
        if self.stop == "two ctrl-c" and message.startswith("checking the position"):
            signal.raise_signal(signal.SIGINT)

    def session(self, out: Path) -> None:
        driver = "virtual-marlin" if self.firmware == "marlin" else "virtual-grbl"
        file = emulated_study(driver, speed=100.0)
        grid = PressGrid(x_mm=(4.0, 9.0), y_mm=(14.0, 18.0, 23.0))
        protocol = small_protocol(grid=grid, repeats=1, stationary_frames=0, clearance_mm=2.0, home_every=50)
        blocks = tuple(replace(block, levels=(2,)) for block in file.study.blocks)
        person = Typing(lambda _: "", lambda _: None)
        study, rig = Study(blocks=blocks, protocol=protocol), file.required_rig
        acquire_study(study, rig, out, person=person, progress=self, durable=False)

    def run(self, out: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
        """Start the run, stop it, and resume it until it is complete."""
        ends = []
        with monkeypatch.context() as patched:
            patched.setattr(drivers, "launch", self.launched)
            try:
                for _ in range(5):
                    try:
                        self.session(out)
                        break
                    except (RigError, RunInterruptedError, KilledError) as error:
                        ends.append(error)
                        if self.stop == "power cut" and isinstance(error, KilledError) and self.rig is not None:
                            self.rig.inject(Fault(kind="reset"))
            finally:
                self.close()
        assert ends, "the run was not stopped"
        self.messages += map(repr, ends)
        (folder,) = out.glob("texture*")
        return Run.open(folder)


def certified_wrong(trial: Trial, run: Run) -> list[int]:
    """Return the presses at a wrong place that the complete run contains without a mark."""
    report = check_run(run.folder)
    assert (report.presses, report.unchecked, report.unchecked_sideways) == (6, 0, 0), trial.messages
    assert not [finding for finding in report.findings if finding.kind == "slip"]
    return [row.number for row in run.rows if trial.wrong_mm[row.number] > WRONG_MM]


CASES = [(firmware, axis, stop) for firmware in FIRMWARES for axis in "xyz" for stop in STOPS]
QUICK = [("grbl", "x", "kill"), ("grblhal", "x", "two ctrl-c"), ("marlin", "y", "sensor")]


@pytest.mark.parametrize(("firmware", "axis", "stop"), mostly_long(CASES, *QUICK))
def test_a_slip_before_a_stop_is_never_certified(
    firmware: str, axis: str, stop: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = Fault(kind="slip", axis=axis, mm=0.625)
    trial = Trial(firmware=firmware, stop=stop, fault=fault, slip_after=2, stop_after=4)
    run = trial.run(tmp_path, monkeypatch)
    assert certified_wrong(trial, run) == [], trial.messages
    if axis != "z":
        aside = sorted((run.folder / "set_aside").glob("*/targets.csv"))
        assert [len(table.read_text().splitlines()) - 1 for table in aside] == [3], "presses 2 to 4 were not checked"
    checked = [check for check in run.position_checks if check.reason == "stopped"]
    assert len(checked) == (stop in ("ctrl-c", "sensor")), trial.messages


@pytest.mark.long
@pytest.mark.parametrize("firmware", FIRMWARES)
def test_a_slip_before_a_stop_after_the_last_press_is_never_certified(
    firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = Fault(kind="slip", axis="x", mm=0.6)
    trial = Trial(firmware=firmware, stop="kill", fault=fault, slip_after=2, stop_after=6)
    run = trial.run(tmp_path, monkeypatch)
    assert certified_wrong(trial, run) == [], trial.messages


@pytest.mark.parametrize("firmware", mostly_long(FIRMWARES, "grbl"))
def test_a_signal_while_a_check_homes_certifies_no_slip(
    firmware: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = Fault(kind="slip", axis="y", mm=-0.6)
    trial = Trial(firmware=firmware, stop="ctrl-c", fault=fault, slip_after=2, stop_after=99)
    measure = LimitedStage.home_offset_mm

    def interrupted(stage: LimitedStage) -> Point | None:
        offset = measure(stage)
        if trial.slipped and trial.pending:
            trial.pending = False
            signal.raise_signal(signal.SIGINT)
        return offset

    monkeypatch.setattr(LimitedStage, "home_offset_mm", interrupted)
    run = trial.run(tmp_path, monkeypatch)
    assert certified_wrong(trial, run) == [], trial.messages
    assert not [check for check in run.position_checks if check.reason == "stopped"], "homing has hidden the slip"


def test_good_presses_before_ctrl_c_are_checked_and_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fault = Fault(kind="slip", axis="x", mm=0.0)
    trial = Trial(firmware="grbl", stop="ctrl-c", fault=fault, slip_after=2, stop_after=4)
    run = trial.run(tmp_path, monkeypatch)
    assert certified_wrong(trial, run) == []
    (check,) = [check for check in run.position_checks if check.reason == "stopped"]
    assert check.ok and check.covers_all_axes and check.after_press == 4
    assert not (run.folder / "set_aside").exists()


@pytest.mark.long
def test_sixty_random_slips_and_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    aside: Counter[int] = Counter()
    for seed in range(60):
        dice = random.Random(seed)
        mm = dice.choice((-1.0, 1.0)) * dice.uniform(0.3, 3.0)
        kind = dice.choice(["slip", "stall"])
        more = {"mm": mm} if kind == "slip" else {"seconds": dice.uniform(0.05, 0.5)}
        fault = Fault(kind=kind, axis=dice.choice("xyz"), **more)  # type: ignore[arg-type]
        slip_after = dice.randrange(1, 5)
        trial = Trial(
            firmware=FIRMWARES[seed % 3],
            stop=STOPS[seed % 5],
            fault=fault,
            slip_after=slip_after,
            stop_after=dice.randrange(slip_after, 6),
        )
        run = trial.run(tmp_path / str(seed), monkeypatch)
        assert certified_wrong(trial, run) == [], (seed, fault, trial.messages)
        aside[len(list((run.folder / "set_aside").glob("*/image_*")))] += 1
    print(f"60 slips before a stop, no wrong press certified; presses set aside: {sorted(aside.items())}")
