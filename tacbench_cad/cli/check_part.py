"""``tacbench check-part``: check STL, 3MF and STEP files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from tacbench_cad.cli import options
from tacbench_cad.cli.common import end_check, next_block, print_json, print_lines, print_next, print_table
from tacbench_cad.util.errors import InputError, TacbenchError, one_line, require_between
from tacbench_cad.util.text import at_most, counted, mm

if TYPE_CHECKING:
    from tacbench_cad.checks.report import Report


@options.command("check-part", "Print")
@options.argument("files", options.file("FILE"), "STL, 3MF or STEP files.", many=True)
@options.option(
    "--texture",
    options.TEXTURE,
    "Expected texture: 1 to 6, a name such as dunes, or a TOML file. Default: the nearest.",
    options.PARTS,
)
@options.option("--preset", options.PRESET, "Expected preset. Default: the nearest.", options.PARTS)
@options.option("--scale", options.SCALE, "Expected scale. Default: from the file's name or the sides.", options.SIZE)
@options.json
def command(
    files: tuple[Path, ...],
    texture: str | None,
    preset: str | None,
    scale: float | None,
    json: bool,
) -> None:
    """Check an STL, 3MF or STEP file against the formula.

    The file may come from any program. The command checks:
    - that the mesh is closed
    - that all triangles face outwards
    - that the size is right
    - that the relief is close enough to its formula
    - that nothing is cut out of the block: volume, through holes and all faces

    Each fault is printed, and the exit code is then 1.

    The origin may be anywhere, and the block may be turned by 90, 180 or 270 degrees. A block that lies upside down is
    reported as a fault. Without --texture and --preset, the command finds the nearest texture and preset and prints the
    distance from them. With --preset released, it compares with the sampled surface that the authors published.

    If a 3MF or STEP file has several bodies (a plate or an assembly), the command checks each body under its own name.
    It then uses --texture and --preset for every body that has a relief.

    Examples:
      tacbench check-part stl_out/*.stl
      tacbench check-part print.3mf --texture 4
      tacbench check-part z3.stl --texture 4 --preset released
      tacbench check-part block.step --json
      tacbench check-part stl_out/assembly_paper_x1.step
    """
    from tacbench_cad.checks.identify import examine
    from tacbench_cad.util.files import existing_file

    if scale is not None:
        require_between("scale", scale, 0.01, 100.0)
    reports: list[Report] = []
    refusals: list[tuple[Path, TacbenchError]] = []
    for path in files:
        try:
            reports.append(examine(existing_file(path), texture=texture, preset=preset, scale=scale))
        except InputError as error:
            if error.field in ("texture", "preset"):
                raise
            refusals.append((path, error))
    if json:
        print_json(
            {
                "ok": not refusals and all(report.ok for report in reports),
                "files": [report.as_dict() for report in reports],
                "refused": [{"file": path.name, "reason": one_line(refusal)} for path, refusal in refusals],
            }
        )
    else:
        for report in reports:
            _print(report)
    end_check(reports, [refusal for _, refusal in refusals])
    if not json:
        block = next_block((texture or "T",), preset or "paper", scale or 1.0)
        print_next("check-gcode", "FILE.gcode", *block)


def _print(report: Report) -> None:
    checks = [(check.name, "ok" if check.ok else "FAULT", check.detail) for check in report.checks]
    print_table(str(report.path), ("check", "", "result"), checks)
    facts = []
    if report.size_mm is not None:
        facts.append(mm(*report.size_mm))
    if report.triangles is not None:
        facts.append(f"{report.triangles:,} triangles")
    if report.volume_mm3 is not None:
        facts.append(f"{report.volume_mm3:.6g} mm^3")
    if report.deviation_mm is not None:
        facts.append(f"at most {at_most(report.deviation_mm, 3)} mm from the formula at the checked points")
    print_lines("; ".join([*facts, "all checks passed" if report.ok else counted(len(report.faults), "fault")]))
