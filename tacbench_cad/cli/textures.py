"""``tacbench textures``: the catalogue."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tacbench_cad.cli.common import console, number_of, print_json, table, words_of
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block

NAME = "textures"


def command(
    preset: Annotated[str, typer.Option(metavar="paper|released", help="Geometry to begin from.")] = "paper",
    texture: Annotated[str, typer.Option(metavar="1,4|FILE.toml|all", help="Which textures.")] = "all",
    scale: Annotated[str, typer.Option(metavar="S", help="Multiply the block by S.")] = "1",
    nozzle: Annotated[str, typer.Option(metavar="MM", help="Nozzle width to compare the finest detail with.")] = "0.4",
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """List the textures: equation, extremes, relief, base, and what a nozzle can print of their detail.

    The finest detail is half the shortest wavelength: the width of its ridge. A wave whose ridge is narrower than the
    nozzle comes out smoothed; the column waves printable counts those that are not.

    Examples:
      tacbench textures
      tacbench textures --preset released --nozzle 0.2
      tacbench textures --texture hex.toml --json
    """
    from tacbench_cad.making.choice import described

    width, factor = number_of("nozzle", nozzle), number_of("scale", scale)
    if not (math.isfinite(width) and 0.0 < width <= 10.0):
        raise InputError("nozzle", width, "must be above 0 and at most 10 mm")
    rows = [_row(block, width) for block in described(words_of(texture) or (), preset, factor)]
    if json:
        print_json({"preset": preset, "scale": factor, "nozzle_mm": width, "textures": rows})
        return
    x, y, z = rows[0]["size_mm"]
    shown = table(
        f"preset {preset}, scale {factor:g}: {x:g} x {y:g} x {z:g} mm, nozzle {width:g} mm",
        *(
            "texture",
            "lowest",
            "highest",
            "relief (mm)",
            "base (mm)",
            "finest ridge (mm)",
            "waves printable",
            "equation",
        ),
        right=("lowest", "highest", "relief (mm)", "base (mm)", "finest ridge (mm)", "waves printable"),
    )
    for row in rows:
        shown.add_row(
            row["texture"],
            f"{row['lowest']:.4f}",
            f"{row['highest']:.4f}",
            f"{row['relief_mm']:.3f}",
            f"{row['base_mm']:.3f}",
            f"{row['finest_ridge_mm']:.3f}",
            f"{row['waves_printable']} of {row['waves']}",
            row["equation"],
        )
    console().print(shown)


def _row(block: Block, nozzle_mm: float) -> dict[str, Any]:
    """One texture's facts; ``lowest`` and ``highest`` are values of the formula over the block, without unit."""
    table = block.surface.table
    ridges = [math.pi / math.hypot(f, g) for a, f, g, _ in table if a != 0.0 and (f, g) != (0.0, 0.0)]
    unit = block.mm_per_unit[2]
    return {
        "texture": block.texture.name,
        "equation": block.texture.equation,
        "lowest": block.extremes.low / unit,
        "highest": block.extremes.high / unit,
        "relief_mm": block.relief_mm,
        "base_mm": block.base_mm,
        "size_mm": [*block.size_mm, block.height_mm],
        "finest_ridge_mm": min(ridges),
        "waves": len(ridges),
        "waves_printable": sum(1 for ridge in ridges if ridge >= nozzle_mm),
    }
