"""What the commands share to show results: tables, JSON, notes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click
from click.exceptions import Exit

from tacbench_cad.util.errors import InputError, MissingToolError, TacbenchError, one_line

if TYPE_CHECKING:
    from rich.console import Console

    from tacbench_cad.checks.report import Report
    from tacbench_cad.lab.analysis.tables import Table as ResultTable
    from tacbench_cad.lab.runs.checking import RunReport

#: Width of a table that is not printed on a terminal.
PLAIN_WIDTH = 160


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON document on the standard output."""
    click.echo(json.dumps(document, indent=2, allow_nan=False))


def note(message: str) -> None:
    """Say something beside the result, on the standard error."""
    click.echo(message, err=True)


def console() -> Console:
    """Where tables go: the standard output, wide enough to be searched when it is not a terminal."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else PLAIN_WIDTH
    # What is printed comes from files and formulas: its brackets and colons are its own.
    return Console(width=width, highlight=False, markup=False, emoji=False)


def print_lines(*lines: str) -> None:
    """Print lines on the standard output that are not broken."""
    screen = console()
    for line in lines:
        screen.print(line, soft_wrap=True)


def simulated_devices(simulated: Sequence[str]) -> list[str]:
    """Which of stage, gauge and sensor were simulated, each once, without what ``run.json`` says of them."""
    return list(dict.fromkeys(device.partition(":")[0] for device in simulated))


def print_simulated(simulated: Sequence[str]) -> None:
    """Say in one line what of the data was simulated, if anything was.

    Args:
        simulated: What of each run was: ``("sensor: simulated TacTip, ...", ...)``.
    """
    if simulated:
        print_lines(f"simulated: {', '.join(simulated_devices(simulated))} (see run.json)")


def print_table(title: str, heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table.

    Args:
        title: Its title.
        heads: Heads of the columns; those of columns that are set flush right begin with ``>``.
        rows: The cells.
    """
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for head in heads:
        table.add_column(head.removeprefix(">"), justify="right" if head[:1] == ">" else "left", overflow="fold")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    console().print(table)


def ask_line(prompt: str, *, err: bool = False) -> str:
    """The next line of the standard input, a terminal's or a script's. A script's line is shown behind the prompt.

    Args:
        prompt: What is asked.
        err: Show it on the standard error.

    Raises:
        InputError: The input has ended.
    """
    click.echo(prompt, nl=False, err=err)
    try:
        line = input()
    except EOFError:
        click.echo(err=err)
        raise InputError("standard input", None, f"ended before the answer to: {prompt.strip()}") from None
    if not sys.stdin.isatty():
        click.echo(line, err=err)
    return line.strip()


def show_table(table: ResultTable) -> None:
    """Print a table of results."""
    heads = [f">{head}" if right else head for head, right in zip(table.heads, table.right, strict=True)]
    print_table(table.title, heads, table.texts())


def write_picture(path: Path, draw: Callable[[Path], object], *, required: bool = False) -> bool:
    """Write a picture, or say that it cannot be drawn here.

    Args:
        path: Where it goes.
        draw: Writes it.
        required: Refuse the command where it cannot be drawn.

    Returns:
        Whether it is written.
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
    """End a command that examined several things: say which were refused.

    Raises:
        Exit: One of them has a fault (exit code 1), or was refused.
    """
    for refusal in refusals:
        note(f"error: {one_line(refusal)}")
    if any(not report.ok for report in reports):
        raise Exit(1)
    if refusals:
        raise Exit(max(refusal.exit_code for refusal in refusals))
