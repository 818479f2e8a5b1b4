"""What the commands share: reading option values, tables, JSON."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from tacbench_cad.util.errors import InputError, one_of

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from tacbench_cad.lab.analysis.tables import Table as ResultTable
    from tacbench_cad.spec.sampling import SampleGrid, Tolerance

T = TypeVar("T")

#: The options of commands that share their work out among processes.
Jobs = Annotated[str | None, typer.Option(metavar="N", help="Processes. Default: one for each processor.")]
Dask = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Use a Dask cluster that is there: tcp://10.0.0.5:8786.")
]

#: Options whose value may be left out, and what that means.
DEFAULT_VALUES = {"--grid": "default", "--key": "default", "--drawing": "block"}
#: Width of a table that is not printed on a terminal.
PLAIN_WIDTH = 160


def with_default_values(argv: Sequence[str]) -> list[str]:
    """Give ``--grid``, ``--key`` and ``--drawing`` a value where none follows: Typer has no optional values.

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


def number_of(option: str, text: str) -> float:
    """The number that was typed. Options are read here and not by Typer, whose errors leave out the value.

    Raises:
        InputError: It is no number.
    """
    try:
        return float(text)
    except ValueError:
        raise InputError(option, text, "must be a number") from None


def whole_of(option: str, text: str) -> int:
    """The whole number that was typed.

    Raises:
        InputError: It is no whole number.
    """
    try:
        return int(text)
    except ValueError:
        raise InputError(option, text, "must be a whole number") from None


def given(read: Callable[[str, str], T], option: str, text: str | None) -> T | None:
    """What an option says, or None where it was not given."""
    return None if text is None else read(option, text)


def pair_of(option: str, text: str) -> tuple[float, float]:
    """Two numbers with a comma between them.

    Raises:
        InputError: There are more or fewer, or one is no number.
    """
    x, y = _numbers(option, text, "X,Y")
    return (x, y)


def triple_of(option: str, text: str) -> tuple[float, float, float]:
    """Three numbers with commas between them.

    Raises:
        InputError: There are more or fewer, or one is no number.
    """
    x, y, z = _numbers(option, text, "X,Y,Z")
    return (x, y, z)


def _numbers(option: str, text: str, names: str) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != names.count(",") + 1:
        raise InputError(option, text, f"must be {names}, numbers with commas between them")
    return numbers


def sampling_of(tolerance: str | None, grid: str | None) -> Tolerance | SampleGrid | Literal["grid"] | None:
    """What ``--tolerance`` and ``--grid`` ask for.

    Raises:
        InputError: Both are given, or one of them is not allowed.
    """
    from tacbench_cad.spec.sampling import SampleGrid, Tolerance

    if tolerance is not None and grid is not None:
        raise InputError("grid", grid, "a mesh follows either --grid or --tolerance, not both")
    distance = given(number_of, "tolerance", tolerance)
    if distance is not None:
        return Tolerance(mm=distance)
    if grid is None:
        return None
    if grid == "default":
        return "grid"
    counts = re.fullmatch(r"(\d{1,9})x(\d{1,9})", grid)
    if counts is None:
        raise InputError("grid", grid, "must be NXxNY, as 189x201, or nothing for the preset's own grid")
    return SampleGrid(nx=int(counts[1]), ny=int(counts[2]))


def jobs_of(text: str | None) -> int:
    """How many processes ``--jobs`` asks for: one for each processor where it was not given.

    Raises:
        InputError: It is no whole number, or below 1.
    """
    from tacbench_cad.util.processes import cpu_count

    count = cpu_count() if text is None else whole_of("jobs", text)
    if count < 1:
        raise InputError("jobs", count, "must be 1 or more")
    return count


def key_of(option: str, text: str) -> float:
    """What ``--key`` asks for, in mm.

    Raises:
        InputError: It is no number.
    """
    from tacbench_cad.spec.block import KEY_MM

    return KEY_MM if text == "default" else number_of(option, text)


def part_options(
    *,
    size: str | None = None,
    height: str | None = None,
    mm_per_unit: str | None = None,
    tolerance: str | None = None,
    grid: str | None = None,
    key: str | None = None,
    label: bool = False,
    fit: str | None = None,
    rim: str | None = None,
    slots: str | None = None,
    nozzle: str | None = None,
    jig: str | None = None,
) -> dict[str, Any]:
    """What the options that describe parts mean: keywords of a ``Request``, those left out that were not given.

    Raises:
        InputError: A value is not allowed.
    """
    read = {
        "size_mm": given(pair_of, "size", size),
        "height_mm": given(number_of, "height", height),
        "mm_per_unit": given(triple_of, "mm per unit", mm_per_unit),
        "sampling": sampling_of(tolerance, grid),
        "key_mm": given(key_of, "key", key),
        "label": label or None,
        "fit": fit,
        "rim_mm": given(number_of, "rim", rim),
        "slots": given(whole_of, "slots", slots),
        "nozzle_mm": given(number_of, "nozzle", nozzle),
        "jig": None if jig is None else one_of("jig", jig, ("default", "all")),
    }
    return {name: value for name, value in read.items() if value is not None}


def print_json(document: dict[str, Any]) -> None:
    """Print one JSON document on the standard output."""
    typer.echo(json.dumps(document, indent=2, allow_nan=False))


def note(message: str) -> None:
    """Say something beside the result, on the standard error."""
    typer.echo(message, err=True)


def console() -> Console:
    """Where tables go: the standard output, wide enough to be searched when it is not a terminal."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else PLAIN_WIDTH
    # What is printed comes from files and formulas: its brackets and colons are its own.
    return Console(width=width, highlight=False, markup=False, emoji=False)


def simulated_devices(simulated: Sequence[str]) -> list[str]:
    """Which of stage, gauge and sensor were simulated, each once, without what ``run.json`` says of them."""
    return list(dict.fromkeys(one.partition(":")[0] for one in simulated))


def print_simulated(screen: Console, simulated: Sequence[str]) -> None:
    """Say in one line what of the data was simulated, if anything was.

    Args:
        screen: Where.
        simulated: What of each run was: ``("sensor: simulated TacTip, ...", ...)``.
    """
    if simulated:
        screen.print(f"simulated: {', '.join(simulated_devices(simulated))} (see run.json)", soft_wrap=True)


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


def show_table(shown: ResultTable) -> None:
    """Print a table of results with its title."""
    heads = list(zip(shown.heads, shown.right, strict=True))
    # Two columns may have one head, so the heads that are set flush right are marked.
    made = table(shown.title)
    for head, right in heads:
        made.add_column(head, justify="right" if right else "left", overflow="fold")
    for row in shown.texts():
        made.add_row(*row)
    console().print(made)


def lengths(values: Sequence[float]) -> str:
    """Lengths for people: ``23.3 x 30 x 7``."""
    return " x ".join(f"{value:.6g}" for value in values)
