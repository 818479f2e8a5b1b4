"""``tacbench watch``: show runs in the browser, also while they are recorded."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.cli import note, of_run_folders, options
from tacbench_cad.util.errors import InputError


@options.command("watch", "Press")
@options.argument("runs", options.file("RUNS", of_run_folders), "Run folder, or folder with run folders.")
@options.host
@options.port
@options.no_browser
def command(runs: Path, host: str, port: int, no_browser: bool) -> None:
    """Show runs in the browser, also while they are recorded.

    The page shows the newest frame and its reference, the displacement of the markers, the force against the depth, the
    force error at each position, the time left, and the findings so far. It only reads the run folders, so it cannot
    disturb the rig. For a page with the buttons Stop, Pause and "Block is in", use tacbench acquire --page.

    Only browsers on this machine can open the page, and only with the address that the command prints. Press Ctrl-C to
    end the command.

    Examples:
      tacbench watch runs
      tacbench watch runs --host 192.168.1.20  # also for a phone
    """
    from tacbench_cad.util.packages import require

    require("the page", "starlette", "uvicorn", "websockets")
    from tacbench_cad.extensions.watch.serving import watch

    if not runs.is_dir():
        raise InputError("run", str(runs), "is not a folder" if runs.exists() else "does not exist")

    watch(
        runs,
        port=port,
        host=host,
        browser=not no_browser,
        announce=lambda address: note(f"open {address}\npress Ctrl-C to end"),
    )
