"""What the commands share: reading option values, tables, JSON."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal

import typer

from tacbench_cad.errors import InputError, nearest

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from tacbench_cad.block import SampleGrid, Tolerance

#: Options whose value may be left out, and what that means.
DEFAULT_VALUES = {"--grid": "default", "--key": "default"}
#: Width of a table that is not printed on a terminal.
PLAIN_WIDTH = 160


def with_default_values(argv: Sequence[str]) -> list[str]:
    """Give ``--grid`` and ``--key`` a value where none follows: Typer has no options with an optional value.

    A word that follows is the value unless it is an option itself; a negative number is a value (a wrong one, which
    is then refused by name).

    Args:
        argv: The arguments as typed.

    Returns:
        The arguments with ``--grid=default`` in place of a bare ``--grid``.
    """
    words: list[str] = []
    for i, word in enumerate(argv):
        following = argv[i + 1] if i + 1 < len(argv) else "-"
        bare = re.match(r"-(?![\d.])", following) is not None
        words.append(f"{word}={DEFAULT_VALUES[word]}" if word in DEFAULT_VALUES and bare else word)
    return words


def one_line(message: str) -> str:
    """The message without line breaks."""
    return " ".join(message.split())


def words_of(text: str | None) -> tuple[str, ...] | None:
    """The words of a list with commas; None stays None."""
    return None if text is None else tuple(word.strip() for word in text.split(",") if word.strip())


def numbers_of(option: str, text: str | None, names: str) -> tuple[float, ...] | None:
    """The numbers of a list with commas; None stays None.

    Args:
        option: For the error.
        text: What was typed.
        names: What the numbers are, with commas: ``X,Y``.

    Raises:
        InputError: There are more or fewer of them, or one is no number.
    """
    if text is None:
        return None
    parts = text.split(",")
    try:
        numbers = tuple(float(part) for part in parts)
    except ValueError:
        numbers = ()
    if len(numbers) != names.count(",") + 1:
        raise InputError(option, text, f"must be {names}, numbers with commas between them")
    return numbers


def pair_of(option: str, text: str | None, names: str) -> tuple[float, float] | None:
    """Two numbers with a comma between them; None stays None."""
    numbers = numbers_of(option, text, names)
    return None if numbers is None else (numbers[0], numbers[1])


def triple_of(option: str, text: str | None, names: str) -> tuple[float, float, float] | None:
    """Three numbers with commas between them; None stays None."""
    numbers = numbers_of(option, text, names)
    return None if numbers is None else (numbers[0], numbers[1], numbers[2])


def sampling_of(tolerance: float | None, grid: str | None) -> Tolerance | SampleGrid | Literal["grid"] | None:
    """What ``--tolerance`` and ``--grid`` ask for.

    Raises:
        InputError: Both are given, or one of them is not allowed.
    """
    from tacbench_cad.block import SampleGrid, Tolerance

    if tolerance is not None and grid is not None:
        raise InputError("grid", grid, "a mesh follows either --grid or --tolerance, not both")
    if tolerance is not None:
        return Tolerance(mm=tolerance)
    if grid is None:
        return None
    if grid == "default":
        return "grid"
    counts = re.fullmatch(r"(\d{1,9})x(\d{1,9})", grid)
    if counts is None:
        raise InputError("grid", grid, "must be NXxNY, as 189x201, or nothing for the preset's own grid")
    return SampleGrid(nx=int(counts[1]), ny=int(counts[2]))


def key_of(text: str | None) -> float | None:
    """What ``--key`` asks for, in mm.

    Raises:
        InputError: It is no number.
    """
    from tacbench_cad.block import KEY_MM

    if text is None:
        return None
    if text == "default":
        return KEY_MM
    try:
        return float(text)
    except ValueError:
        raise InputError("key", text, "must be a number of mm, or nothing for 3 mm") from None


def one_of(option: str, word: str, allowed: Sequence[str]) -> str:
    """The word, if it is allowed.

    Raises:
        InputError: It is not; the message names the nearest one.
    """
    if word not in allowed:
        raise InputError(option, word, nearest(word, allowed))
    return word


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON document on the standard output."""
    typer.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def note(message: str) -> None:
    """Say something beside the result, on the standard error."""
    typer.echo(message, err=True)


def console() -> Console:
    """Where tables go: the standard output, wide enough to be searched when it is not a terminal."""
    from rich.console import Console

    if sys.stdout.isatty():
        return Console(highlight=False)
    return Console(highlight=False, width=PLAIN_WIDTH)


def table(title: str, *columns: str, right: Sequence[str] = ()) -> Table:
    """An empty table.

    Args:
        title: Its title.
        columns: Heads of the columns.
        right: Those columns that are set flush right.
    """
    from rich import box
    from rich.table import Table

    made = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for head in columns:
        made.add_column(head, justify="right" if head in right else "left", overflow="fold")
    return made


def lengths(values: Sequence[float]) -> str:
    """Lengths for people: ``23.3 x 30 x 7``."""
    return " x ".join(f"{value:.6g}" for value in values)
