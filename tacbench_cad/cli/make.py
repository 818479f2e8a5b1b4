"""``tacbench make``: make the print set."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from tacbench_cad.cli import options
from tacbench_cad.cli.common import next_block, note, print_json, print_lines, print_next, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.text import by, counted

if TYPE_CHECKING:
    from tacbench_cad.making.printset import PrintSet


@options.command("make", "Print")
@options.textures
@options.part
@options.option(
    "--parts",
    options.words("LIST", *options.PART_NAMES),
    "Parts to make: blocks, holder, jig, coupon. Default: blocks,holder,jig.",
    options.PARTS,
)
@options.formats
@options.copies
@options.flag("--assembly", "Also write holder, blocks and jig together as one file.", options.PARTS)
@options.option(
    "--step-tolerance",
    options.MM,
    "Largest distance of a STEP solid from the formula. Default: 0.001, or more if the texture needs it.",
    options.ACCURACY,
    dest="step_tolerance_mm",
)
@options.option(
    "--verify",
    options.choice("default", "full"),
    "full adds slow checks by pymeshlab. Default: only the fast checks.",
    options.ACCURACY,
    default="default",
    show_default=False,
)
@options.out("DIR", "Folder of the files.", default="stl_out")
@options.json
def command(verify: str, json: bool, **request: Any) -> None:
    """Make the print set: blocks, holder and jig.

    The files are STL, 3MF and STEP. Each file is read back and checked. If a file fails a check, it is not put into the
    folder, and the exit code is 1. Lengths are in mm.

    Use the preset paper for new work. Use --preset released if you want to compare with the prints of the authors.

    If a part or a format needs a package that is not installed, this part or format is left out, and the command prints
    how to install the package. If you asked for the part or format by --parts or --formats, this is an error.

    Examples:
      tacbench make
      tacbench make --preset released --out published
      tacbench make --texture 1,4 --scale 1.5 --key --formats stl
      tacbench make --texture hex.toml --size 40,40 --grid 189x201
      tacbench make --copies 6 --formats 3mf --parts blocks --out study
      tacbench make --parts coupon --formats stl  # find the fit first
      tacbench make --key --slots 6 --assembly    # all six blocks in one tray
    """
    from tacbench_cad.making.printset import Request, build
    from tacbench_cad.making.request import blocks_of
    from tacbench_cad.spec.wavelengths import error_note, turned_note

    options_of_call = Request(**options.request_fields(request), full=verify == "full")
    with ProgressLine(every_s=0.0) as progress:
        result = build(options_of_call, progress.show)
    blocks = blocks_of(options_of_call)
    if json:
        print_json(result.as_dict())
    else:
        show_print_set(result)
        print_lines(*filter(None, [note_of(block) for note_of in (turned_note, error_note) for block in blocks]))
        if request["parts"] != ("coupon",):
            print_lines(_preset(request["preset"]))
        if result.ok:
            print_next(*_next(request))
    for failure in result.failures:
        note(f"failed, not written: {failure.file}: {'; '.join(failure.faults)}")
    if not result.ok:
        raise Exit(1)


def _next(request: Mapping[str, Any]) -> list[str]:
    """The words of the next command."""
    parts = request["parts"] or ("blocks",)
    if "blocks" in parts and not any(request[name] for name in ("size_mm", "height_mm", "mm_per_unit")):
        block = next_block(request["textures"], request["preset"], request["scale"], request["key_mm"])
        return ["plate", "--printer", "NAME", *block]
    return ["make", "--fit", "FIT"] if tuple(parts) == ("coupon",) else ["acquire", "--init", "study.toml"]


def _preset(preset: str) -> str:
    """The line that says which preset was used, and when to use it."""
    if preset == "released":
        return "preset: released, to compare with the authors' prints (for new work, use --preset paper)"
    return "preset: paper, for new work (to compare with the authors' prints, use --preset released)"


def show_print_set(result: PrintSet) -> None:
    """Print a table of the files of a print set, and what was left out."""
    from tacbench_cad.making.manifest import largest_distance

    rows = [
        (
            row["file"],
            by(*(round(side, 2) for side in row["size_mm"])),
            "" if row["triangles"] is None else f"{row['triangles']:,}",
            largest_distance(row),
            f"{len(row['checks'])} passed",
        )
        for row in result.rows
    ]
    rows += [(failure.file, "", "", "", "FAILED") for failure in result.failures]
    heads = ("file", "size (mm)", ">triangles", ">deviation (mm)", "checks")
    print_table(f"{counted(len(result.rows), 'file')} in {result.out}", heads, rows)
    print_lines(*(f"left out: {left.what}: {left.reason}" for left in result.left_out))
    if result.preview:
        print_lines(f"pictures: {result.out / 'preview.png'}")
