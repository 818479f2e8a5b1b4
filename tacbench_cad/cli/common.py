"""Output that the commands share: tables, JSON, messages, the next command."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.util.errors import InputError, MissingToolError, TacbenchError, one_line
from tacbench_cad.util.output import droppable

if TYPE_CHECKING:
    from rich.console import Console

    from tacbench_cad.checks.report import Report
    from tacbench_cad.lab.analysis.tables import Shown
    from tacbench_cad.lab.runs.checking import RunReport

#: The next command names at most so many paths one by one; for more it has a word in capitals.
MAX_PATHS = 4
#: The commands that resume their work when they are typed again after an interruption.
RESUMABLE = ("acquire", "simulate", "import-frames", "classify", "report")
#: Width of a table that is not printed on a terminal, in characters.
PLAIN_WIDTH = 160
#: The longest word in a cell of a table that is never broken, in characters. Paths can be longer.
LONGEST_WORD = 40
#: What is added to the title of a part of a table, after the first part.
CONTINUED = " (continued)"
#: The number of characters between two columns. One less is beside the outer columns.
_BETWEEN = 3


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON document on the standard output."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def note(message: str) -> None:
    """Print a message on the standard error. It is dropped if nobody can read it any more."""
    with droppable(sys.stderr):
        click.echo(message, err=True)


def say_interrupted(stop: BaseException, words: Sequence[str]) -> None:
    """Print that a command was interrupted, and how it is resumed.

    Args:
        stop: The interruption.
        words: The words of the command, without the program's name.
    """
    note("; ".join(["error: interrupted", *filter(None, [str(stop)]), *getattr(stop, "__notes__", ())]))
    say_how_to_resume(words)


def say_how_to_resume(words: Sequence[str]) -> None:
    """Print the command that resumes the work, if there is one."""
    if words[0] in RESUMABLE:
        note(f"resume with: {shlex.join(['tacbench', *words])}")


def console() -> Console:
    """The standard output for tables. If it is not a terminal, it is wide, so that a table can be searched."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else PLAIN_WIDTH
    # Brackets and colons in files and formulas are not markup.
    return Console(width=width, highlight=False, markup=False, emoji=False)


def print_lines(*lines: str) -> None:
    """Print lines on the standard output without wrapping them."""
    screen = console()
    for line in lines:
        screen.print(line, soft_wrap=True)


def print_next(*words: object, err: bool = False) -> None:
    """Print the next command to type, as the last line of a command's output.

    A word in capitals, such as NAME or FILE.gcode, is a value that only the user knows. Commands that print JSON, and
    commands that end a chain of work, print no such line.

    Args:
        words: The words of the command, without the program's name.
        err: Print it on the standard error, where the rest of the command's output is.
    """
    line = f"Next: {shlex.join(['tacbench', *map(str, words)])}"
    if err:
        note(line)
    else:
        print_lines(line)


def next_paths(paths: Sequence[Path], metavar: str = "RUNS") -> list[str]:
    """The user's paths as words of the next command; ``metavar`` if there are too many for one line."""
    return [str(path) for path in paths] if len(paths) <= MAX_PATHS else [metavar]


def next_block(textures: Sequence[str], preset: str, scale: float, key_mm: float | None = None) -> list[str]:
    """The options that choose blocks as words of the next command, without those that have their default."""
    words = [] if tuple(textures) == ("all",) else ["--texture", ",".join(textures)]
    words += [] if preset == "paper" else ["--preset", preset]
    words += [] if scale == 1.0 else ["--scale", f"{scale:g}"]
    return words if key_mm is None else [*words, "--key", f"{key_mm:g}"]


def simulated_devices(simulated: Sequence[str]) -> list[str]:
    """The simulated devices of stage, gauge and sensor, each once and without their descriptions."""
    return list(dict.fromkeys(device.partition(":")[0] for device in simulated))


def print_simulated(simulated: Sequence[str]) -> None:
    """Print in one line which devices were simulated, if any were.

    Args:
        simulated: The simulated devices of all runs: ``("sensor: simulated TacTip, ...", ...)``.
    """
    if simulated:
        print_lines(f"simulated: {', '.join(simulated_devices(simulated))} (see run.json)")


def print_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table. A table that is too wide is printed in parts, which all begin with the first columns.

    Args:
        title: Its title.
        heads: Heads of the columns. A head that begins with ``>`` aligns its column to the right.
        rows: The cells.
    """
    from rich import box
    from rich.table import Table

    screen, texts = console(), [[str(cell) for cell in row] for row in rows]
    columns = [[head.removeprefix(">"), *(row[i] for row in texts)] for i, head in enumerate(heads)]
    for part in _parts(heads, columns, screen.width):
        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        widths = _widths([columns[i] for i in part], screen.width)
        for i, width in zip(part, widths, strict=True):
            justify: Literal["right", "left"] = "right" if heads[i][:1] == ">" else "left"
            table.add_column(columns[i][0], justify=justify, overflow="fold", width=width)
        for row in texts:
            table.add_row(*(row[i] for i in part))
        screen.print(table)
        title = f"{title.removesuffix(CONTINUED)}{CONTINUED}"


def _parts(heads: Sequence[str], columns: Sequence[Sequence[str]], width: int) -> list[list[int]]:
    """Divide the columns of a table into parts in which no word has to be broken.

    Each part begins with the columns of texts before the first column of numbers.
    """
    named = next((i for i, head in enumerate(heads) if head[:1] == ">"), 0)
    needs = [_need(column) for column in columns]

    def fits(part: Sequence[int]) -> bool:
        return sum(needs[i] for i in part) + _BETWEEN * len(part) - 1 <= width

    first = list(range(named if 2 * sum(needs[:named]) < width else min(named, 1)))
    parts = [list(first)]
    for i in range(len(first), len(columns)):
        if not fits([*parts[-1], i]) and len(parts[-1]) > len(first):
            parts.append(list(first))
        parts[-1].append(i)
    return parts


def _widths(columns: Sequence[Sequence[str]], width: int) -> list[int]:
    """Return the widths of columns. If they do not fit, the widest is made narrower, but words are not broken."""
    from rich.cells import cell_len

    needs = [_need(column) for column in columns]
    widths = [max(cell_len(line) for text in column for line in text.split("\n")) for column in columns]
    while sum(widths) + _BETWEEN * len(widths) - 1 > width:
        wide = [i for i, need in enumerate(needs) if widths[i] > need]
        if not wide:
            break
        # The first column, which names the row, stays on one line as long as possible, unless it has long paths.
        others = wide[1:] if wide[0] == 0 and widths[0] <= LONGEST_WORD else wide
        widths[max(others or wide, key=lambda i: widths[i])] -= 1
    return widths


def _need(column: Sequence[str]) -> int:
    """Return the width of a column in which no word of its head is broken, and no word of its cells that is short."""
    from rich.cells import cell_len

    head, *cells = ([cell_len(word) for word in text.split()] for text in column)
    return max([1, *head, *(min(length, LONGEST_WORD) for cell in cells for length in cell)])


def ask_line(prompt: str, *, err: bool = False) -> str:
    """Ask the user for a line. If the standard input is a script, its line is shown after the prompt.

    Args:
        prompt: The question.
        err: Show the question on the standard error.

    Raises:
        InputError: The input has ended.
    """
    click.echo(prompt, nl=False, err=err)
    try:
        line = input()
    except EOFError:
        click.echo(err=err)
        raise InputError("standard input", None, f"ended before you answered: {prompt.strip()}") from None
    if not sys.stdin.isatty():
        click.echo(line, err=err)
    return line.strip()


def show_table(table: Shown) -> None:
    """Print a table of results."""
    heads = [f">{head}" if right else head for head, right in zip(table.heads, table.right, strict=True)]
    print_table(table.title, heads, table.texts)


def write_picture(path: Path, draw: Callable[[Path], object], *, required: bool = False) -> bool:
    """Write a picture, or print why it cannot be drawn.

    Args:
        path: The file.
        draw: Writes the picture to a path.
        required: Raise the error if the picture cannot be drawn.

    Returns:
        Whether the picture was written.
    """
    try:
        draw(path)
    except MissingToolError as error:
        if required:
            raise
        note(f"no picture: {error}")
        return False
    return True


def end_check(reports: Iterable[Report | RunReport], refusals: Sequence[TacbenchError]) -> None:
    """End a command that checked several files or runs: print which were refused.

    Raises:
        Exit: One has a fault (exit code 1) or was refused.
    """
    for refusal in refusals:
        note(f"error: {one_line(refusal)}")
    if any(not report.ok for report in reports):
        raise Exit(1)
    if refusals:
        raise Exit(max(refusal.exit_code for refusal in refusals))
