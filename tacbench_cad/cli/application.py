"""The group of all commands, and the exit codes and messages of a call."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import rich_click as click
from click.exceptions import ClickException, Exit, NoSuchCommand, UsageError

from tacbench_cad import __version__
from tacbench_cad.cli.common import note, say_how_to_resume, say_interrupted
from tacbench_cad.cli.completing import VARIABLE
from tacbench_cad.cli.options import GENERAL, help_of
from tacbench_cad.util.entries import entries, load
from tacbench_cad.util.errors import MissingToolError, TacbenchError, one_line
from tacbench_cad.util.output import drop
from tacbench_cad.util.packages import why_not_imported

#: The headings of the commands. Each command names its own.
PANELS = ("Print", "Press", "Analyse", "Share", "Help")
#: The commands of the core, in the order in which people use them. Extensions and other packages add theirs by entry
#: points.
CORE = (
    *("textures", "make", "show", "check-part"),
    *("rig", "acquire", "simulate", "import-frames", "check-runs", "roi"),
    *("variance", "grade", "classify", "split", "score", "compare", "report"),
    *("cite", "doctor", "completion"),
)
#: The group of entry points of other commands.
_ADDED = "tacbench.commands"
#: Exit code of a run that was stopped safely.
SAFELY_STOPPED = 3


class _Commands(click.RichGroup):
    """The commands. Each is imported when it is used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(CORE) + [name for name in entries(_ADDED) if name not in CORE]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        added = entries(_ADDED)
        if cmd_name not in CORE and cmd_name not in added:
            raise NoSuchCommand(cmd_name, possibilities=self.list_commands(ctx), ctx=ctx)
        if cmd_name in CORE:
            command: click.Command = importlib.import_module(f"{__package__}.{cmd_name.replace('-', '_')}").command
            return command
        try:
            command = load(added[cmd_name])
        except MissingToolError:
            return None  # a list of the commands leaves it out
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        if args[0] not in CORE and args[0] in entries(_ADDED):
            load(entries(_ADDED)[args[0]])  # says which module is missing
        return super().resolve_command(ctx, args)


@click.command(
    "tacbench",
    cls=_Commands,
    panels=[click.RichCommandPanel(title) for title in PANELS],
    context_settings={
        "help_option_names": ["-h", "--help"],
        "rich_help_config": {
            "text_paragraph_linebreaks": "\n\n",
            "padding_helptext_first_line": (0, 0, 1, 0),
            "max_width": 100,
            "options_panel_title": GENERAL,
            "commands_before_options": True,
            "options_table_column_types": ["opt_all_metavar", "help"],
            "options_table_help_sections": ["help", "required", "default"],
            "append_metavars_help_string": "{}",
            "delimiter_comma": ", ",
            "default_string": "Default: {}.",
            "required_long_string": "Required.",
            "style_required_long": "default",
        },
    },
)
@click.version_option(__version__, message="tacbench %(version)s", help="Print the version and exit.")
def tacbench() -> None:
    """Make tactile texture blocks, press them, and analyse the recorded frames.

    Each command explains itself: tacbench COMMAND --help.

    Exit codes: 0 done, 1 a check failed, 2 wrong input or a missing file or package, 3 a device failed and the run was
    stopped safely, 130 interrupted.

    Examples:
      tacbench make                                # blocks, holder and jig
      tacbench plate --printer ender-3 --copies 6  # arrange them for printing
      tacbench acquire --virtual --out runs        # press on a simulated rig
      tacbench simulate --out runs                 # or simulate a small study
      tacbench check-runs runs                     # check the recorded runs
      tacbench variance runs                       # how much do prints vary?
      tacbench classify runs                       # distinguish the textures
      tacbench report runs                         # everything on one page
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
        if VARIABLE in os.environ:
            return _complete(os.environ[VARIABLE])
        with tacbench.make_context("tacbench", words[:] or ["--help"]) as root:
            tacbench.invoke(root)
        return 0
    except Exit as end:
        return end.exit_code
    except TacbenchError as error:
        note(f"error: {one_line(error)}")
        for line in getattr(error, "__notes__", ()):
            note(line)
        if error.exit_code == SAFELY_STOPPED:
            say_how_to_resume(words)
        return error.exit_code
    except ClickException as error:
        context = error.ctx if isinstance(error, UsageError) else None
        where = "" if context is None else f" (see {context.command_path} --help)"
        note(f"error: {one_line(error.format_message())}{where}")
        return 2
    except KeyboardInterrupt as stop:
        say_interrupted(stop, words)
        return 130
    except BrokenPipeError:  # nobody reads on: what is still to be flushed has nowhere to go
        drop(sys.stdout)
        return 1
    except Exception as error:
        reason = why_not_imported(error) if isinstance(error, ModuleNotFoundError) else None
        if reason is not None:
            note(f"error: {reason}")
            return MissingToolError.exit_code
        from tacbench_cad.cli.unexpected import report_unexpected

        report_unexpected(error, words)
        return 1


def _complete(instruction: str) -> int:
    """Print the completions that a shell asks for."""
    from click.shell_completion import shell_complete

    try:
        return shell_complete(tacbench, {}, "tacbench", VARIABLE, instruction)
    except ClickException:  # an unknown command: nothing completes it
        return 1
