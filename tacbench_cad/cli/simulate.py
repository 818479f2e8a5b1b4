"""``tacbench simulate``: whole studies of a simulated sensor on the blocks of virtual printers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.runs.info import RunInfo
    from tacbench_cad.lab.simulate.blockrun import SimulatedBlock, SimulationOptions
    from tacbench_cad.lab.simulate.study import SimulationEstimate
    from tacbench_cad.lab.study.spec import Study

#: What the time went to, in the words of the result.
TIME_SPENT = {
    "encode": "PNG encoding",
    "draw": "drawing and noise",
    "press": "forces and pins",
    "print": "virtual prints",
    "write": "writing files",
}


@options.command("simulate")
@options.option(
    "--study", options.text("paper|quick|FILE.toml"), "The study; a file as tacbench acquire takes it.", default="quick"
)
@options.flag("--colour", "Images in colour; they take three times the room.")
@options.option(
    "--look",
    options.text("NAME"),
    "What the frames look like: clean (bright pins on black), tactip-bristol (331 pins) or tactip-sussex (133 pins), "
    "both as measured on public frames.",
    default="clean",
)
@options.option("--seed", options.COUNT, "Another number gives other prints and other noise.", default="0")
@options.jobs
@options.dask
@options.out("DIR", "Folder of the runs. Default: what FILE.toml says.")
@options.json
def command(
    study: str, colour: bool, look: str, seed: int, jobs: int, dask: str | None, out: Path | None, json: bool
) -> None:
    """Simulate a study: virtual prints, pressed by a simulated TacTip, in run folders like those of a real rig.

    It says first how many images it makes and how many bytes they take, and refuses where the disk has no room. Blocks
    are made side by side. An interruption loses nothing: the same command goes on at the first missing press of any
    block. Runs, images and the records of the prints all say that they are simulated.

    paper is the paper's 8,100 images (nine combinations of printer and filament, six textures, three forces) and 4,500
    more of the three selected combinations (copies 2 to 6, middle force). quick has two combinations, two copies, six
    textures, three forces and nine positions: the least that every analysis accepts.

    Examples:
      tacbench simulate --study quick --out runs
      tacbench simulate --study paper --out paper-runs --jobs 2
      tacbench simulate --study mine.toml --look tactip-bristol --colour
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

    how = SimulationOptions(colour=colour, look=look, seed=seed)
    chosen = study_of(study)
    folder = out or chosen.out
    if folder is None:
        raise InputError("out", None, "name a folder for the runs")
    infos = run_infos(chosen.study, how)
    with contextlib.ExitStack() as stack:
        cluster = None
        if dask is not None:
            from tacbench_cad.lab.parallel import workers

            cluster = stack.enter_context(workers(1, dask, [nearest_folder(folder)]))
            jobs = cluster.jobs
        jobs = min(jobs, len(infos))
        needed = estimate_simulation(chosen.study, folder, how, jobs=jobs)
        for line in _plan(chosen.study, infos, needed, how):
            note(line)
        require_room(folder, needed)
        began = time.monotonic()
        progress = stack.enter_context(ProgressLine())
        total = needed.presses + needed.others
        blocks = simulate_study(
            chosen.study,
            folder,
            how,
            jobs=jobs,
            progress=lambda done: progress.show("images", done, total),
            cluster=cluster,
        )
    seconds = time.monotonic() - began
    if json:
        print_json(_document(folder, infos, blocks, needed, seconds))
    else:
        _print(folder, infos, blocks, seconds)


def _plan(study: Study, infos: Sequence[RunInfo], needed: SimulationEstimate, how: SimulationOptions) -> list[str]:
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
    kind = f"{how.look}, {'colour' if how.colour else 'grey'}"
    there = f"{needed.there:,} are there; " if needed.there else ""
    lines.append(
        f"{there}{needed.missing:,} images to make, {kind}, {needed.bytes_each / 1e3:.0f} kB each: {needed.gb:.2f} GB, "
        f"in {counted(needed.jobs, 'process')}"
    )
    return lines


def _time_spent(blocks: Sequence[SimulatedBlock]) -> dict[str, float]:
    """Seconds of all processes by what they went to."""
    return {name: sum(block.seconds[name] for block in blocks) for name in TIME_SPENT}


def _print(folder: Path, infos: Sequence[RunInfo], blocks: Sequence[SimulatedBlock], seconds: float) -> None:
    groups: dict[tuple[str, str], list[int]] = {}
    for i, info in enumerate(infos):
        groups.setdefault((info.plan.printed.printer, info.plan.printed.filament), []).append(i)
    print_table(
        f"{counted(len(blocks), 'simulated run')} in {folder}",
        ("printer", "filament", ">copies", ">runs", ">presses made", ">images made", ">worst force error (mN)"),
        [
            (
                *group,
                len({infos[i].printed.copy for i in members}),
                len(members),
                f"{sum(blocks[i].presses for i in members):,}",
                f"{sum(blocks[i].images for i in members):,}",
                f"{1e3 * max(blocks[i].worst_n for i in members):.3f}",
            )
            for group, members in groups.items()
        ],
    )
    spent = _time_spent(blocks)
    images = sum(block.images for block in blocks)
    percents = [
        f"{what} {100.0 * spent[name] / sum(spent.values()):.0f} %" for name, what in TIME_SPENT.items() if images
    ]
    print_lines(
        "; ".join([f"{counted(images, 'image')} in {seconds:.1f} s", *([", ".join(percents)] if images else [])])
    )


def _document(
    folder: Path, infos: Sequence[RunInfo], blocks: Sequence[SimulatedBlock], needed: SimulationEstimate, seconds: float
) -> dict[str, Any]:
    return {
        "out": str(folder),
        "simulated": list(infos[0].simulated),
        "images": needed.presses + needed.others,
        "images_made": sum(block.images for block in blocks),
        "bytes_each": needed.bytes_each,
        "seconds": seconds,
        "process_seconds": _time_spent(blocks),
        "runs": [
            {
                "name": block.name,
                "presses_made": block.presses,
                "images_made": block.images,
                "worst_force_error_n": block.worst_n,
            }
            for block in blocks
        ],
    }
