"""``tacbench export``: textures for simulators."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import console, number_of, print_json, table, words_of
from tacbench_cad.util.text import counted

NAME = "export"

_KINDS = "mjcf|urdf|sdf|usd|glb|obj|npy|png16|taxim"


def command(
    to: Annotated[str, typer.Option(metavar=_KINDS, help="What for; several with commas.", show_default=False)],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder that takes a folder a texture.", show_default=False)],
    texture: Annotated[
        str, typer.Option(metavar="1,4|FILE.toml|all", help="Textures, with commas between them.")
    ] = "all",
    preset: Annotated[str, typer.Option(metavar="paper|released", help="Geometry to begin from.")] = "paper",
    scale: Annotated[str, typer.Option(metavar="S", help="Multiply sides, height and mm per unit by S.")] = "1",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Write textures for simulators: a folder a texture, with collision that keeps the relief.

    The folder's README.md states frame, scale, units, the proved error against the formula, contact settings that hold,
    and what was tested. A folder is written whole or not at all; one that holds the same texture gains the new files,
    one that holds another is refused.

    Examples:
      tacbench export --to mjcf --out sim
      tacbench export --to urdf,sdf --texture 2 --out sim
      tacbench export --to npy,png16 --texture hex.toml --scale 2 --out heights
    """
    from tacbench_cad.formats.simulators.folder import export_to_simulators
    from tacbench_cad.making.choice import described

    targets = words_of(to) or ()
    blocks = described(words_of(texture) or (), preset, number_of("scale", scale))
    made = export_to_simulators(blocks, targets, out)
    if json:
        print_json({"folders": [one.as_dict() for one in made]})
        return
    title = f"{counted(len(made), 'folder')} in {out}"
    shown = table(title, "folder", "files", "MB", "begin with", right=("files", "MB"))
    for one in made:
        size = sum(one.files.values()) / 1e6
        shown.add_row(one.folder.name, str(len(one.files)), f"{size:.2f}", next(iter(one.files)))
    console().print(shown)
