"""``tacbench doctor``: what is installed, what is broken, and the repair."""

from __future__ import annotations

from typing import Annotated

import typer

from tacbench_cad.cli.common import console, note, print_json, table

NAME = "doctor"


def command(
    repair: Annotated[bool, typer.Option("--repair", help="Run the repairs that pip can do.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Say what is installed, whether it works, and the command that repairs what does not.

    It knows the trap of the two kernel wheels (cadquery-ocp and cadquery-ocp-novtk write the same files) and the
    system libraries that the kernel loads. The exit code is 1 when something is broken. An extra that is not
    installed is not broken: the commands that need it say so.

    Examples:
      tacbench doctor
      tacbench doctor --repair
      tacbench doctor --json
    """
    from tacbench_cad.util import doctor

    diagnosis = doctor.diagnose()
    if repair and not diagnosis.ok:
        for done in doctor.repair(diagnosis):
            note(f"ran: pip install {' '.join(done)}")
        diagnosis = doctor.diagnose()
    if json:
        print_json(diagnosis.as_dict())
    else:
        facts = diagnosis.as_dict()
        shown = table(
            f"tacbench {facts['version']}, Python {facts['python']}, {facts['system']}",
            *("package", "version", "extra", "for"),
        )
        for package in diagnosis.packages:
            shown.add_row(
                package["name"], package["version"] or "not installed", package["extra"] or "", package["use"]
            )
        screen = console()
        screen.print(shown)
        for finding in diagnosis.findings:
            verdict = "ok" if finding.ok else "BROKEN"
            screen.print(f"{verdict}: {finding.name}: {finding.detail}", soft_wrap=True)
            if finding.repair:
                screen.print(f"  repair: {finding.repair}", soft_wrap=True)
        for extra, how in doctor.left_out_extras().items():
            screen.print(f"not installed: extra {extra}: {how}", soft_wrap=True)
    if not diagnosis.ok:
        raise typer.Exit(1)
