"""``tacbench make``: the print set."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from click.exceptions import Exit

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_table
from tacbench_cad.cli.progress import ProgressLine
from tacbench_cad.util.text import by, counted

if TYPE_CHECKING:
    from tacbench_cad.making.printset import PrintSet


@options.command("make")
@options.textures
@options.part
@options.option(
    "--parts", options.words("LIST"), "Of blocks, holder, jig, coupon. Default: blocks,holder,jig.", panel=options.WHAT
)
@options.option("--formats", options.words("LIST"), "Of stl, 3mf, step. Default: all of them.", panel=options.WHAT)
@options.option("--copies", options.COUNT, "N files of each block, numbered in the label.", panel=options.WHAT)
@options.flag("--assembly", "Also holder, a block in each slot and jig as one 3MF and STEP.", panel=options.WHAT)
@options.option(
    "--step-tolerance",
    options.MM,
    "Distance of solids from the formula. Default: 0.001.",
    dest="step_tolerance_mm",
    panel=options.MESH,
)
@options.option(
    "--verify",
    options.choice("default", "full"),
    "full adds pymeshlab's slow checks.",
    default="default",
    show_default=False,
    panel=options.MESH,
)
@options.out("FOLDER", "Output folder.", default="stl_out")
@options.json
def command(verify: str, json: bool, **request: Any) -> None:
    """Make the print set: blocks, holder and jig as STL, 3MF and STEP, each file checked as it lies on disk.

    Without --formats and --parts it makes what this install can, and names what was left out and how to get it.
    A file that fails a check is not put in place, and the exit code is 1. Lengths are in mm.

    Examples:
      tacbench make
      tacbench make --preset released --out published
      tacbench make --texture 1,4 --scale 1.5 --key --formats stl
      tacbench make --texture hex.toml --size 40,40 --grid 189x201
      tacbench make --copies 6 --formats 3mf --parts blocks --out study
      tacbench make --parts coupon --formats stl     (find the fit first)
      tacbench make --key --slots 6 --assembly       (and the six blocks in a tray, with the jig on it)
    """
    from tacbench_cad.making.printset import Request, build

    with ProgressLine(every_s=0.0) as progress:
        result = build(Request(**options.request_fields(request), full=verify == "full"), progress.show)
    if json:
        print_json(result.as_dict())
    else:
        _print(result)
    for failure in result.failures:
        note(f"failed, not put in place: {failure.file}: {'; '.join(failure.faults)}")
    if not result.ok:
        raise Exit(1)


def _print(result: PrintSet) -> None:
    rows = [
        (
            row["file"],
            by(*(round(side, 2) for side in row["size_mm"])),
            "" if row["triangles"] is None else f"{row['triangles']:,}",
            "" if row["deviation_mm"] is None else f"{row['deviation_mm']:.2g}",
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
