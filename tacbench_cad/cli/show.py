"""``tacbench show``: a picture of a texture."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import note, number_of
from tacbench_cad.errors import InputError

NAME = "show"


def command(
    texture: Annotated[str, typer.Argument(metavar="T", help="1 to 6 or a TOML file.", show_default=False)],
    press: Annotated[
        bool, typer.Option("--press", help="Show the block's outline, the 25 press positions and the contact circles.")
    ] = False,
    preset: Annotated[str, typer.Option(metavar="paper|released", help="Geometry to begin from.")] = "paper",
    scale: Annotated[str, typer.Option(metavar="S", help="Multiply the block by S.")] = "1",
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FILE.png", help="Picture file. Default: the block's name in this folder."),
    ] = None,
) -> None:
    """Draw a texture as a PNG: its surface from above with cuts through it, or with the press protocol on it.

    Examples:
      tacbench show 4
      tacbench show 2 --press -o protocol.png
      tacbench show hex.toml --preset released
    """
    from tacbench_cad.making.choice import described
    from tacbench_cad.pictures import texture_picture

    blocks = described((texture,), preset, number_of("scale", scale))
    if len(blocks) != 1:
        raise InputError("texture", texture, "name one texture: 1 to 6 or a TOML file")
    path = out or Path(f"{blocks[0].name}{'_press' if press else ''}.png")
    if path.suffix.lower() != ".png":
        raise InputError("out", str(path), "must end in .png")
    texture_picture(blocks[0], path, press=press)
    note(f"wrote {path}")
