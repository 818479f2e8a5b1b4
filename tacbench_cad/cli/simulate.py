"""``tacbench simulate``: simulate whole studies."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.cli import completing, options
from tacbench_cad.cli.common import note, print_json, print_lines, print_next, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.lab.acquire.block_presses import BlockResult
    from tacbench_cad.lab.runs.info import RunInfo
    from tacbench_cad.lab.simulate.study import SimulationEstimate, SimulationOptions
    from tacbench_cad.lab.study.spec import Study

#: The words of ``--look``; a test compares them with the simulated looks.
LOOK_NAMES = ("clean", "tactip-bristol", "tactip-sussex")


@options.command("simulate", "Press")
@options.option(
    "--study",
    options.text("STUDY", "quick", "paper", complete=completing.of_words_or_files("quick", "paper")),
    "quick, paper, or a study file of your own, as for tacbench acquire.",
    options.INPUT,
    default="quick",
)
@options.option(
    "--look",
    options.text("NAME", *LOOK_NAMES),
    "Appearance of the frames: clean (bright pins on black), tactip-bristol (331 pins) or tactip-sussex (133 pins). "
    "The last two follow public frames of these sensors.",
    options.FRAMES,
    default="clean",
)
@options.flag("--colour", "Make colour frames. They take three times the space.", options.FRAMES)
@options.option(
    "--printers",
    options.words("LIST", suffix=".toml"),
    "Files of measured printers, for example those that tacbench printer-model writes. They replace the virtual "
    "printers of the same printer and filament.",
    options.PRINTER,
)
@options.out("DIR", "Folder of the runs. You can leave it out if your own study file names a folder.")
@options.json
@options.jobs
@options.dask
@options.option("--seed", options.COUNT, "Seed of the prints and of the noise.", options.ADVANCED, default="0")
def command(
    study: str,
    colour: bool,
    look: str,
    printers: tuple[str, ...] | None,
    seed: int,
    jobs: int,
    dask: str | None,
    out: Path | None,
    json: bool,
) -> None:
    """Simulate a whole study, without a rig.

    A simulated TacTip presses virtual prints. The run folders have the same structure as those of a real rig. The runs,
    the frames and the print records say that they are simulated.

    Before it starts, the command prints the number of frames and the disk space that they need. If there is not enough
    space, it does not start. You can interrupt it at any time. The same command resumes at the first missing press.

    The study quick has 2 combinations of printer and filament, 2 copies, 6 textures, 3 forces and 9 positions. This is
    the smallest study that every analysis accepts.

    The study paper has the 8,100 frames of the paper: 9 combinations of printer and filament, 6 textures and 3 forces.
    In addition, it has 4,500 frames of the 3 combinations that the paper selected: copies 2 to 6 at the middle force.

    Examples:
      tacbench simulate --out runs
      tacbench simulate --study paper --out paper-runs --jobs 2
      tacbench simulate --study mine.toml --printers my-printer.toml
      tacbench simulate --study mine.toml --look tactip-bristol --colour
      tacbench simulate --study paper --out runs --dask tcp://10.0.0.5:8786
    """
    from tacbench_cad.lab.simulate.prints import read_printers, require_used
    from tacbench_cad.lab.simulate.study import (
        SimulationOptions,
        estimate_simulation,
        nearest_folder,
        require_room,
        run_infos,
        simulate_study,
        study_of,
    )

    known = read_printers([Path(word) for word in printers or ()])
    how = SimulationOptions(colour=colour, look=look, seed=seed, printers=known)
    chosen = study_of(study)
    require_used(known, chosen.study)
    folder = out or chosen.out
    if folder is None:
        raise InputError("--out DIR", None, "is missing; name the folder of the runs")
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
        _print(folder, infos, blocks, needed.missing, seconds)
        print_next("check-runs", folder)


def _plan(study: Study, infos: Sequence[RunInfo], needed: SimulationEstimate, how: SimulationOptions) -> list[str]:
    """The lines that describe the study before it starts."""
    protocol = study.protocol
    cells: dict[tuple[int, ...], int] = {}
    for info in infos:
        cells[info.levels] = cells.get(info.levels, 0) + 1
    places = f"{counted(len(protocol.positions.grid.positions_mm), 'position')}, {counted(protocol.repeats, 'repeat')}"
    images = f"{counted(needed.presses, 'image')} of presses ({places})"
    lines = [f"simulated study: {counted(needed.blocks, 'block')}, {images}:"]
    for levels, blocks in cells.items():
        presses = blocks * len(levels) * protocol.repeats * len(protocol.positions.grid.positions_mm)
        shown = ", ".join(str(level) for level in levels)
        forces = "force level" if len(levels) == 1 else "force levels"
        lines.append(f"  {counted(blocks, 'block')} at {forces} {shown}: {counted(presses, 'image')}")
    lines.append(
        f"  {needed.others:,} other images: for each block, frames without contact and 4 x "
        f"{protocol.checks.stationary_frames} frames without motion"
        + (f", and {protocol.series_frames} moving frames after each press" if protocol.series_frames else "")
    )
    kind = f"look {how.look}, {'colour' if how.colour else 'grey'}"
    there = f"{needed.there:,} images exist; " if needed.there else ""
    lines.append(
        f"{there}{needed.missing:,} images to make ({kind}), {needed.bytes_each / 1e3:.0f} kB each: "
        f"{needed.gb:.2f} GB, about {counted(math.ceil(needed.seconds / 60.0), 'minute')} in "
        f"{counted(needed.jobs, 'process')}"
    )
    return lines


def _print(folder: Path, infos: Sequence[RunInfo], blocks: Sequence[BlockResult], made: int, seconds: float) -> None:
    groups: dict[tuple[str, str], list[int]] = {}
    for i, info in enumerate(infos):
        groups.setdefault((info.plan.printed.printer, info.plan.printed.filament), []).append(i)
    print_table(
        f"{counted(len(blocks), 'simulated run')} in {folder}",
        ("printer", "filament", ">copies", ">runs", ">presses made"),
        [
            (
                *group,
                len({infos[i].printed.copy for i in members}),
                len(members),
                f"{sum(blocks[i].presses for i in members):,}",
            )
            for group, members in groups.items()
        ],
    )
    print_lines(f"{counted(made, 'image')} in {seconds:.1f} s")


def _document(
    folder: Path, infos: Sequence[RunInfo], blocks: Sequence[BlockResult], needed: SimulationEstimate, seconds: float
) -> dict[str, Any]:
    return {
        "out": str(folder),
        "simulated": list(infos[0].simulated),
        "images": needed.presses + needed.others,
        "images_made": needed.missing,
        "bytes_each": needed.bytes_each,
        "seconds": seconds,
        "runs": [{"name": block.folder.name, "presses_made": block.presses} for block in blocks],
    }
