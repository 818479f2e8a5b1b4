"""How long a run takes and how many files it writes, before it starts.

A few presses are made by the press loop on a simulated rig whose clock never waits. The time for all presses follows
from the time that has passed on that clock.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

from tacbench_cad.lab.acquire.block_presses import press_block
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.devices import open_rig
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.study.motion import motion_of
from tacbench_cad.lab.study.spec import PlannedBlock, RigSettings, Study
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import TacbenchError
from tacbench_cad.util.text import counted

#: The number of files of a run folder that are not frames.
TABLES = 6
#: The time of a press on a real rig, as a multiple of the time on the simulated one, which accelerates at once and
#: answers at once: 6.2 s by benchmarks/press_time.py, and 3.9 s.
REAL_TIMES = 1.6
#: The assumed time of a frame, and of a check of the position, which homes the stage, in s.
FRAME_S, CHECK_S = 1.0 / 30.0, 15.0


@dataclass(frozen=True, kw_only=True)
class RunEstimate:
    """The estimated time and number of files of a study.

    Args:
        presses: The number of presses.
        seconds: The time on the rig; None if it cannot be estimated.
        files: The number of files.
    """

    presses: int
    seconds: float | None
    files: int

    def __str__(self) -> str:
        files = f"{counted(self.presses, 'press')}: about {self.files:,} files"
        if self.seconds is None:
            return files
        hours, minutes = divmod(math.ceil(self.seconds / 60.0), 60)
        return f"{files}, {hours} h {minutes:02d} min at the speeds of this rig"


def estimate(study: Study, rig: RigSettings) -> RunEstimate:
    """Estimate the time and the files of a study on a rig with these settings. No device is opened.

    Args:
        study: The study.
        rig: The settings, of which the place of the block, the limits and the speeds are used.
    """
    protocol, blocks = study.protocol, len(study.blocks)
    checks, still = protocol.checks, 4 * protocol.checks.stationary_frames * blocks
    motion, seconds = motion_of(protocol.motion), None
    with contextlib.suppress(TacbenchError):
        each = REAL_TIMES * _seconds_per_press(study, rig) + (0.0 if motion is None else motion.seconds)
        homings = study.presses / checks.home_every + 2 * blocks if checks.home_every else 0.0
        seconds = study.presses * each + still * FRAME_S + homings * CHECK_S
    references = 1 + math.floor((seconds or 0.0) / blocks / checks.reference_every_s)
    each_press = 1 + (protocol.series_frames + 1 if protocol.motion else 0)
    files = study.presses * each_press + still + blocks * (references + TABLES)
    return RunEstimate(presses=study.presses, seconds=seconds, files=files)


def _seconds_per_press(study: Study, rig: RigSettings) -> float:
    """Press the corners of the grid of the first block with every target on simulated devices.

    Raises:
        TacbenchError: The simulated rig cannot make these presses.
    """
    protocol, first = study.protocol, study.blocks[0]
    grid = protocol.positions.grid
    x_mm, y_mm = (tuple(sorted({line[0], line[-1]})) for line in (grid.x_mm, grid.y_mm))
    ends = PressGrid(x_mm=x_mm, y_mm=y_mm)
    touch = "sensor" if protocol.targets.touch == "taught" else protocol.targets.touch
    few = protocol.changed(grid=ends, touch=touch, stationary_frames=0, home_every=0, motion=None)
    simulated = rig.simulated(waits=False)
    planned = PlannedBlock(printed=first.printed, levels=first.levels)
    short = replace(study, blocks=(planned,), protocol=few, holder=rig.holder)
    frame = rig.stage.frame
    with tempfile.TemporaryDirectory() as folder, open_rig(simulated, first.printed, frame) as opened:
        info = RunInfo.of(short, planned, frame, 0, **opened.info)
        began_s = opened.clock.now_s()
        press_block(opened, info, Path(folder) / "run", signals=Signals(), progress=PressProgress(), durable=False)
        return (opened.clock.now_s() - began_s) / len(info.presses)
