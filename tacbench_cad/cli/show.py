"""``tacbench show``: draw a picture of a texture or a drawing of a part."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_block, note, print_next
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import short_name

if TYPE_CHECKING:
    from tacbench_cad.extensions.drawings import Drawing
    from tacbench_cad.making.request import Request

#: What ``--drawing`` may name, and what ``make`` calls it.
_DRAWN = {"block": "blocks", "holder": "holder", "jig": "jig", "coupon": "coupon"}


@options.command("show", "Print")
@options.argument(
    "textures",
    options.words("TEXTURES", *options.TEXTURES, suffix=".toml"),
    "1 to 6, all, names such as dunes, later for all fourteen such names, or TOML files; for example 1,dunes.",
)
@options.flag("--press", "Add the block's outline, the press positions and the contact areas.", options.PICTURE)
@options.option(
    "--drawing",
    options.choice(*_DRAWN, metavar="[PART]"),
    "Make an A4 drawing of the block, holder, jig or coupon. Without a value: of the block.",
    options.PICTURE,
    alone="block",
)
@options.part
@options.out("FILE", "A .png, .svg or .pdf file. Default: named after the part.")
def command(textures: tuple[str, ...], press: bool, drawing: str | None, out: Path | None, **request: Any) -> None:
    """Draw a picture of a texture or a drawing of a part.

    A picture shows the surface of the texture in colour. With --drawing, you get a drawing with dimensions. If you use
    the same options as for "tacbench make", the drawing has the same dimensions as the files of that command.

    Examples:
      tacbench show 4
      tacbench show 2 --press -o protocol.svg
      tacbench show hex.toml --preset released
      tacbench show 4 --drawing --key --label --press -o block.pdf
      tacbench show 4 --drawing holder --slots 6 -o tray.svg
    """
    from tacbench_cad.util.plotting import picture_format

    if out is not None:
        picture_format(out)  # before anything is calculated
    fields = options.request_fields(request)
    if drawing is None:
        preset, scale = fields.pop("preset"), fields.pop("scale")
        for name, value in fields.items():
            raise InputError(name.removesuffix("_mm").replace("_", " "), value, "is only for --drawing")
        _write_pictures(textures, preset, scale, press, out)
        print_next("make", *next_block(textures, preset, scale), err=True)
        return
    from tacbench_cad.making.request import Request

    if press and drawing != "block":
        raise InputError("press", None, "is only for the drawing of a block")
    _write_drawings(Request(textures=textures, parts=(_DRAWN[drawing],), formats=("stl",), **fields), press, out)
    print_next("make", *next_block(textures, fields["preset"], fields["scale"], fields.get("key_mm")), err=True)


def _write_pictures(textures: tuple[str, ...], preset: str, scale: float, press: bool, out: Path | None) -> None:
    from tacbench_cad.making.choice import described
    from tacbench_cad.render.pictures import texture_picture

    blocks = described(textures, preset, scale)
    _require_single(out, len(blocks))
    for block in blocks:
        path = out or Path(f"{short_name(block.name)}{'_press' if press else ''}.png")
        texture_picture(block, path, press=press)
        note(f"wrote {path}")


def _write_drawings(request: Request, press: bool, out: Path | None) -> None:
    from tacbench_cad.extensions.drawings import save_drawing
    from tacbench_cad.making.request import plan

    things = [source.thing for source in plan(request).sources]
    _require_single(out, len(things))
    for thing in things:
        drawing = _drawing(thing, press)
        path = out or Path(f"{short_name(drawing.name)}_drawing.pdf")
        save_drawing(drawing, path)
        note(f"wrote {path}")


def _require_single(out: Path | None, count: int) -> None:
    if out is not None and count > 1:
        raise InputError("out", str(out), f"is the name of one picture, but there are {count}; leave out --out")


def _drawing(thing: Any, press: bool) -> Drawing:
    from tacbench_cad.extensions.drawings import block_drawing
    from tacbench_cad.spec.block import Block

    if isinstance(thing, Block):
        return block_drawing(thing, press)
    from tacbench_cad.extensions.drawings.fixtures import fixture_drawing

    return fixture_drawing(thing)
