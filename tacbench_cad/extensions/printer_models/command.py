"""``tacbench printer-model``: compute the model of a printer from scans of its prints."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.cli import note, options, print_json, print_lines, print_next, print_table, write_picture
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.extensions.printer_models.model import ReliefRule


@options.command("printer-model", "Print")
@options.argument("scans", options.file("SCANS"), "Files scan.json, or folders that contain them.", many=True)
@options.option(
    "--printer",
    options.text("NAME"),
    "Printer of the prints. Default: from the scans.",
    options.PRINTER,
)
@options.option(
    "--filament",
    options.text("NAME"),
    "Filament or resin of the prints. Default: from the scans.",
    options.PRINTER,
)
@options.option("--nozzle", options.MM, "Diameter of the nozzle. Default: from the scans.", options.PRINTER)
@options.option(
    "--relief",
    options.choice("formula", "free"),
    "Relief of corrected prints: that of the formula, or free, so that each wave is only corrected for its own error.",
    options.OUTPUT,
    default="formula",
    dest="relief_rule",
)
@options.option("--name", options.text("NAME"), "Name of the model. Default: printer and filament.", options.OUTPUT)
@options.flag("--no-picture", "Write no picture.", options.OUTPUT)
@options.out("FILE.toml", "File of the model. The picture gets the same name and the ending .png.", required=True)
@options.json
def command(
    scans: tuple[Path, ...],
    printer: str | None,
    filament: str | None,
    nozzle: float | None,
    name: str | None,
    relief_rule: ReliefRule,
    no_picture: bool,
    out: Path,
    json: bool,
) -> None:
    """Compute the model of a printer from scans of its prints.

    The scans are the files scan.json that tacbench scan writes. All of them must be of prints of plain files, by one
    printer with one filament and one nozzle. The model has:
    - the scales along x, y and z
    - the skew, and the offset of the walls
    - the transfer function along x and y: how much of a wave is printed
    - the repeatability: how much prints of the same block differ
    - an interval of 95 % for each number, and the number of prints

    If there are several prints, the intervals contain the difference between prints. With a single print they do not,
    so scan three or more prints. A number that no scan determines is left out.

    Examples:
      tacbench printer-model scans -o my-printer.toml
      tacbench printer-model a/scan.json b/scan.json --nozzle 0.6 -o ender.toml
      tacbench printer-model scans --relief free -o my-printer-free.toml
    """
    if out.suffix.lower() != ".toml":
        raise InputError("out", str(out), "must end in .toml")
    from tacbench_cad.extensions.printer_models.fitting import facts, find_scans, printer_model, read_print_scan
    from tacbench_cad.extensions.printer_models.model import write_printer_model
    from tacbench_cad.lab.study import own_name
    from tacbench_cad.util.convert import to_plain

    model = printer_model(
        [read_print_scan(path) for path in find_scans(scans)],
        printer=None if printer is None else own_name("printer", printer),
        filament=None if filament is None else own_name("filament", filament),
        nozzle_mm=nozzle,
        name=name,
        relief_rule=relief_rule,
    )
    write_printer_model(model, out)
    if json:
        print_json({"out": str(out), **to_plain(model)})
    else:
        about = f"{counted(model.prints, 'print')}, {counted(len(model.scans), 'scan')}"
        print_table(
            f"{model.printer} with {model.filament}: {about}" + (", simulated" if model.simulated else ""),
            ("", ">value", "interval of 95 %"),
            facts(model),
        )
        if model.prints == 1:
            print_lines("1 print: the intervals do not contain differences between prints; scan three or more")
    if not no_picture:
        from tacbench_cad.extensions.printer_models.picture import transfer_picture

        picture = out.with_suffix(".png")
        if write_picture(picture, partial(transfer_picture, model)):
            note(f"wrote {picture}")
    if not json:
        print_next("correct", out, "-o", "corrected")
