"""The ``tacbench`` command. Nothing that takes long to import is imported before a command needs it."""

from __future__ import annotations

import importlib
import os
import shlex
import sys
from collections.abc import Sequence

import rich_click as click
from click.exceptions import ClickException, Exit, NoSuchCommand, UsageError

from tacbench_cad import __version__
from tacbench_cad.cli.common import note
from tacbench_cad.cli.options import help_of, refuse_old_name
from tacbench_cad.util.errors import MissingToolError, TacbenchError, one_line
from tacbench_cad.util.packages import why_not_imported

#: The commands under their headings, in the order in which people use them.
GROUPS = {
    "Print": ("textures", "make", "show", "view", "check-part", "plate", "check-gcode"),
    "Press": ("rig", "acquire", "simulate", "import-frames", "check-runs", "runs"),
    "Analyse": ("variance", "grade", "classify", "split", "score", "compare", "report"),
    "Share": ("publish", "export-runs", "export-simulator", "cite"),
    "Help": ("doctor",),
}
#: Exit code of a run that was stopped safely.
SAFELY_STOPPED = 3
#: The commands that resume their work when they are typed again after an interruption.
RESUMABLE = ("acquire", "simulate", "import-frames", "classify", "report")


class _Commands(click.RichGroup):
    """The commands. Each is imported when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for names in GROUPS.values() for name in names]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        refuse_old_name(ctx, cmd_name)
        if cmd_name not in self.list_commands(ctx):
            raise NoSuchCommand(cmd_name, possibilities=self.list_commands(ctx), ctx=ctx)
        module = importlib.import_module(f"{__name__}.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command


@click.command(
    "tacbench",
    cls=_Commands,
    panels=[click.RichCommandPanel(title, commands=list(names)) for title, names in GROUPS.items()],
    context_settings={
        "help_option_names": ["-h", "--help"],
        "rich_help_config": {"text_paragraph_linebreaks": "\n\n", "padding_helptext_first_line": (0, 0, 1, 0)},
    },
)
@click.version_option(__version__, message="tacbench %(version)s", help="Print the version and stop.")
def tacbench() -> None:
    """Printable tactile texture blocks from formulas: made, checked, pressed and compared.

    Every command has its own --help. Exit codes: 0 done, 1 a check failed, 2 bad input or something missing,
    3 a run stopped safely that can go on, 130 interrupted.

    Examples:
      tacbench make                         the six blocks, holder and jig, in stl_out/
      tacbench make --texture 4 --scale 2   one block at twice the size, with its fixtures
      tacbench plate --printer ender-3 --copies 6 --out plates   arranged on a printer's bed
      tacbench check-part stl_out/*.stl          examine files, also such as were made elsewhere
      tacbench textures                     what there is, and what a nozzle can print of it
      tacbench show 4 --press               a picture of a texture and the press positions
      tacbench view -o view.html            the print set in 3D, in a browser
      tacbench export-simulator --to mjcf --out sim   the textures for simulators, with contact that keeps the relief
      tacbench acquire --virtual --out runs press a block on a simulated rig; with a FILE.toml on yours
      tacbench check-runs runs              examine what was recorded
      tacbench simulate --study quick --out study  a whole simulated study
      tacbench report study -o report.html  what the data say, on one page
      tacbench doctor                       what is installed, and how to repair it
    """


tacbench.help = help_of(tacbench.callback.__doc__)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments without the program's name; None for those of this process.

    Returns:
        The exit code: 0 done, 1 a check failed, 2 bad input or a missing tool, 3 a run stopped safely, 130 interrupted.
    """
    # Our matrix products are small: threads only get in each other's way. A user's own value stays.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    words = list(sys.argv[1:] if argv is None else argv)
    try:
        with tacbench.make_context("tacbench", words[:] or ["--help"]) as root:
            tacbench.invoke(root)
        return 0
    except Exit as end:
        return end.exit_code
    except TacbenchError as error:
        note(f"error: {one_line(error)}")
        if error.exit_code == SAFELY_STOPPED:
            _say_how_to_resume(words)
        return error.exit_code
    except ClickException as error:
        context = error.ctx if isinstance(error, UsageError) else None
        where = "" if context is None else f" (see {context.command_path} --help)"
        note(f"error: {one_line(error.format_message())}{where}")
        return 2
    except KeyboardInterrupt as stop:
        note("; ".join(["error: interrupted", *filter(None, [str(stop)])]))
        _say_how_to_resume(words)
        return 130
    except BrokenPipeError:  # nobody reads on: what is still to be flushed has nowhere to go
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:
        reason = why_not_imported(error) if isinstance(error, ModuleNotFoundError) else None
        if reason is not None:
            note(f"error: {reason}")
            return MissingToolError.exit_code
        from tacbench_cad.cli.unexpected import report_unexpected

        return report_unexpected(error, words)


def _say_how_to_resume(words: Sequence[str]) -> None:
    if words[0] in RESUMABLE:
        note(f"resume with: {shlex.join(['tacbench', *words])}")
