"""``tacbench view``: the 3D page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from tacbench_cad.cli.common import note, number_of, part_options

NAME = "view"


def command(
    parts: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="PARTS",
            help="1 to 6, a texture's name, a TOML file, blocks, holder, jig, coupon. Default: the whole set.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.html", help="The page.")] = Path("view.html"),
    preset: Annotated[str, typer.Option(metavar="paper|released", help="Geometry to begin from.")] = "paper",
    scale: Annotated[str, typer.Option(metavar="S", help="Multiply sides, height, mm per unit, press grid.")] = "1",
    key: Annotated[
        str | None, typer.Option(metavar="[MM]", help="Cut the corner at (X, 0), 3 mm if no number follows.")
    ] = None,
    slots: Annotated[str | None, typer.Option(metavar="N", help="Pockets of the holder.")] = None,
    tolerance: Annotated[
        str | None, typer.Option(metavar="MM", help="Distance of meshes from the formula. Default: 0.01.")
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="[NXxNY]", help="Join samples instead, the preset's if no size follows.")
    ] = None,
) -> None:
    """Write one HTML page with the parts in 3D: to turn, cut and measure. It loads nothing, so it can be sent on.

    The page shows texture, block, holder, jig and how they go together, the press positions and contact circles, and
    how far each point of a block's mesh lies from the formula, in colour with its scale.

    Examples:
      tacbench view
      tacbench view 4 -o texture-4.html
      tacbench view 1,2 holder jig --slots 2
      tacbench view hex.toml --tolerance 0.05
    """
    from tacbench_cad.making.request import Request
    from tacbench_cad.render.viewing.page import require_page, write_page
    from tacbench_cad.render.viewing.scene import request_of, scene_of

    words = [word.strip() for text in parts or () for word in text.split(",") if word.strip()]
    options = Request(
        preset=preset,
        scale=number_of("scale", scale),
        **part_options(key=key, slots=slots, tolerance=tolerance, grid=grid),
    )
    request = request_of(words, options)
    require_page(out)
    scene = scene_of(request, note)
    write_page(scene, out)
    for left in scene.left_out:
        note(f"left out: {left.what}: {left.reason}")
    note(f"wrote {out} ({out.stat().st_size / 1e6:.1f} MB)")
