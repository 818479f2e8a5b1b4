"""Simulated studies: the paper's, a small one, and an estimate of their time and size.

The press loop presses each block on an ideal simulated rig. The rig knows the contact model, so it needs no search for
a force, and its clock never waits.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.lab.acquire.block_presses import BlockResult, press_block
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import is_complete
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.acquire.study_file import StudyFile, read_study
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import OpenRig
from tacbench_cad.lab.rig.stage import LimitedStage, Limits
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import encoded
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.printrecord import form
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.simulate.appearances import CLEAN, look_named
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.simulate.prints import Printers, printer_of, seeded
from tacbench_cad.lab.simulate.simulated_devices import SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.simulate.simulated_stage import SimulatedStage
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import (
    NO_GAUGE,
    ContactMode,
    GaugeSettings,
    PlannedBlock,
    PrintedBlock,
    Protocol,
    RigSettings,
    Seed,
    SensorSettings,
    StageSettings,
    Study,
)
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.convert import Checked, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked, write_text
from tacbench_cad.util.processes import Workers

if TYPE_CHECKING:
    from tacbench_cad.lab.parallel import Executor

#: The time from one simulated press to the next, in s.
SECONDS_PER_PRESS = 4.0
#: The limits of the stage of an ideal rig, in mm.
EVERYWHERE: Limits = ((-1e5, 1e5), (-1e5, 1e5), (-1e5, 1e5))
#: The numbers of the six textures.
TEXTURES = (1, 2, 3, 4, 5, 6)
#: The number of prints of each texture in the paper's three selected combinations. The paper pressed copies 2 to 6 at
#: one force and does not say which; we use the middle one.
PAPER_COPIES = 6
#: The force level for copies 2 to 6.
COPIES_LEVEL = 2
#: The number of frames of each stationary group. A camera needs the protocol's 30; a simulated one has no drift.
PAPER_STATIONARY, QUICK_STATIONARY = 10, 5
#: The combinations of the small study. It also has two copies, and 9 positions that span the paper's press grid.
QUICK_COMBINATIONS = (("ender-3-v3-se", "pla-plus"), ("bambu-p1p", "pla-minus"))
#: The number of prints of each texture in the small study.
QUICK_COPIES = 2
#: The number of images that are drawn to measure time and size.
SAMPLE = 12
#: The interval between two progress updates, in s.
PROGRESS_S = 0.5
#: The fraction of the needed disk space that must also be free.
SPARE = 0.05


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(Checked):
    """The options of a simulation.

    Args:
        colour: Whether images are in colour (BGR) or grey.
        seed: The seed. Another seed gives other prints and other noise.
        look: The name of the sensor's look, see :data:`tacbench_cad.lab.simulate.appearances.LOOKS`.
        printers: Simulated printers that replace the virtual printers of the same printer and filament.
    """

    colour: bool = False
    seed: Seed = 0
    look: str = CLEAN.name
    printers: Printers = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        look_named(self.look)


def run_info(study: Study, planned: PlannedBlock, options: SimulationOptions) -> RunInfo:
    """Return the contents of ``run.json`` for a block's simulated run."""
    rig = ideal_rig(planned.printed, study.protocol.targets.contact, options)
    return RunInfo.of(study, planned, None, 0, **rig.info)


def ideal_rig(printed: PrintedBlock, contact: ContactMode, options: SimulationOptions) -> OpenRig:
    """Return a simulated rig without a block, whose clock never waits.

    Its stage moves at once, so the time of a press does not depend on the way to it. Its gauge has no noise.

    Args:
        printed: The block that the rig will press.
        contact: ``force``, or ``depth`` for a rig without a gauge.
        options: The options of the simulation.
    """
    clock, printer = Clock(speed=math.inf), printer_of(printed, options.printers)
    simulated = SimulatedStage(Clock(speed=math.inf), EVERYWHERE)
    simulated.simulated = f"simulated stage; block from a virtual printer, {printer.name}"
    stage = LimitedStage(simulated, EVERYWHERE)
    gauge = SimulatedGauge(stage.position, clock, noise_n=0.0) if contact == "force" else None
    look = {"colour": options.colour, "look": options.look}
    sensor = SimulatedSensor(stage.followed_mm, clock, look, in_motion=lambda: stage.moving_mm is not None)
    known = {
        "virtual_printer": to_plain(printer, without_none=True),
        "seed": options.seed,
        "seconds_a_press": SECONDS_PER_PRESS,
    }
    settings = RigSettings(
        stage=StageSettings(driver="simulated", limits_mm=EVERYWHERE, home=False, options=known),
        gauge=GaugeSettings(driver=NO_GAUGE if gauge is None else "simulated"),
        sensor=SensorSettings(driver="simulated", options=look),
    )
    following = (sensor,) if gauge is None else (gauge, sensor)
    return OpenRig(stage=stage, gauge=gauge, sensor=sensor, clock=clock, settings=settings, following=following)


def lay_block(rig: OpenRig, info: RunInfo, options: SimulationOptions) -> Callable[[Press], float]:
    """Print the block of a run and lay it on an ideal rig.

    Returns:
        A function that returns the height at which a press reaches its force or depth, in mm of the work frame. It
        raises ``InputError`` if the force cannot be reached there, or the height is below the depth limit.
    """
    plan = info.plan
    contact = contact_for(plan.printed, plan.holder, printer_of(plan.printed, options.printers), seed=options.seed)
    for device in rig.following:
        device.lay(contact, plan.frame)
    limit_mm = plan.protocol.limits.depth_limit_mm

    def height_mm(press: Press) -> float:
        if press.target_n is not None:
            z = contact.z_for_force(press.x_mm, press.y_mm, press.target_n)
        else:
            assert press.depth_mm is not None, "a press has a force or a depth"
            z = contact.first_touch(press.x_mm, press.y_mm) - press.depth_mm
        if z < -limit_mm:
            below = f"press {press.number} of {plan.printed.name} would go {-z:.3f} mm below the block's top"
            raise InputError("depth_limit_mm", limit_mm, below)
        return z

    rig.known_mm = height_mm
    return height_mm


class _Pace(PressProgress):
    """Gives each press a time and a noise of its own, so that a resumed run ends like an uninterrupted one."""

    def __init__(self, clock: Clock, sensor: Any, seed: int) -> None:
        self._clock, self._sensor, self._seed, self._name = clock, sensor, seed, ""

    def begin(self, name: str, done: int, total: int) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self._name = name
        self._start("session", done)

    def before(self, press: Press, check: Callable[[], None]) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self._start("press", press.number)

    def _start(self, what: str, number: int) -> None:
        self._clock.sleep(SECONDS_PER_PRESS * number - self._clock.now_s())
        self._sensor.reseed(seeded("image", self._seed, self._name, what, number))


def simulate_block(out: Path, info: RunInfo, options: SimulationOptions) -> BlockResult:
    """Write a block's run folder, or the missing part of it.

    Args:
        out: The folder of the runs.
        info: The run, see :func:`run_info`.
        options: The options of the simulation.

    Raises:
        InputError: The folder contains another run, is used by another process, or cannot be written; or a force
            cannot be reached.
    """
    import cv2

    cv2.setNumThreads(1)  # blocks run in parallel processes, so threads would only slow each other down
    folder, plan = out / info.printed.name, info.plan
    _record_print(folder, info, options)
    if (folder / schema.RUN_FILE).exists() and is_complete(Run.open(folder), info):
        return BlockResult(folder=folder, presses=0, missed=0)
    rig = ideal_rig(plan.printed, plan.protocol.targets.contact, options)
    lay_block(rig, info, options)
    pace = _Pace(rig.clock, rig.sensor, options.seed)
    return press_block(rig, info, folder, signals=Signals(), progress=pace, durable=False)


def images_there(folder: Path) -> int:
    """Return the number of images in a run folder."""
    frames = sum(1 for name in schema.FRAME_FOLDERS for _ in (folder / name).glob("*.png"))
    return frames + sum(1 for _ in (folder / schema.SERIES_FOLDER).glob("*/*.png"))


def other_images(info: RunInfo) -> int:
    """Return the number of reference, stationary and moving images of a run."""
    presses_each = math.floor(info.plan.protocol.checks.reference_every_s / SECONDS_PER_PRESS) + 1
    moving = len(info.presses) * info.series_frames
    return 1 + len(info.presses) // presses_each + 4 * info.plan.protocol.checks.stationary_frames + moving


def _record_print(folder: Path, info: RunInfo, options: SimulationOptions) -> None:
    """Write the print record of a new run. For a virtual printer, the values are known."""
    printed, printer = info.plan.printed, printer_of(info.plan.printed, options.printers)
    record = form(
        f"Record of the simulated print {printed.name}. Nothing was printed.",
        printer=f"{printed.printer}, virtual",
        filament=f"{printed.filament}, virtual",
        slicer="none: a virtual printer",
        slicer_profile=f"{printer.name}, seed {options.seed}, copy {printed.copy}; parameters in run.json",
        nozzle_mm=printer.nozzle_mm,
        layer_height_mm=printer.layer_mm,
        orientation="relief up",
    )
    with locked(folder):
        if not (folder / schema.RUN_FILE).exists() and not (folder / schema.PRINT_FILE).exists():
            write_text(folder / schema.PRINT_FILE, record)


def paper_study() -> Study:
    """The paper's study, 12,600 images.

    Nine combinations with one print of each texture at three forces give 8,100 images. Five more prints of the three
    selected combinations at the middle force give 4,500.
    """
    protocol = Protocol().changed(stationary_frames=PAPER_STATIONARY)
    first = _prints(names.COMBINATIONS, (1,), protocol.all_levels)
    more = _prints(names.SELECTED, range(2, PAPER_COPIES + 1), (COPIES_LEVEL,))
    return Study(blocks=(*first, *more), protocol=protocol)


def quick_study() -> Study:
    """The smallest study that every analysis accepts.

    Two printers, two copies, six textures, three forces, two repeats, and nine positions that span the paper's grid.
    """
    whole = PressGrid.paper()
    grid = PressGrid(x_mm=whole.x_mm[::2], y_mm=whole.y_mm[::2])
    protocol = Protocol().changed(grid=grid, stationary_frames=QUICK_STATIONARY)
    blocks = _prints(QUICK_COMBINATIONS, range(1, QUICK_COPIES + 1), protocol.all_levels)
    return Study(blocks=tuple(blocks), protocol=protocol, grid_spacing="own")


def _prints(
    combinations: Sequence[tuple[str, str]], copies: Iterable[int], levels: tuple[int, ...]
) -> Iterator[PlannedBlock]:
    """Yield one print of each texture for each combination and copy, in this order."""
    for (printer, filament), copy, texture in product(combinations, tuple(copies), TEXTURES):
        printed = PrintedBlock(block=Block.of(texture), printer=printer, filament=filament, copy=copy)
        yield PlannedBlock(printed=printed, levels=levels)


def study_of(word: str) -> StudyFile:
    """Return the study that a command names: ``paper``, ``quick`` or a TOML file. Devices in the file are not used.

    Raises:
        InputError: The word is neither, or the file contains an error.
    """
    if word == "paper":
        return StudyFile(study=paper_study())
    if word == "quick":
        return StudyFile(study=quick_study())
    if not word.endswith(".toml"):
        raise InputError("study", word, "must be paper, quick or a TOML file")
    return read_study(Path(word))


@dataclass(frozen=True, kw_only=True)
class SimulationEstimate:
    """The estimated size and time of a study. Bytes and seconds are measured on a few of its images.

    Args:
        blocks: The number of blocks.
        presses: The number of images of presses.
        others: The number of other images: references, stationary frames and the moving frames of series.
        there: The number of images that already exist.
        bytes_each: The size of an image's file.
        seconds_each: The processor time of an image, in s, for one process.
        jobs: The number of processes.
    """

    blocks: int
    presses: int
    others: int
    there: int
    bytes_each: float
    seconds_each: float
    jobs: int

    @property
    def missing(self) -> int:
        """The number of missing images."""
        return max(self.presses + self.others - self.there, 0)

    @property
    def gb(self) -> float:
        """The size of the missing images, in GB (10^9 bytes)."""
        return self.missing * self.bytes_each / 1e9

    @property
    def seconds(self) -> float:
        """The time for the missing images, in s."""
        return self.missing * self.seconds_each / self.jobs


def run_infos(study: Study, options: SimulationOptions) -> list[RunInfo]:
    """Return the contents of ``run.json`` for each block of a simulated study, in the study's order."""
    return [run_info(study, block, options) for block in study.blocks]


def estimate_simulation(
    study: Study, out: Path, options: SimulationOptions | None = None, *, jobs: int = 1
) -> SimulationEstimate:
    """Count the images of a simulated study and measure the time and size of a few of them.

    Args:
        study: The study.
        out: The folder of its runs. Images that already exist are not counted again.
        options: The options of the simulation; None for the defaults.
        jobs: The number of processes.
    """
    options = options or SimulationOptions()
    infos = run_infos(study, options)
    nbytes, seconds = _measured(infos[0], options)
    return SimulationEstimate(
        blocks=len(infos),
        presses=sum(len(info.presses) for info in infos),
        others=sum(other_images(info) for info in infos),
        there=sum(images_there(out / info.printed.name) for info in infos),
        bytes_each=nbytes,
        seconds_each=seconds,
        jobs=jobs,
    )


def require_room(out: Path, needed: SimulationEstimate) -> None:
    """Check that the disk has room for a study.

    Raises:
        InputError: The disk has not enough room. The message contains the numbers.
    """
    free = shutil.disk_usage(nearest_folder(out)).free / 1e9
    need = needed.gb * (1.0 + SPARE)
    if free < need:
        raise InputError(
            "output folder", str(out), f"has {free:.2f} GB free, and the study's images need {need:.2f} GB; make room"
        )


def nearest_folder(out: Path) -> Path:
    """Return the folder itself, or the nearest existing folder above it."""
    return next((folder for folder in (out, *out.absolute().parents) if folder.is_dir()), Path("/"))


def simulate_study(
    study: Study,
    out: Path,
    options: SimulationOptions | None = None,
    *,
    jobs: int = 1,
    progress: Callable[[int], None] = lambda images: None,
    cluster: Executor | None = None,
) -> list[BlockResult]:
    """Write the run folders of a simulated study, or the missing part of them, with several processes.

    An interruption or an error ends the processes of this machine at once. Existing images are kept, and the next call
    resumes every block at its first missing press. A worker of a cluster finishes its block first.

    Args:
        study: The study.
        out: The folder of its runs.
        options: The options of the simulation; None for the defaults.
        jobs: The number of processes on this machine.
        progress: Called with the number of existing images: twice a second, or after each block of a cluster.
        cluster: A cluster that replaces the processes of this machine; see
            :func:`tacbench_cad.lab.parallel.workers`.

    Returns:
        The results of the blocks, in the study's order.

    Raises:
        TacbenchError: A run folder contains another run, is used by another process, or cannot be written; or a force
            cannot be reached.
    """
    options = options or SimulationOptions()
    infos = run_infos(study, options)

    def show() -> None:
        progress(sum(images_there(out / info.printed.name) for info in infos))

    if cluster is not None:
        blocks = []
        for block in cluster.map(partial(simulate_block, out.absolute(), options=options), infos):
            blocks.append(block)
            show()
        return blocks
    with Workers(jobs) as workers:
        futures = [workers.submit(simulate_block, out, info, options) for info in infos]
        pending = set(futures)
        while pending:
            done, pending = wait(pending, timeout=PROGRESS_S, return_when=FIRST_EXCEPTION)
            for future in done:
                future.result()
            show()
        return [future.result() for future in futures]


def _measured(info: RunInfo, options: SimulationOptions) -> tuple[float, float]:
    """Return mean bytes and processor seconds of a run's image, from presses spread over the run, each drawn twice.

    This is as in the run itself, where repeats and stationary frames share the computation of a pose.
    """
    rig = ideal_rig(info.plan.printed, info.plan.protocol.targets.contact, options)
    height_mm = lay_block(rig, info, options)

    def size(press: Press) -> int:
        rig.stage.move((press.x_mm, press.y_mm, height_mm(press)), 1.0)
        return len(encoded(rig.sensor.read(), info.simulated)[0])

    size(info.presses[-1])  # does the imports and the print, which occur only once
    began = time.process_time()
    sizes = [size(info.presses[(i // 2) * len(info.presses) // SAMPLE]) for i in range(SAMPLE)]
    return sum(sizes) / SAMPLE, (time.process_time() - began) / SAMPLE
