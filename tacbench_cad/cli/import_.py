"""``tacbench import``: the authors' NumPy files as run folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted


def _levels_of(option: str, text: str) -> dict[str, int]:
    levels: dict[str, int] = {}
    for word in options.words_of(option, text):
        name, _, number = word.partition("=")
        name = name.strip().upper()
        if name in levels:
            raise InputError(option, text, f"names {name} twice")
        levels[name] = options.whole_of(option, number)
    return levels


@options.command("import")
@options.argument("files", options.file("FILES"), "The authors' NumPy files.", many=True)
@options.option(
    "--force-levels",
    options.Value("P30=1,...", _levels_of),
    "What the names call the paper's three forces.",
    default="P30=1,P40=2,P50=3",
)
@options.option(
    "--first-axis",
    options.choice("x", "y"),
    "Axis that the first index of the 5 x 5 positions runs along.",
    default="y",
)
@options.option("--unnumbered-copy", options.COUNT, "The copy that a name without a copy number is.", default="1")
@options.option("--preset", options.PRESET, "Geometry of the blocks that were pressed.", default="released")
@options.option("--spacing", options.choice("even", "1mm"), "Reading of the press grid along y.", default="even")
@options.out("DIR", "The folder for the run folders.", required=True)
def command(files: tuple[Path, ...], out: Path, **how: Any) -> None:
    """Turn the authors' data into run folders, one a printed block; its force levels become one run.

    The files are named <filament>_z<texture - 1>[.<copy>]_P<level>_<printer>.npy. They are mapped into memory and
    copied image by image. Run again after an interruption, it goes on. The target forces are the paper's nominal ones;
    what nobody recorded (measured forces, depth, time) stays empty.

    Examples:
      tacbench import data/*.npy --out runs
      tacbench import data/PLAminus_z0_*_Bambu.npy --out runs --first-axis x
      tacbench import data/*.npy --out runs --force-levels P20=1,P30=2,P40=3
    """
    from tacbench_cad.lab.runs.authors import ImportOptions, gather_authors_files, import_block

    blocks = gather_authors_files(files, ImportOptions(**how))
    for number, block in enumerate(blocks, start=1):
        folder = import_block(block, out)
        note(f"{number} of {len(blocks)}: {folder}, {counted(len(block.files), 'force level')}")
    click.echo(f"{counted(len(blocks), 'run')} in {out}")
