"""The ``tacbench`` command. Nothing that takes long to import is imported before a command needs it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from tacbench_cad import __version__
from tacbench_cad.cli import (
    acquire,
    check,
    cite,
    classify,
    compare,
    doctor,
    export,
    grade,
    import_,
    make,
    plate,
    report,
    rig,
    runs,
    score,
    show,
    simulate,
    slice_check,
    split,
    textures,
    variance,
    view,
)
from tacbench_cad.cli.common import one_line, with_default_values
from tacbench_cad.util.errors import MissingToolError, TacbenchError
from tacbench_cad.util.packages import why_not_imported

app = typer.Typer(
    name="tacbench",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"tacbench {__version__}")
        raise typer.Exit


@app.callback()
def tacbench(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    """Printable tactile texture blocks from formulas: made, checked, pressed and compared.

    Examples:
      tacbench make                         the six blocks, holder and jig, in stl_out/
      tacbench make --texture 4 --scale 2   one block at twice the size, with its fixtures
      tacbench plate --printer ender-3 --copies 6 --out plates   arranged on a printer's bed
      tacbench check stl_out/*.stl          examine files, also such as were made elsewhere
      tacbench textures                     what there is, and what a nozzle can print of it
      tacbench show 4 --press               a picture of a texture and the press positions
      tacbench view -o view.html            the print set in 3D, in a browser
      tacbench export --to mjcf --out sim   the textures for simulators, with contact that keeps the relief
      tacbench acquire --virtual --out runs press a block on a simulated rig; with a FILE.toml on yours
      tacbench runs check runs              examine what was recorded
      tacbench simulate --study quick --out study  a whole simulated study
      tacbench report study -o report.html  what the data say, on one page
      tacbench doctor                       what is installed, and how to repair it

    Every command has its own --help. Exit codes: 0 done, 1 a check failed, 2 bad input or something missing,
    3 a run stopped safely that can go on, 130 interrupted.
    """


_MODULES = (
    make,
    plate,
    slice_check,
    check,
    textures,
    show,
    view,
    export,
    acquire,
    simulate,
    import_,
    variance,
    grade,
    classify,
    report,
    cite,
    split,
    score,
    compare,
    doctor,
)
for _module in _MODULES:
    app.command(_module.NAME)(_module.command)
for _group in (runs, rig):
    app.add_typer(_group.app, name=_group.NAME)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments without the program's name; None for those of this process.

    Returns:
        The exit code: 0 done, 1 a check failed, 2 bad input or a missing tool, 3 a run stopped safely, 130 interrupted.
    """
    # Our matrix products are small: threads only get in each other's way. A user's own value stays.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = with_default_values(sys.argv[1:] if argv is None else argv) or ["--help"]
    try:
        outcome = app(arguments, prog_name="tacbench", standalone_mode=False)
    except TacbenchError as error:
        print(f"error: {one_line(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        outcome = 130
    except ModuleNotFoundError as error:
        reason = why_not_imported(error)
        if reason is None:
            raise
        print(f"error: {reason}", file=sys.stderr)
        return MissingToolError.exit_code
    except Exception as error:
        # Typer's own errors come from click, or from a copy of it inside Typer: known by what they can do.
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        context = getattr(error, "ctx", None)
        where = f" (see {context.command_path} --help)" if context is not None else ""
        print(f"error: {one_line(message())}{where}", file=sys.stderr)
        return 2
    if outcome == 130:
        print("error: interrupted", file=sys.stderr)
    return outcome if isinstance(outcome, int) else 0
