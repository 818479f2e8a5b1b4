"""``tacbench simulate``: whole studies of a simulated sensor on the blocks of virtual printers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tacbench_cad.cli.common import Dask, Jobs, console, jobs_of, note, print_json, table, whole_of
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.runs.info import RunInfo
    from tacbench_cad.lab.simulate.blockrun import SimulatedBlock
    from tacbench_cad.lab.simulate.study import SimulationEstimate
    from tacbench_cad.lab.study.spec import Study

NAME = "simulate"

#: What the time went to, in the words of the result.
SHARES = {
    "encode": "PNG encoding",
    "draw": "drawing and noise",
    "press": "forces and pins",
    "print": "virtual prints",
    "write": "writing files",
}


def command(
    study: Annotated[
        str, typer.Option(metavar="paper|quick|FILE.toml", help="The study; a file as tacbench acquire takes it.")
    ] = "quick",
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the runs. Default: what FILE.toml says.")
    ] = None,
    colour: Annotated[bool, typer.Option("--colour", help="Images in colour; they take three times the room.")] = False,
    seed: Annotated[str, typer.Option(metavar="N", help="Another number gives other prints and other noise.")] = "0",
    jobs: Jobs = None,
    dask: Dask = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Simulate a study: virtual prints, pressed by a simulated TacTip, in run folders like those of a real rig.

    It says first how many images it makes and what they take, measured on a few of them, and refuses where the disk
    has no room. Blocks are made side by side. An interruption loses nothing: the same command goes on at the first
    missing press of any block. Runs, images and the records of the prints all say that they are simulated.

    paper is the paper's 8,100 images (nine combinations of printer and filament, six textures, three forces) and 4,500
    more of the three selected combinations (copies 2 to 6, middle force). quick has two combinations, two copies, six
    textures, three forces and nine positions: the least that every analysis accepts.

    Examples:
      tacbench simulate --study quick --out runs
      tacbench simulate --study paper --out paper-runs --jobs 2
      tacbench simulate --study mine.toml --colour
      tacbench simulate --study paper --out /shared/runs --dask tcp://10.0.0.5:8786
    """
    from tacbench_cad.lab.simulate.blockrun import SimulationOptions
    from tacbench_cad.lab.simulate.study import (
        estimate_simulation,
        nearest_folder,
        require_room,
        run_infos,
        simulate_study,
        study_of,
    )

    options = SimulationOptions(colour=colour, seed=whole_of("seed", seed))
    count = jobs_of(jobs)
    found = study_of(study)
    folder = out or found.out
    if folder is None:
        raise InputError("out", None, "name a folder for the runs")
    infos = run_infos(found.study, options)
    with contextlib.ExitStack() as stack:
        cluster = None
        if dask is not None:
            from tacbench_cad.lab.parallel import workers

            cluster = stack.enter_context(workers(1, dask, [nearest_folder(folder)]))
            count = cluster.jobs
        count = min(count, len(infos))
        needed = estimate_simulation(found.study, folder, options, jobs=count)
        for line in _plan(found.study, infos, needed, colour):
            note(line)
        require_room(folder, needed)
        began = time.monotonic()
        progress = _Images(stack.enter_context(ProgressLine()), needed.presses + needed.others, needed.there)
        blocks = simulate_study(found.study, folder, options, jobs=count, progress=progress.show, cluster=cluster)
    seconds = time.monotonic() - began
    if json:
        print_json(_document(folder, infos, blocks, needed, seconds))
    else:
        _print(folder, infos, blocks, seconds)


def _plan(study: Study, infos: Sequence[RunInfo], needed: SimulationEstimate, colour: bool) -> list[str]:
    """What will be made, in words."""
    protocol = study.protocol
    cells: dict[tuple[int, ...], int] = {}
    for info in infos:
        cells[info.levels] = cells.get(info.levels, 0) + 1
    places = f"{counted(len(protocol.grid.positions_mm), 'position')}, {counted(protocol.repeats, 'repeat')}"
    images = f"{counted(needed.presses, 'image')} of presses ({places})"
    lines = [f"simulated study: {counted(needed.blocks, 'block')}, {images}:"]
    for levels, blocks in cells.items():
        presses = blocks * len(levels) * protocol.repeats * len(protocol.grid.positions_mm)
        shown = ", ".join(str(level) for level in levels)
        forces = "force level" if len(levels) == 1 else "force levels"
        lines.append(f"  {counted(blocks, 'block')} at {forces} {shown}: {counted(presses, 'image')}")
    lines.append(
        f"  {needed.others:,} images without a press of their own: references and 4 x {protocol.stationary_frames} "
        "stationary frames a block"
    )
    kind = "colour" if colour else "grey"
    there = f"{needed.there:,} are there; " if needed.there else ""
    lines.append(
        f"{there}{needed.missing:,} images to make, {kind}, {needed.bytes_each / 1e3:.0f} kB each: {needed.gb:.2f} GB, "
        f"about {_minutes(needed.minutes)} in {needed.jobs} process{'' if needed.jobs == 1 else 'es'}"
    )
    return lines


def _minutes(minutes: float) -> str:
    return f"{minutes:.1f} minutes" if minutes >= 2.0 else f"{60.0 * minutes:.0f} s"


class _Images:
    """How many images there are and how long the others will take.

    Args:
        line: Where it is written.
        total: Images in all.
        there: How many there were at the start.
    """

    def __init__(self, line: ProgressLine, total: int, there: int) -> None:
        self._line, self._total, self._before = line, total, there
        self._began = time.monotonic()

    def show(self, images: int) -> None:
        """So many images are there."""
        if images > self._before:
            left = (time.monotonic() - self._began) / (images - self._before) * (self._total - images)
            self._line.say(f"{images:,} of {self._total:,} images, {_minutes(left / 60.0)} left")


def _shares(blocks: Sequence[SimulatedBlock]) -> dict[str, float]:
    """Seconds of all processes by what they went to."""
    return {name: sum(block.seconds[name] for block in blocks) for name in SHARES}


def _print(folder: Path, infos: Sequence[RunInfo], blocks: Sequence[SimulatedBlock], seconds: float) -> None:
    made = table(
        f"{counted(len(blocks), 'simulated run')} in {folder}",
        *("printer", "filament", "copies", "runs", "presses made", "images made", "worst force error (mN)"),
        right=("copies", "runs", "presses made", "images made", "worst force error (mN)"),
    )
    groups: dict[tuple[str, str], list[int]] = {}
    for i, info in enumerate(infos):
        groups.setdefault((info.printed.printer, info.printed.filament), []).append(i)
    for (printer, filament), members in groups.items():
        done = [blocks[i] for i in members]
        made.add_row(
            printer,
            filament,
            str(len({infos[i].printed.copy for i in members})),
            str(len(members)),
            f"{sum(one.presses for one in done):,}",
            f"{sum(one.images for one in done):,}",
            f"{1e3 * max(one.worst_n for one in done):.3f}",
        )
    screen = console()
    screen.print(made)
    spent = _shares(blocks)
    total = sum(spent.values())
    images = sum(one.images for one in blocks)
    shares = ", ".join(f"{what} {100.0 * spent[name] / total:.0f} %" for name, what in SHARES.items()) if images else ""
    screen.print(f"{counted(images, 'image')} in {seconds:.1f} s{'; ' if shares else ''}{shares}", soft_wrap=True)


def _document(
    folder: Path, infos: Sequence[RunInfo], blocks: Sequence[SimulatedBlock], needed: SimulationEstimate, seconds: float
) -> dict[str, Any]:
    return {
        "out": str(folder),
        "simulated": list(infos[0].simulated),
        "images": needed.presses + needed.others,
        "images_made": sum(one.images for one in blocks),
        "bytes_each": needed.bytes_each,
        "seconds": seconds,
        "process_seconds": _shares(blocks),
        "runs": [
            {
                "name": one.name,
                "presses_made": one.presses,
                "images_made": one.images,
                "worst_force_error_n": one.worst_n,
            }
            for one in blocks
        ],
    }
