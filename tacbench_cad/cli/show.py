"""``tacbench show``: a picture of a texture, or a dimension drawing of a part."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import (
    note,
    number_of,
    part_options,
)
from tacbench_cad.util.errors import InputError, one_of

if TYPE_CHECKING:
    from tacbench_cad.making.request import Request
    from tacbench_cad.render.drawing import Drawing

NAME = "show"

#: What ``--drawing`` may name, and what ``make`` calls it.
_DRAWN = {"block": "blocks", "holder": "holder", "jig": "jig", "coupon": "coupon"}
_PART = "Part of a drawing"


def command(
    texture: Annotated[str, typer.Argument(metavar="T", help="1 to 6 or a TOML file.", show_default=False)],
    press: Annotated[
        bool, typer.Option("--press", help="Show the block's outline, the 25 press positions and the contact circles.")
    ] = False,
    drawing: Annotated[
        str | None,
        typer.Option(
            metavar="[block|holder|jig|coupon]",
            help="A dimension drawing on A4 instead, of the block if no part follows.",
        ),
    ] = None,
    preset: Annotated[str, typer.Option(metavar="paper|released", help="Geometry to begin from.")] = "paper",
    scale: Annotated[str, typer.Option(metavar="S", help="Multiply the block by S.")] = "1",
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--out",
            metavar="FILE",
            help="A .png; a drawing also .pdf or .svg. Default: the part's name in this folder.",
        ),
    ] = None,
    size: Annotated[str | None, typer.Option(metavar="X,Y", rich_help_panel=_PART, help="Sides in mm.")] = None,
    height: Annotated[
        str | None, typer.Option(metavar="MM", rich_help_panel=_PART, help="Height of the highest point.")
    ] = None,
    mm_per_unit: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", rich_help_panel=_PART, help="Mapping of the formula to mm.")
    ] = None,
    tolerance: Annotated[
        str | None, typer.Option(metavar="MM", rich_help_panel=_PART, help="Distance of the mesh from the formula.")
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="[NXxNY]", rich_help_panel=_PART, help="Join samples instead.")
    ] = None,
    key: Annotated[
        str | None,
        typer.Option(
            metavar="[MM]", rich_help_panel=_PART, help="Key at the corner (X, 0), 3 mm if no number follows."
        ),
    ] = None,
    label: Annotated[bool, typer.Option("--label", rich_help_panel=_PART, help="Label in the underside.")] = False,
    fit: Annotated[
        str | None,
        typer.Option(metavar="press|slip|loose|MM", rich_help_panel=_PART, help="Clearance of pockets, per side."),
    ] = None,
    rim: Annotated[
        str | None, typer.Option(metavar="MM", rich_help_panel=_PART, help="Holder's rim below the block's top.")
    ] = None,
    slots: Annotated[
        str | None, typer.Option(metavar="N", rich_help_panel=_PART, help="Pockets of the holder.")
    ] = None,
    nozzle: Annotated[
        str | None, typer.Option(metavar="MM", rich_help_panel=_PART, help="Nozzle that fixtures are for.")
    ] = None,
    jig: Annotated[
        str | None, typer.Option(metavar="default|all", rich_help_panel=_PART, help="all: 25 holes in the jig.")
    ] = None,
) -> None:
    """Draw a texture as a PNG, its surface or the press protocol on it; or a part with its dimensions.

    A drawing takes the options that make the part and shows the numbers of the file that tacbench make writes.

    Examples:
      tacbench show 4
      tacbench show 2 --press -o protocol.png
      tacbench show hex.toml --preset released
      tacbench show 4 --drawing --key --label --press -o block.pdf
      tacbench show 4 --drawing holder --slots 6 -o tray.svg
    """
    part = part_options(
        size=size,
        height=height,
        mm_per_unit=mm_per_unit,
        tolerance=tolerance,
        grid=grid,
        key=key,
        label=label,
        fit=fit,
        rim=rim,
        slots=slots,
        nozzle=nozzle,
        jig=jig,
    )
    factor = number_of("scale", scale)
    if drawing is None:
        if part:
            name, value = next(iter(part.items()))
            raise InputError(name.removesuffix("_mm").replace("_", " "), value, "belongs to --drawing")
        _picture(texture, preset, factor, press, out)
        return
    from tacbench_cad.making.request import Request

    kind = one_of("drawing", drawing, _DRAWN)
    parts, formats = (_DRAWN[kind],), ("stl",)
    request = Request(textures=(texture,), preset=preset, scale=factor, parts=parts, formats=formats, **part)
    _draw(request, kind, press, out)


def _picture(texture: str, preset: str, scale: float, press: bool, out: Path | None) -> None:
    from tacbench_cad.making.choice import described
    from tacbench_cad.render.pictures import texture_picture

    blocks = described((texture,), preset, scale)
    if len(blocks) != 1:
        raise InputError("texture", texture, "name one texture: 1 to 6 or a TOML file")
    path = out or Path(f"{blocks[0].name}{'_press' if press else ''}.png")
    if path.suffix.lower() != ".png":
        raise InputError("out", str(path), "must end in .png")
    texture_picture(blocks[0], path, press=press)
    note(f"wrote {path}")


def _draw(request: Request, kind: str, press: bool, out: Path | None) -> None:
    from tacbench_cad.render.drawing import require_drawing, save_drawing

    if press and kind != "block":
        raise InputError("press", None, "belongs to the drawing of a block")
    if out is not None:
        require_drawing(out)
    drawing = _drawing(request, press)
    path = out or Path(f"{drawing.name}_drawing.pdf")
    save_drawing(drawing, path)
    note(f"wrote {path}")


def _drawing(request: Request, press: bool) -> Drawing:
    """The drawing of the one part that a request means."""
    from tacbench_cad.making.request import plan
    from tacbench_cad.render.drawing import block_drawing
    from tacbench_cad.spec.block import Block

    makers = [source.maker for source in plan(request).sources]
    if len(makers) != 1 or "all" in request.textures:
        raise InputError("texture", request.textures[0], "name one texture: 1 to 6 or a TOML file")
    maker = makers[0]
    if isinstance(maker, Block):
        return block_drawing(maker, press)
    from housing.drawings import fixture_drawing

    return fixture_drawing(maker)
