"""Pressing of a whole study on one rig: the next block, its slot, and the end of the last session."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Len

from tacbench_cad.lab.acquire.block_presses import BlockResult, press_block
from tacbench_cad.lab.acquire.person import Person
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import RunInterruptedError, travel_height_mm
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.acquire.slips import require_repeatable_homing
from tacbench_cad.lab.rig.devices import OpenRig, open_rig, recorded_gauge, recorded_stage
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.rig.registry import find_driver
from tacbench_cad.lab.rig.stage import Limits
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run, since_good_check
from tacbench_cad.lab.runs.schema import RUN_FILE, STATIONARY
from tacbench_cad.lab.study.presses import block_order
from tacbench_cad.lab.study.spec import HolderRim, PlannedBlock, PrintedBlock, Protocol, RigSettings, Study, WorkFrame
from tacbench_cad.util.convert import read_toml
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, write_text
from tacbench_cad.util.text import counted

#: The file in a run folder with the heights of first touch that a person taught.
TAUGHT_FILE = "touch.toml"

Opener = Callable[[RigSettings, PrintedBlock, WorkFrame], AbstractContextManager[OpenRig]]


@dataclass(frozen=True, kw_only=True)
class Place:
    """A block of the study and its place on the rig.

    Args:
        study: The study, with the holder of the rig.
        planned: The block.
        slot: The slot of the tray, from 0.
        frame: The work frame of the block.
        folder: The run folder.
    """

    study: Study
    planned: PlannedBlock
    slot: int
    frame: WorkFrame
    folder: Path

    @property
    def printed(self) -> PrintedBlock:
        """The printed block."""
        return self.planned.printed

    @property
    def label(self) -> str:
        """The text on the underside of a block that was printed with its label: ``T4 PAPER X1 02``."""
        return " ".join(replace(self.printed.in_file, copy=self.printed.copy).label_words)

    @property
    def run(self) -> Run | None:
        """The run of the block; None before it begins."""
        return Run.open(self.folder) if (self.folder / RUN_FILE).exists() else None

    def info(self, **devices: Mapping[str, Any]) -> RunInfo:
        """Return the expected description of the run, with the devices' own descriptions."""
        return RunInfo.of(self.study, self.planned, self.frame, self.slot, **devices)


def places(study: Study, rig: RigSettings, out: Path) -> tuple[Place, ...]:
    """Return every block of a study in the order of pressing, each with its slot.

    The slots are filled in turn, so a block has the same slot in every session.
    """
    held, slots = replace(study, holder=rig.holder), list(enumerate(rig.stage.frames))
    return tuple(
        Place(study=held, planned=planned, slot=slot, frame=frame, folder=out / planned.printed.name)
        for planned, (slot, frame) in zip(block_order(study), itertools.cycle(slots), strict=False)
    )


def require_reach(protocol: Protocol, holder: HolderRim, frames: Sequence[WorkFrame], limits_mm: Limits) -> None:
    """Check before any motion that a protocol stays within the stage's limits.

    Args:
        protocol: The protocol with grid, clearance and depth limit.
        holder: The rim of the holder, over which the sensor travels.
        frames: The work frame of each used slot.
        limits_mm: The stage's lowest and highest x, y, z.

    Raises:
        InputError: A position is beyond a limit. The message has slot, axis and numbers.
    """
    heights = (-protocol.limits.depth_limit_mm, travel_height_mm(protocol, holder))
    for slot, frame in enumerate(frames, start=1):
        points = protocol.path_mm().reshape(-1, 2)
        places = [frame.to_stage((float(x), float(y), z)) for x, y in points for z in heights]
        for axis, (low, high) in enumerate(limits_mm):
            lowest, highest = min(place[axis] for place in places), max(place[axis] for place in places)
            if not (low <= lowest and highest <= high):
                raise InputError(
                    f"[stage] limits_mm {'xyz'[axis]}",
                    [low, high],
                    f"slot {slot} needs {lowest:.3f} to {highest:.3f} mm "
                    "(positions, motions, clearance and depth limit)",
                )


def acquire_study(
    study: Study,
    rig: RigSettings,
    out: Path,
    *,
    person: Person,
    progress: PressProgress,
    durable: bool = True,
    opener: Opener = open_rig,
    give_up: Callable[[RunInterruptedError], None] = lambda error: None,
) -> tuple[BlockResult, ...]:
    """Press every block of a study that is not complete yet.

    The person puts in as many blocks at a time as the stage has slots. The devices stay open from block to block.
    The person is not asked if stage and sensor are both simulated, unless the person is always asked.

    Args:
        study: The blocks and the protocol.
        rig: The devices.
        out: The folder of the run folders.
        person: Puts the blocks in.
        progress: Receives progress updates.
        durable: See :meth:`tacbench_cad.lab.runs.run_writer.RunWriter.open`.
        opener: Opens the devices.
        give_up: Called in another thread before the process ends, because a device does not return after a signal.

    Returns:
        The results at all blocks that were not complete.

    Raises:
        InputError: The study cannot be pressed on this rig, or a run was begun with other settings.
        MissingToolError: The motion of the protocol belongs to an extension that is not installed.
        RigError: A device failed or a limit was exceeded; the run can be resumed.
        RunInterruptedError: A signal interrupted the run, which can be resumed. The error says whether the sensor is
            lifted and how many presses are saved.
    """
    rig.require_gauge_for(study.protocol)
    slots = rig.stage.frames
    require_reach(study.protocol, rig.holder, slots, rig.stage.limits_mm)
    results: list[BlockResult] = []
    blocks = places(study, rig, out)

    def leave(error: RunInterruptedError) -> None:
        error.saved, error.planned = _saved(blocks), study.presses
        give_up(error)

    with Signals(leave) as signals, locked(out), _counting(study, blocks), ExitStack() as devices:
        left = [place for place in blocks if not _finished(rig, place)]
        if len(left) < len(blocks):
            progress.say(f"complete: {len(blocks) - len(left)} of {counted(len(blocks), 'block')}")
        progress.start(study, _saved(blocks))
        opened: OpenRig | None = None
        for tray in _trays(left):
            taught = {place.slot: _prepare(rig, place, person, progress, len(slots), len(blocks)) for place in tray}
            for place in tray:
                if opened is None:
                    opened = devices.enter_context(opener(rig, place.printed, place.frame))
                    if rig.stage.home and study.protocol.checks.home_every:
                        require_repeatable_homing(opened.stage, study.protocol.checks.slip_mm)
                else:
                    opened.put(place.printed, place.frame)
                info, heights = place.info(**opened.info), taught[place.slot]
                press = partial(
                    press_block, signals=signals, progress=progress, durable=durable, confirm=person.press_anyway
                )
                results.append(press(opened, info, place.folder, taught_mm=heights))
    return tuple(results)


def _saved(blocks: Sequence[Place]) -> int:
    """Return the number of saved presses."""
    return sum(len(run.rows) for place in blocks if (run := place.run) is not None)


@contextmanager
def _counting(study: Study, blocks: Sequence[Place]) -> Iterator[None]:
    """Add the number of saved presses to an interruption and to the error of a device."""
    try:
        yield
    except RunInterruptedError as error:
        error.saved, error.planned = _saved(blocks), study.presses
        raise
    except RigError as error:
        error.add_note(f"{_saved(blocks)} of {counted(study.presses, 'press')} are saved")
        raise


def _trays(blocks: Sequence[Place]) -> Iterator[tuple[Place, ...]]:
    """Return the blocks that are put in together: each slot at most once, in order."""
    tray: list[Place] = []
    for place in blocks:
        if any(place.slot == other.slot for other in tray):
            yield tuple(tray)
            tray = []
        tray.append(place)
    if tray:
        yield tuple(tray)


def _finished(rig: RigSettings, place: Place) -> bool:
    """Return whether a block's run is complete. Its sensor, which is not open yet, is not compared."""
    run = place.run
    if run is None:
        return False
    now = place.info(
        stage={**run.info.stage, "settings": recorded_stage(rig.stage)},
        gauge={**run.info.gauge, "settings": recorded_gauge(rig.gauge)},
        sensor=run.info.sensor,
    )
    return is_complete(run, now)


def is_complete(run: Run, info: RunInfo) -> bool:
    """Return whether a run is complete: all presses and frames are saved, and the position was checked after.

    A stage that has never compared x and y with its end stops in this run may be unable to check anything.

    Args:
        run: The run.
        info: The description of the run now.

    Raises:
        InputError: The run was begun with other settings.
    """
    advice = "restore these settings, or choose another output folder"
    if not run.rows:
        advice = "the run contains no press yet, so delete its folder, or choose another output folder"
    run.info.require_same(info, str(run.folder), advice)
    still = [(frame.when, frame.in_contact) for frame in run.stationary_frames]
    count = run.info.plan.protocol.checks.stationary_frames
    done = {row.number for row in run.rows}
    checks = run.position_checks
    is_checked = not (any(check.covers_all_axes for check in checks) and since_good_check(run.rows, checks))
    has_frames = all(still.count(group) >= count for group in STATIONARY)
    return has_frames and is_checked and all(press.number in done for press in run.info.presses)


def _prepare(
    rig: RigSettings, place: Place, person: Person, progress: PressProgress, slots: int, blocks: int
) -> tuple[float, ...]:
    """Have the block put in, and get its heights of first touch if a person teaches them."""
    # A single block is assumed to be in the holder already.
    if blocks > 1 and (person.is_asked_always or not _is_simulated(rig)):
        question = place.printed, place.label, place.slot + 1 if slots > 1 else None
        progress.ask(*question)
        person.put_in(*question)
        progress.answered()
    protocol = place.study.protocol
    if protocol.targets.contact == "force" or protocol.targets.touch != "taught":
        return ()
    path = place.folder / TAUGHT_FILE
    if path.exists():
        return read_toml(path, _Taught, "first touch", within=place.folder).z_mm
    progress.say(f"type the height of first touch on {place.printed.name} in the terminal")
    heights = person.first_touch(place.printed, len(protocol.positions.grid.positions_mm))
    place.folder.mkdir(parents=True, exist_ok=True)
    head = "# Heights of first touch, taught by hand, in mm of the work frame."
    write_text(path, f"{head}\nz_mm = [{', '.join(f'{height:.4f}' for height in heights)}]\n")
    return heights


def _is_simulated(rig: RigSettings) -> bool:
    """Return whether no person can put a block in, because stage and sensor exist only in software."""
    return find_driver("stage", rig.stage.driver).simulated and find_driver("sensor", rig.sensor.driver).simulated


@dataclass(frozen=True, kw_only=True)
class _Taught:
    """The file of the heights that a person taught."""

    z_mm: Annotated[tuple[float, ...], Len(1)]
