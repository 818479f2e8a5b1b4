"""``tacbench doctor``: check what is installed, and repair it."""

from __future__ import annotations

from click.exceptions import Exit

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note, print_json, print_lines, print_next, print_table


@options.command("doctor", "Help")
@options.flag("--repair", "Run the repairs that pip can do.", options.REPAIR)
@options.json
def command(repair: bool, json: bool) -> None:
    """Check what is installed, and repair it.

    For each fault you get the command that repairs it, and the exit code is 1. The command finds these faults:
    - cadquery-ocp and cadquery-ocp-novtk overwrite each other's files.
    - A system library of the CAD kernel is missing.
    - An installed package cannot be imported.

    A missing optional package is not a fault. The commands that need it tell you how to install it.

    Examples:
      tacbench doctor
      tacbench doctor --repair
      tacbench doctor --json
    """
    from tacbench_cad.cli.diagnosis import diagnose, left_out_extras
    from tacbench_cad.cli.diagnosis import repair as repaired

    diagnosis = diagnose()
    if repair and not diagnosis.ok:
        for arguments in repaired(diagnosis):
            note(f"ran: pip install {' '.join(arguments)}")
        diagnosis = diagnose()
    facts = diagnosis.as_dict()
    if json:
        print_json(facts)
    else:
        print_table(
            f"tacbench {facts['version']}, Python {facts['python']}, {facts['system']}",
            ("package", "version", "extra", "for"),
            [
                (package["name"], package["version"] or "not installed", package["extra"] or "", package["use"])
                for package in diagnosis.packages
            ],
        )
        for finding in diagnosis.findings:
            print_lines(f"{'ok' if finding.ok else 'BROKEN'}: {finding.name}: {finding.detail}")
            if finding.repair:
                print_lines(f"  repair: {finding.repair}")
        print_lines(*(f"not installed: extra {extra}: {how}" for extra, how in left_out_extras().items()))
    if not json:
        print_next(*(("make",) if diagnosis.ok else ("doctor", "--repair")))
    if not diagnosis.ok:
        raise Exit(1)
