"""``tacbench plate``: arrange blocks on a printer's bed."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from tacbench_cad.cli import Items, note, of_words, options, print_json, print_next, print_table, write_picture
from tacbench_cad.util.errors import InputError

if TYPE_CHECKING:
    from tacbench_cad.extensions.slicing.plate_files import PlateFiles
    from tacbench_cad.extensions.slicing.plates import Plate
    from tacbench_cad.extensions.slicing.printers import Printer


def of_printers(ctx: click.Context, incomplete: str) -> Items:
    """Offer the known printers and the printers in the file of ``--printers``."""
    return of_words(*_printers(ctx))(ctx, incomplete)


def of_filaments(ctx: click.Context, incomplete: str) -> Items:
    """Offer the filaments of the printer in ``--printer``, or of all printers."""
    printers = [printer for name, printer in _printers(ctx).items() if ctx.params.get("printer") in (None, name)]
    return of_words(*dict.fromkeys(name for printer in printers for name in printer.filaments))(ctx, incomplete)


def _printers(ctx: click.Context) -> dict[str, Printer]:
    """The known printers. A file with a mistake is ignored: the command itself reports the mistake."""
    from tacbench_cad.extensions.slicing.printers import printers

    try:
        return printers(ctx.params.get("printers"))
    except InputError:
        return printers()


@options.command("plate", "Print")
@options.option(
    "--printer",
    options.text("NAME", complete=of_printers),
    "ender-3, ender-3-v3-se, bambu-p1p, form-3 or a printer from your own file.",
    options.PRINTER,
    required=True,
)
@options.option(
    "--filament",
    options.text("NAME", complete=of_filaments),
    "Filament or resin. Default: the printer's first one.",
    options.PRINTER,
)
@options.textures
@options.option("--copies", options.COUNT, "Copies of each block.", options.PARTS, default="1")
@options.preset
@options.key
@options.scale
@options.option(
    "--files",
    options.file("DIR"),
    "Folder with the texture files that are printed instead, such as texture-4.toml; tacbench correct writes them.",
    options.PARTS,
)
@options.option("--spacing", options.MM, "Space between two blocks.", options.PRINTER, default="5")
@options.option("--printers", options.file("FILE.toml"), "File with printers of your own.", options.PRINTER)
@options.out("DIR", "Folder of the files.", default="plates")
@options.json
def command(
    printer: str,
    textures: tuple[str, ...],
    copies: int,
    preset: str,
    scale: float,
    key_mm: float | None,
    files: Path | None,
    filament: str | None,
    spacing: float,
    printers: Path | None,
    out: Path,
    json: bool,
) -> None:
    """Arrange copies of blocks on the bed of a printer.

    The blocks fill as many plates as they need, and each block has its label engraved. For each plate, the command
    writes:
    - a 3MF file with every block in its place
    - the layout as CSV and as PNG
    - a print record that you fill in when you print

    The copies of a texture are spread over the bed. So an effect of the position on the bed is not mistaken for an
    effect of the texture. The column imbalance has the distance from the middle of the copies of a texture to the
    middle of all blocks, for the texture with the largest distance. It needs at least two copies of each texture.

    You can use the layouts in the study file of "tacbench acquire". The key layouts then lists the layout files and
    replaces the keys textures and prints.

    If you run the command again, it replaces the plates but keeps the print records that exist. If the folder contains
    more plates than the new request has, the command refuses: otherwise you could print an old plate by mistake.

    A file with printers of your own has a table printer.NAME for each printer. Its keys are:
    - bed_mm: the two sides of the bed
    - height_mm: the largest height of a print
    - filaments: the list of filaments
    - margin_mm (optional): the distance to keep from the edge of the bed
    - keep_out_mm (optional): rectangles X0, Y0, X1, Y1 of the bed to leave free

    Examples:
      tacbench plate --printer bambu-p1p --copies 6
      tacbench plate --printer form-3 --copies 6 --key --out resin
      tacbench plate --printer ender-3 --texture 2,4 --copies 3 --filament petg
      tacbench plate --printer my-printer --printers my.toml --texture hex.toml
    """
    from tacbench_cad.extensions.slicing.plate_files import write_plates
    from tacbench_cad.extensions.slicing.plates import arrange_plates
    from tacbench_cad.extensions.slicing.printers import printer_named
    from tacbench_cad.extensions.slicing.printers import printers as known_printers
    from tacbench_cad.extensions.slicing.slicing_pictures import plate_picture
    from tacbench_cad.lab.study import block_in_file, own_name
    from tacbench_cad.spec import Block, find_textures

    machine = printer_named(printer, known_printers(printers))
    own_name("printer", machine.name)
    material = own_name("filament", filament if filament is not None else machine.filaments[0])
    blocks = [Block.of(texture, preset, scale=scale, key_mm=key_mm) for texture in find_textures(textures, preset)]
    printed = {}
    if files is not None:
        paths = [files / f"{block.texture.name}.toml" for block in blocks]
        in_files = [block_in_file(block, path) for block, path in zip(blocks, paths, strict=True)]
        for block, file, path in zip(blocks, in_files, paths, strict=True):
            printed[file.texture.name] = (block.texture.name, path)
        blocks = in_files
    plates = arrange_plates(blocks, copies, machine, spacing)
    if not all(placed.block.label for plate in plates for placed in plate.blocks):
        note("warning: some blocks are too small for an engraved label; mark them by hand after printing")
    own = [Path(word) for word in textures if word.lower().endswith(".toml")]
    written = write_plates(plates, material, out, own, printed)
    pictures = [
        write_picture(made.picture, partial(plate_picture, plate, material))
        for plate, made in zip(plates, written, strict=True)
    ]
    for made, drawn in zip(written, pictures, strict=True):
        for path in (*made.paths, *([made.picture] if drawn else [])):
            note(f"wrote {path}")
    if json:
        rows = zip(plates, written, pictures, strict=True)
        print_json({"printer": machine.name, "filament": material, "plates": [_row(*row) for row in rows]})
    else:
        balanced = any(plate.imbalance_mm is not None for plate in plates)
        heads = (">plate", ">blocks", *([">imbalance (mm)"] if balanced else []), "labels")
        print_table(f"{machine.name}, {material}", heads, [_cells(plate, balanced) for plate in plates])
        print_next("acquire", "--init", "study.toml")


def _row(plate: Plate, files: PlateFiles, drawn: bool) -> dict[str, object]:
    return {
        "plate": plate.number,
        "model": files.model.name,
        "layout": files.layout.name,
        "record": files.record.name,
        "picture": files.picture.name if drawn else None,
        "imbalance_mm": plate.imbalance_mm,
        "blocks": [
            {"label": placed.label, "name": placed.block.name, "x_mm": placed.x_mm, "y_mm": placed.y_mm}
            for placed in plate.blocks
        ],
    }


def _cells(plate: Plate, balanced: bool) -> tuple[object, ...]:
    """Return the cells of a plate's row, with its imbalance if a plate has one."""
    copies: dict[tuple[str, ...], list[str]] = {}
    for *words, copy in sorted(placed.block.label_words for placed in plate.blocks):
        copies.setdefault(tuple(words), []).append(copy)
    labels = "\n".join(" ".join([*words, *numbers]) for words, numbers in copies.items())
    imbalance = "-" if plate.imbalance_mm is None else f"{plate.imbalance_mm:.1f}"
    return plate.number, len(plate.blocks), *([imbalance] if balanced else []), labels
