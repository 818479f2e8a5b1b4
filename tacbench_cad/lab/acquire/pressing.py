"""Pressing of one block from Python: any objects as devices, and one function."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from tacbench_cad.lab.acquire.estimate import estimate
from tacbench_cad.lab.acquire.person import Person
from tacbench_cad.lab.acquire.progress import PressProgress, ProgressLines
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.study_file import read_alignment
from tacbench_cad.lab.rig.stage import Limits
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.spec import (
    NO_GAUGE,
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
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


@dataclass(frozen=True, kw_only=True)
class Rig:
    """The devices of a rig, and the place of the block on it.

    A device is an object with the methods of :class:`~tacbench_cad.lab.rig.stage.Stage`,
    :class:`~tacbench_cad.lab.rig.gauge.Gauge` or :class:`~tacbench_cad.lab.rig.sensor.Sensor`, the name of a driver, or
    ``module:name``. Your objects stay open after a run.

    Args:
        stage: The stage.
        sensor: The tactile sensor.
        gauge: The force gauge; None to press to a depth.
        alignment: A TOML file whose table ``[stage]`` has the place of the block (``origin_mm``) and the limits, as
            ``tacbench rig align`` leaves it; or the work frame, and then ``limits_mm`` is needed too.
        limits_mm: The lowest and the highest x, y and z of the stage; None for those of the file.
    """

    stage: Any
    sensor: Any
    gauge: Any = None
    alignment: str | Path | WorkFrame | None = None
    limits_mm: Limits | None = None

    @property
    def settings(self) -> RigSettings:
        """The settings of the rig. No device is opened or moved.

        Raises:
            InputError: The alignment or the limits are missing or not allowed.
        """
        if self.alignment is None:
            how = "is missing; name the TOML file of your rig, or give a WorkFrame and limits_mm; nothing was moved"
            raise InputError("alignment", None, how)
        holder = HolderRim()
        if isinstance(self.alignment, WorkFrame):
            if self.limits_mm is None:
                raise InputError("limits_mm", None, "is missing; a work frame needs the limits of the stage too")
            at = self.alignment
            stage = StageSettings(
                driver=self.stage,
                origin_mm=at.origin_mm,
                quarter_turns=at.quarter_turns,
                limits_mm=self.limits_mm,
            )
        else:
            stage, holder = read_alignment(Path(self.alignment), self.stage)
            if self.limits_mm is not None:
                stage = replace(stage, limits_mm=self.limits_mm)
        return RigSettings(
            stage=stage,
            gauge=GaugeSettings(driver=NO_GAUGE if self.gauge is None else self.gauge),
            sensor=SensorSettings(driver=self.sensor),
            holder=holder,
        )


@dataclass(frozen=True, kw_only=True)
class PressedBlock:
    """The result of :func:`press`. Print it to see what was pressed, how long it took, and what is missing.

    Args:
        folder: The run folder.
        presses: The number of presses that this call has made.
        seconds: The time that it took.
    """

    folder: Path
    presses: int
    seconds: float

    @property
    def run(self) -> Run:
        """The run."""
        return Run.open(self.folder)

    def __str__(self) -> str:
        run = self.run
        info, rows = run.info, run.rows
        saved = {row.number for row in rows}
        missing = [str(press.number) for press in info.presses if press.number not in saved]
        missed = sum(row.in_band is False for row in rows)
        lines = [
            f"{self.folder}: {len(rows)} of {counted(len(info.presses), 'press')} saved",
            f"  this call made {counted(self.presses, 'press')} in {timedelta(seconds=round(self.seconds))}",
            f"  missing: press {', '.join(missing)}" if missing else "  nothing is missing",
        ]
        if missed:
            lines.append(f"  {counted(missed, 'press')} outside of the force band")
        if info.simulated:
            lines.append(f"  simulated: {'; '.join(info.simulated)}")
        return "\n".join(lines)


def press(
    block: Block,
    rig: Rig,
    out: str | Path,
    *,
    printer: str,
    filament: str,
    copy: int = 1,
    protocol: Protocol | None = None,
    progress: PressProgress | None = None,
    **changes: Any,
) -> PressedBlock:
    """Press a printed block that lies in the rig, or resume its run. ``tacbench acquire`` is the same.

    Args:
        block: The block.
        rig: The devices.
        out: The folder of the run folders.
        printer: The name of the printer.
        filament: The name of the filament.
        copy: The number of the copy.
        protocol: The protocol; None for the paper's, and for depths instead of forces on a rig without a gauge.
        progress: Receives progress updates; None to print them to the standard error.
        **changes: Values that differ from the protocol, by their names in a study file: ``depths_mm=(0.5, 1.0)``,
            ``repeats=1``.

    Raises:
        InputError: The alignment is missing, a value is not allowed, or the run was begun with other settings. Nothing
            was moved.
        RigError: A device failed or a limit was exceeded; the run can be resumed.
        RunInterruptedError: A signal interrupted the run, which can be resumed.
    """
    settings, out, began_s = rig.settings, Path(out), time.monotonic()
    spacing = "own" if protocol is not None or "grid" in changes else "even"
    if protocol is None:
        protocol = Protocol().changed(grid=PressGrid.paper(block.scale))
        if rig.gauge is None:
            protocol = protocol.changed(contact="depth", touch="sensor")
        elif "depths_mm" in changes:
            protocol = protocol.changed(contact="depth")
    protocol = protocol.changed(**changes)
    printed = PrintedBlock(
        block=block,
        printer=names.own_name("printer", printer),
        filament=names.own_name("filament", filament),
        copy=copy,
    )
    planned = PlannedBlock(printed=printed, levels=protocol.all_levels)
    study = Study(blocks=(planned,), protocol=protocol, holder=settings.holder, grid_spacing=spacing)
    progress = progress or ProgressLines(out)
    progress.say(str(estimate(study, settings)))
    results = acquire_study(study, settings, out, person=Person(), progress=progress)
    presses = sum(result.presses for result in results)
    return PressedBlock(folder=out / printed.name, presses=presses, seconds=time.monotonic() - began_s)
