"""``tacbench plate``: blocks arranged on a printer's bed, ready to slice."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import console, given, key_of, note, number_of, print_json, table, whole_of, words_of
from tacbench_cad.util.errors import MissingToolError

if TYPE_CHECKING:
    from tacbench_cad.slicing.plates import Plate
    from tacbench_cad.slicing.writing import PlateFiles

NAME = "plate"


def command(
    printer: Annotated[
        str,
        typer.Option(metavar="NAME", help="ender-3, ender-3-v3-se, bambu-p1p, form-3 or your own.", show_default=False),
    ],
    texture: Annotated[
        str, typer.Option(metavar="1,4|FILE.toml|all", help="Textures, with commas between them.")
    ] = "all",
    copies: Annotated[str, typer.Option(metavar="N", help="Copies of each.")] = "1",
    preset: Annotated[str, typer.Option(metavar="paper|released", help="Geometry to begin from.")] = "paper",
    scale: Annotated[str, typer.Option(metavar="S", help="Multiply the blocks by S.")] = "1",
    key: Annotated[
        str | None, typer.Option(metavar="MM", help="Cut the corner (X, 0), as in make; alone: the default leg.")
    ] = None,
    filament: Annotated[
        str | None, typer.Option(metavar="NAME", help="What it is printed of. Default: the printer's first.")
    ] = None,
    spacing: Annotated[str, typer.Option(metavar="MM", help="What stays free between two blocks.")] = "5",
    printers: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="Printers of your own, beside the known ones.")
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")] = Path("plates"),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Arrange blocks, with their labels engraved, on a printer's bed, on as many plates as it takes.

    Each plate becomes a 3MF with every block in its place, a layout as CSV and as PNG, and a print record to fill in.
    Copies of a texture are spread over the bed, so that where a block lay is not confounded with its texture. In the
    file of acquire, the table study takes the layouts in place of textures and prints: layouts = ["plate01.csv"].

    Plates of the same printer and filament are written anew; a print record that is there already stays. A folder with
    more of them than these is refused: nobody shall print what an earlier request left there.

    Printers of your own stand in a file with a table printer.NAME for each: bed_mm (two sides), height_mm, filaments,
    and where they are needed margin_mm and keep_out_mm.

    Examples:
      tacbench plate --printer bambu-p1p --copies 6
      tacbench plate --printer form-3 --copies 6 --key --out resin
      tacbench plate --printer ender-3 --texture 2,4 --copies 3 --filament petg --spacing 10
      tacbench plate --printer lab-delta --printers ours.toml --texture hex.toml --copies 9
    """
    from tacbench_cad.lab.study.names import own_name
    from tacbench_cad.making.choice import textures_of
    from tacbench_cad.slicing.plates import arrange_plates
    from tacbench_cad.slicing.printers import printer_named
    from tacbench_cad.slicing.printers import printers as known_printers
    from tacbench_cad.slicing.writing import write_plates
    from tacbench_cad.spec.block import Block

    machine = printer_named(printer, known_printers(printers))
    own_name("printer", machine.name)
    material = own_name("filament", filament if filament is not None else machine.filaments[0])
    factor, leg = number_of("scale", scale), given(key_of, "key", key)
    words = words_of(texture) or ()
    found = textures_of(words, preset)
    blocks = [Block.of(one, preset, scale=factor, key_mm=leg, table=block) for one, block in found]
    plates = arrange_plates(blocks, whole_of("copies", copies), machine, number_of("spacing", spacing))
    if not all(one.block.label for plate in plates for one in plate.blocks):
        note("warning: some blocks are too small for an engraved label; mark them by hand when they come off the bed")
    files = [Path(word) for word in words if word.lower().endswith(".toml")]
    written = write_plates(plates, material, out, files)
    pictures = [_draw(plate, one, material) for plate, one in zip(plates, written, strict=True)]
    for one, drawn in zip(written, pictures, strict=True):
        for path in (*one.paths, *([one.picture] if drawn else [])):
            note(f"wrote {path}")
    if json:
        rows = zip(plates, written, pictures, strict=True)
        print_json({"printer": machine.name, "filament": material, "plates": [_row(*row) for row in rows]})
    else:
        _print(plates, machine.name, material)


def _draw(plate: Plate, files: PlateFiles, filament: str) -> bool:
    from tacbench_cad.slicing.plate_picture import plate_picture

    try:
        plate_picture(plate, filament, files.picture)
    except MissingToolError as error:
        note(f"no picture: {error}")
        return False
    return True


def _row(plate: Plate, files: PlateFiles, drawn: bool) -> dict[str, object]:
    return {
        "plate": plate.number,
        "model": files.model.name,
        "layout": files.layout.name,
        "record": files.record.name,
        "picture": files.picture.name if drawn else None,
        "imbalance_mm": plate.imbalance_mm,
        "blocks": [
            {"label": one.label, "name": one.block.name, "x_mm": one.x_mm, "y_mm": one.y_mm} for one in plate.blocks
        ],
    }


def _print(plates: list[Plate], printer: str, filament: str) -> None:
    heads = ("plate", "blocks", "copies off the middle (mm)")
    shown = table(f"{printer}, {filament}", *heads, "labels", right=heads)
    for plate in plates:
        copies: dict[tuple[str, ...], list[str]] = {}
        for *words, copy in sorted(one.block.label_words for one in plate.blocks):
            copies.setdefault(tuple(words), []).append(copy)
        labels = "\n".join(" ".join([*words, *numbers]) for words, numbers in copies.items())
        shown.add_row(str(plate.number), str(len(plate.blocks)), f"{plate.imbalance_mm:.1f}", labels)
    console().print(shown)
