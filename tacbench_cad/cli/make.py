"""``tacbench make``: the print set."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import (
    console,
    given,
    lengths,
    note,
    number_of,
    part_options,
    print_json,
    table,
    whole_of,
    words_of,
)
from tacbench_cad.util.errors import one_of
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.making.printset import PrintSet, Progress

NAME = "make"

_WHAT, _SIZE, _MESH, _FIXTURES, _OUTPUT = "What", "Size", "How exact", "Fixtures", "Output"


def command(
    preset: Annotated[
        str, typer.Option(metavar="paper|released", rich_help_panel=_WHAT, help="Geometry to begin from.")
    ] = "paper",
    texture: Annotated[
        str,
        typer.Option(metavar="1,4|FILE.toml|all", rich_help_panel=_WHAT, help="Textures, with commas between them."),
    ] = "all",
    parts: Annotated[
        str | None,
        typer.Option(
            metavar="LIST", rich_help_panel=_WHAT, help="Of blocks, holder, jig, coupon. Default: blocks,holder,jig."
        ),
    ] = None,
    formats: Annotated[
        str | None, typer.Option(metavar="LIST", rich_help_panel=_WHAT, help="Of stl, 3mf, step. Default: all of them.")
    ] = None,
    copies: Annotated[
        str | None,
        typer.Option(metavar="N", rich_help_panel=_WHAT, help="N files of each block, numbered in the label."),
    ] = None,
    assembly: Annotated[
        bool,
        typer.Option(
            "--assembly", rich_help_panel=_WHAT, help="Also holder, a block in each slot and jig as one 3MF and STEP."
        ),
    ] = False,
    label: Annotated[
        bool, typer.Option("--label", rich_help_panel=_WHAT, help="Engrave texture, preset and scale in the underside.")
    ] = False,
    key: Annotated[
        str | None,
        typer.Option(
            metavar="[MM]", rich_help_panel=_WHAT, help="Cut the corner at (X, 0), 3 mm if no number follows."
        ),
    ] = None,
    scale: Annotated[
        str, typer.Option(metavar="S", rich_help_panel=_SIZE, help="Multiply sides, height, mm per unit, press grid.")
    ] = "1",
    size: Annotated[
        str | None, typer.Option(metavar="X,Y", rich_help_panel=_SIZE, help="Sides in mm: more or fewer periods.")
    ] = None,
    height: Annotated[
        str | None,
        typer.Option(metavar="MM", rich_help_panel=_SIZE, help="Height of the highest point: another base."),
    ] = None,
    mm_per_unit: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", rich_help_panel=_SIZE, help="Mapping of the formula to mm.")
    ] = None,
    tolerance: Annotated[
        str | None,
        typer.Option(metavar="MM", rich_help_panel=_MESH, help="Distance of meshes from the formula. Default: 0.01."),
    ] = None,
    grid: Annotated[
        str | None,
        typer.Option(
            metavar="[NXxNY]", rich_help_panel=_MESH, help="Join samples instead, the preset's if no size follows."
        ),
    ] = None,
    step_tolerance: Annotated[
        str | None,
        typer.Option(metavar="MM", rich_help_panel=_MESH, help="Distance of solids from the formula. Default: 0.001."),
    ] = None,
    verify: Annotated[
        str,
        typer.Option(
            metavar="default|full",
            rich_help_panel=_MESH,
            help="full adds pymeshlab's slow checks.",
            show_default=False,
        ),
    ] = "default",
    fit: Annotated[
        str | None,
        typer.Option(metavar="press|slip|loose|MM", rich_help_panel=_FIXTURES, help="Clearance of pockets, per side."),
    ] = None,
    rim: Annotated[
        str | None, typer.Option(metavar="MM", rich_help_panel=_FIXTURES, help="Holder's rim below the block's top.")
    ] = None,
    slots: Annotated[
        str | None, typer.Option(metavar="N", rich_help_panel=_FIXTURES, help="Pockets of the holder.")
    ] = None,
    nozzle: Annotated[
        str | None,
        typer.Option(metavar="MM", rich_help_panel=_FIXTURES, help="Nozzle that fixtures are for. Default: 0.4."),
    ] = None,
    jig: Annotated[
        str | None,
        typer.Option(metavar="default|all", rich_help_panel=_FIXTURES, help="all: 25 holes, for a resin printer."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="FOLDER", rich_help_panel=_OUTPUT, help="Output folder.")] = Path(
        "stl_out"
    ),
    json: Annotated[bool, typer.Option("--json", rich_help_panel=_OUTPUT, help="Print one JSON document.")] = False,
) -> None:
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
    request = Request(
        textures=words_of(texture) or (),
        preset=preset,
        scale=number_of("scale", scale),
        formats=words_of(formats),
        parts=words_of(parts),
        copies=given(whole_of, "copies", copies),
        full=one_of("verify", verify, ("default", "full")) == "full",
        out=out,
        step_tolerance_mm=given(number_of, "step tolerance", step_tolerance),
        assembly=assembly,
        **part,
    )
    with _Bar() as bar:
        result = build(request, bar.show)
    if json:
        print_json(result.as_dict())
    else:
        _print(result)
    for one in result.failures:
        note(f"failed, not put in place: {one.file}: {'; '.join(one.faults)}")
    if not result.ok:
        raise typer.Exit(1)


class _Bar:
    """Progress on the standard error: a bar on a terminal, else a line for each file."""

    def __enter__(self) -> _Bar:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

        screen = Console(stderr=True)
        self._bar: Progress | None = None
        if screen.is_terminal:
            columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
            self._bar = Progress(*columns, console=screen, transient=True)
            self._task = self._bar.add_task("", total=None)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()

    def show(self, message: str, done: int, total: int) -> None:
        if self._bar is not None:
            self._bar.update(self._task, description=message, completed=done, total=total)
        else:
            note(f"[{done}/{total}] {message}")


def _print(result: PrintSet) -> None:
    made = table(
        f"{counted(len(result.rows), 'file')} in {result.out}",
        *("file", "size (mm)", "triangles", "deviation (mm)", "checks"),
        right=("triangles", "deviation (mm)"),
    )
    for row in result.rows:
        deviation, triangles = row["deviation_mm"], row["triangles"]
        made.add_row(
            row["file"],
            lengths([round(side, 2) for side in row["size_mm"]]),
            "" if triangles is None else f"{triangles:,}",
            "" if deviation is None else f"{deviation:.2g}",
            f"{len(row['checks'])} passed",
        )
    for one in result.failures:
        made.add_row(one.file, "", "", "", "FAILED")
    screen = console()
    screen.print(made)
    for left in result.left_out:
        screen.print(f"left out: {left.what}: {left.reason}", soft_wrap=True)
    if result.preview:
        screen.print(f"pictures: {result.out / 'preview.png'}", soft_wrap=True)


if TYPE_CHECKING:
    _: Progress = _Bar().show
