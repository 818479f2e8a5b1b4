"""``tacbench import``: the authors' NumPy files as run folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import note, whole_of, words_of
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import counted

NAME = "import"


def command(
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="The authors' NumPy files.", show_default=False)],
    out: Annotated[Path, typer.Option(metavar="DIR", help="The folder for the run folders.", show_default=False)],
    force_levels: Annotated[
        str, typer.Option(metavar="P30=1,...", help="What the names call the paper's three forces.")
    ] = "P30=1,P40=2,P50=3",
    first_axis: Annotated[
        str, typer.Option(metavar="x|y", help="Axis that the first index of the 5 x 5 positions runs along.")
    ] = "y",
    unnumbered_copy: Annotated[
        str, typer.Option(metavar="N", help="The copy that a name without a copy number is.")
    ] = "1",
    preset: Annotated[
        str, typer.Option(metavar="released|paper", help="Geometry of the blocks that were pressed.")
    ] = "released",
    spacing: Annotated[str, typer.Option(metavar="even|1mm", help="ImportOptions of the press grid along y.")] = "even",
) -> None:
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
    from tacbench_cad.spec.presets import PRESETS

    how = ImportOptions(
        force_levels=_levels(force_levels),
        first_axis="x" if one_of("first-axis", first_axis, ("x", "y")) == "x" else "y",
        unnumbered_copy=whole_of("unnumbered-copy", unnumbered_copy),
        preset=one_of("preset", preset, PRESETS),
        spacing="1mm" if one_of("spacing", spacing, ("even", "1mm")) == "1mm" else "even",
    )
    blocks = gather_authors_files(files, how)
    for number, block in enumerate(blocks, start=1):
        folder = import_block(block, out)
        note(f"{number} of {len(blocks)}: {folder}, {counted(len(block.files), 'force level')}")
    typer.echo(f"{counted(len(blocks), 'run')} in {out}")


def _levels(text: str) -> dict[str, int]:
    levels: dict[str, int] = {}
    for word in words_of(text) or ():
        name, _, number = word.partition("=")
        name = name.strip().upper()
        if name in levels:
            raise InputError("force-levels", text, f"names {name} twice")
        levels[name] = whole_of("force-levels", number)
    return levels
