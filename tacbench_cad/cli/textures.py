"""``tacbench textures``: list the textures."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_block, print_json, print_lines, print_next, print_table
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.spec.block import Block


@options.command("textures", "Print")
@options.textures
@options.preset
@options.scale
@options.option("--nozzle", options.MM, "Diameter of the nozzle.", options.PRINTER, default="0.4")
@options.json
def command(textures: tuple[str, ...], preset: str, scale: float, nozzle: float, json: bool) -> None:
    """List the textures and the waves that a nozzle can print.

    For each texture the table has the equation, its lowest and highest value, the height of the relief, the thickness
    of the base, and the width of the finest ridge. The finest ridge is half as wide as the shortest wavelength.

    The column "waves printable" counts the waves whose ridges are at least as wide as the nozzle. A height map or a
    Python function is not a sum of waves; its column has the fraction of the variance of the height that belongs to
    such waves. If there is only one texture, a second table shows its spectrum.

    The layer height and
    the slicer also matter: "tacbench check-gcode" judges the sliced file.

    Examples:
      tacbench textures
      tacbench textures --preset released --nozzle 0.2
      tacbench textures --texture hex.toml --json
    """
    from tacbench_cad.making.choice import described
    from tacbench_cad.spec.wavelengths import turned_note

    if not (math.isfinite(nozzle) and 0.0 < nozzle <= 10.0):
        raise InputError("nozzle", nozzle, "must be above 0 and at most 10 mm")
    blocks = described(textures, preset, scale)
    rows = [_row(block, nozzle) for block in blocks]
    if json:
        print_json({"preset": preset, "scale": scale, "nozzle_mm": nozzle, "textures": rows})
        return
    x, y, z = rows[0]["size_mm"]
    numbers = (">lowest", ">highest", ">relief (mm)", ">base (mm)", ">finest ridge (mm)", ">waves printable")
    print_table(
        f"preset {preset}, scale {scale:g}: {x:g} x {y:g} x {z:g} mm, nozzle {nozzle:g} mm",
        ("texture", *numbers, "equation"),
        [
            (
                row["texture"],
                f"{row['lowest']:.4f}",
                f"{row['highest']:.4f}",
                f"{row['relief_mm']:.3f}",
                f"{row['base_mm']:.3f}",
                f"{row['finest_ridge_mm']:.3f}",
                f"{100.0 * row['printable_fraction']:.4g} %"
                if row["waves"] is None
                else f"{row['waves_printable']} of {row['waves']}",
                row["equation"],
            )
            for row in rows
        ],
    )
    if textures == ("all",):
        print_lines("fourteen later textures of the paper's authors: tacbench textures --texture later")
    print_lines('waves printable: by the width of the nozzle only; "tacbench check-gcode" judges the sliced file')
    print_lines(*filter(None, map(turned_note, blocks)))
    if len(rows) == 1:
        print_table(
            "spectrum: the fraction of the variance of the height in each octave of wavelengths",
            (">from (mm)", ">to (mm)", ">ridge (mm)", ">variance (%)"),
            [
                (
                    f"{band['from_mm']:g}",
                    f"{band['to_mm']:g}",
                    f"{band['from_mm'] / 2:g}",
                    f"{100 * band['fraction']:.2f}",
                )
                for band in rows[0]["spectrum"]
            ],
        )
    print_next("make", *next_block(textures, preset, scale))


def _row(block: Block, nozzle_mm: float) -> dict[str, Any]:
    """The row of a texture. ``lowest`` and ``highest`` are values of the formula over the block, without a unit."""
    from tacbench_cad.spec.wavelengths import spectrum

    waves, unit = spectrum(block), block.mm_per_unit[2]
    return {
        "texture": block.texture.name,
        "equation": block.texture.equation,
        "lowest": block.extremes.low / unit,
        "highest": block.extremes.high / unit,
        "relief_mm": block.relief_mm,
        "base_mm": block.base_mm,
        "size_mm": [*block.size_mm, block.height_mm],
        "finest_ridge_mm": waves.finest_ridge_mm,
        "waves": waves.waves,
        "waves_printable": waves.printable_waves(nozzle_mm),
        "printable_fraction": waves.printable(nozzle_mm),
        "spectrum": [{"from_mm": low, "to_mm": high, "fraction": fraction} for low, high, fraction in waves.bands()],
    }
