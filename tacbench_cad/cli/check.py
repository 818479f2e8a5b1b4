"""``tacbench check``: examine files, whoever made them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tacbench_cad.cli.common import console, given, lengths, note, number_of, one_line, print_json, table
from tacbench_cad.util.errors import InputError, TacbenchError
from tacbench_cad.util.text import counted

if TYPE_CHECKING:
    from tacbench_cad.checks.report import Report

NAME = "check"


def command(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="STL, 3MF or STEP files.", show_default=False)],
    texture: Annotated[
        str | None, typer.Option(metavar="T", help="What it should be: 1 to 6 or a TOML file. Default: the nearest.")
    ] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="paper|released", help="Compare with this preset. Default: the nearest.")
    ] = None,
    scale: Annotated[
        str | None, typer.Option(metavar="S", help="Its scale. Default: from the file's name or from its sides.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Examine STL, 3MF or STEP files: closed, wound alike, size, and distance of the relief from its formula.

    The origin may lie anywhere and the block may be turned by quarter turns; one that lies upside down is named so.
    Without --texture and --preset the nearest ones are named, with the residual. --preset released compares with the
    sampled surface that the authors published. Of a plate or an assembly (3MF, STEP) each body is examined by itself,
    under its own name; --texture and --preset then hold for every body with a relief. Every fault is named, and the
    exit code is then 1.

    Examples:
      tacbench check stl_out/*.stl
      tacbench check print.3mf --texture 4
      tacbench check z3.stl --texture 4 --preset released
      tacbench check block.step --json
      tacbench check stl_out/assembly_paper_x1.step
    """
    from tacbench_cad.checks.identify import examine
    from tacbench_cad.util.files import existing_file

    factor = given(number_of, "scale", scale)
    if factor is not None and not 0.01 <= factor <= 100.0:
        raise InputError("scale", factor, "must be between 0.01 and 100")
    reports: list[Report] = []
    refusals: list[tuple[Path, TacbenchError]] = []
    for path in files:
        try:
            reports.append(examine(existing_file(path), texture=texture, preset=preset, scale=factor))
        except InputError as error:
            if error.field in ("texture", "preset"):
                raise
            refusals.append((path, error))
    if json:
        print_json(
            {
                "ok": not refusals and all(one.ok for one in reports),
                "files": [one.as_dict() for one in reports],
                "refused": [{"file": path.name, "reason": one_line(str(refusal))} for path, refusal in refusals],
            }
        )
    else:
        for report in reports:
            _print(report)
    for _, refusal in refusals:
        note(f"error: {one_line(str(refusal))}")
    if any(not one.ok for one in reports):
        raise typer.Exit(1)
    if refusals:
        raise typer.Exit(max(refusal.exit_code for _, refusal in refusals))


def _print(report: Report) -> None:
    shown = table(str(report.path), "check", "", "what was found")
    for check in report.checks:
        shown.add_row(check.name, "ok" if check.ok else "FAULT", check.detail)
    screen = console()
    screen.print(shown)
    facts = []
    if report.size_mm is not None:
        facts.append(f"{lengths(report.size_mm)} mm")
    if report.triangles is not None:
        facts.append(f"{report.triangles:,} triangles")
    if report.volume_mm3 is not None:
        facts.append(f"{report.volume_mm3:.6g} mm^3")
    if report.deviation_mm is not None:
        facts.append(f"at most {report.deviation_mm:.3g} mm from the formula")
    faults = len(report.faults)
    verdict = "all checks passed" if report.ok else counted(faults, "fault")
    screen.print("; ".join([*facts, verdict]), soft_wrap=True)
