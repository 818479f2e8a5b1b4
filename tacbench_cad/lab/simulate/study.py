"""Simulated studies: the paper's, a small one, and an estimate of their time and size."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, wait
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.lab.runs.frame_files import encoded
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.simulate.blockrun import (
    SimulatedBlock,
    SimulationOptions,
    ideal_rig,
    images_there,
    lay_block,
    other_images,
    run_info,
    simulate_block,
)
from tacbench_cad.lab.study import names
from tacbench_cad.lab.study.file import StudyFile, read_study
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PlannedBlock, PrintedBlock, Protocol, Study
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.processes import Workers

if TYPE_CHECKING:
    from tacbench_cad.lab.parallel import Executor

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
) -> list[SimulatedBlock]:
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
