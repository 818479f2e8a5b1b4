"""``tacbench draw``: make a drawing of a part with its dimensions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.cli import next_block, note, options, print_next
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import short_name

if TYPE_CHECKING:
    from tacbench_cad.extensions.drawings import Drawing

#: What ``--part`` may name, and what ``make`` calls it.
_DRAWN = {"block": "blocks", "holder": "holder", "jig": "jig", "coupon": "coupon"}


@options.command("draw", "Print")
@options.drawn_textures
@options.option("--part", options.choice(*_DRAWN), "What to draw.", options.PICTURE, default="block")
@options.flag("--press", "Block: add the press positions and the contact areas.", options.PICTURE)
@options.part
@options.out("FILE", "A .png, .svg or .pdf file. Default: named after the part.")
def command(textures: tuple[str, ...], part: str, press: bool, out: Path | None, **request: Any) -> None:
    """Make a drawing of a part with its dimensions, on A4.

    If you use the same options as for "tacbench make", the drawing has the same dimensions as the files of that
    command.

    Examples:
      tacbench draw 4
      tacbench draw 4 --key --label --press -o block.pdf
      tacbench draw 4 --part holder --slots 6 -o tray.svg
    """
    from tacbench_cad.extensions.drawings import save_drawing
    from tacbench_cad.making import Request, plan
    from tacbench_cad.util.plotting import picture_format, require_single_picture

    if out is not None:
        picture_format(out)  # before anything is calculated
    if press and part != "block":
        raise InputError("press", None, "is only for the drawing of a block")
    fields = options.request_fields(request)
    planned = plan(Request(textures=textures, parts=(_DRAWN[part],), formats=("stl",), **fields))
    require_single_picture(out, len(planned.sources))
    for source in planned.sources:
        drawing = _drawing(source.thing, press)
        path = out or Path(f"{short_name(drawing.name)}_drawing.pdf")
        save_drawing(drawing, path)
        note(f"wrote {path}")
    print_next("make", *next_block(textures, fields["preset"], fields["scale"], fields.get("key_mm")), err=True)


def _drawing(thing: Any, press: bool) -> Drawing:
    from tacbench_cad.extensions.drawings import block_drawing, fixture_drawing
    from tacbench_cad.spec import Block

    return block_drawing(thing, press) if isinstance(thing, Block) else fixture_drawing(thing)
