"""``tacbench show``: draw a picture of a texture."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_block, note, print_next
from tacbench_cad.util.text import short_name


@options.command("show", "Print")
@options.drawn_textures
@options.flag("--press", "Add the block's outline, the press positions and the contact areas.", options.PICTURE)
@options.preset
@options.scale
@options.out("FILE", "A .png, .svg or .pdf file. Default: named after the texture.")
def command(textures: tuple[str, ...], press: bool, preset: str, scale: float, out: Path | None) -> None:
    """Draw a picture of a texture.

    The picture shows the surface of the texture in colour.

    Examples:
      tacbench show 4
      tacbench show 2 --press -o protocol.svg
      tacbench show hex.toml --preset released
    """
    from tacbench_cad.making.choice import described
    from tacbench_cad.render.pictures import texture_picture
    from tacbench_cad.util.plotting import picture_format, require_single_picture

    if out is not None:
        picture_format(out)  # before anything is calculated
    blocks = described(textures, preset, scale)
    require_single_picture(out, len(blocks))
    for block in blocks:
        path = out or Path(f"{short_name(block.name)}{'_press' if press else ''}.png")
        texture_picture(block, path, press=press)
        note(f"wrote {path}")
    print_next("make", *next_block(textures, preset, scale), err=True)
