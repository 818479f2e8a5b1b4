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
    import platform

    from tacbench_cad import __version__
    from tacbench_cad.cli.diagnosis import diagnose, left_out_extras
    from tacbench_cad.cli.diagnosis import repair as repaired
    from tacbench_cad.util.convert import to_plain
    from tacbench_cad.util.packages import PACKAGES

    findings = diagnose()
    if repair and not all(finding.ok for finding in findings):
        for done in repaired(findings):
            note(f"ran: {done}")
        findings = diagnose()
    ok = all(finding.ok for finding in findings)
    about = {"version": __version__, "python": platform.python_version()}
    about["system"] = f"{platform.system()} {platform.machine()}"
    rows = [(package.distribution, package.version, package.extra, package.use) for package in PACKAGES]
    heads = ("name", "version", "extra", "use")
    if json:
        packages = [dict(zip(heads, row, strict=True)) for row in rows]
        print_json({**about, "ok": ok, "packages": packages, "findings": to_plain(findings)})
    else:
        print_table(
            f"tacbench {about['version']}, Python {about['python']}, {about['system']}",
            ("package", "version", "extra", "for"),
            [(name, version or "not installed", extra or "", use) for name, version, extra, use in rows],
        )
        for finding in findings:
            print_lines(f"{'ok' if finding.ok else 'BROKEN'}: {finding.name}: {finding.detail}")
            if finding.repair:
                print_lines(f"  repair: {finding.repair}")
        print_lines(*(f"not installed: extra {extra}: {how}" for extra, how in left_out_extras().items()))
        print_next(*(("make",) if ok else ("doctor", "--repair")))
    if not ok:
        raise Exit(1)
