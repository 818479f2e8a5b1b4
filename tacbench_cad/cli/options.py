"""What is typed on the command line: types of values, and the options that several commands have in common."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from functools import reduce
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import rich_click as click

from tacbench_cad.util.errors import InputError, one_of

F = TypeVar("F", bound=Callable[..., Any])


class Decorator(Protocol):
    """What adds an option to the function behind a command."""

    def __call__(self, function: F, /) -> F:
        """The function, with the option."""
        ...


# The groups of options in the help.
WHAT, SIZE, MESH, FIXTURES, WORK, OUTPUT = "What", "Size", "How exact", "Fixtures", "Processes", "Output"
_PANELS = ("Arguments", "Options", WHAT, SIZE, MESH, FIXTURES, WORK, OUTPUT)


#: Commands that have another name now.
RENAMED = {
    "check": "check-part",
    "slice-check": "check-gcode",
    "runs check": "check-runs",
    "export": "export-simulator",
    "runs export": "export-runs",
    "import": "import-frames",
}


def refuse_old_name(ctx: click.Context, name: str) -> None:
    """Name the new name of a command to whoever types its old name.

    Args:
        ctx: The context of the group in which the command is looked up.
        name: What was typed.

    Raises:
        ClickException: The command has another name now.
    """
    typed = " ".join([*ctx.command_path.split()[1:], name])
    if typed in RENAMED:
        raise click.ClickException(f'the command "{typed}" is now "{RENAMED[typed]}"')


class Value(click.ParamType):  # type: ignore[type-arg]
    """A type of values.

    Args:
        metavar: How the help writes such a value.
        read: Gives the value of a text. It gets the option's name as well, for the :class:`InputError` that it raises.
    """

    def __init__(self, metavar: str, read: Callable[[str, str], Any]) -> None:
        self.name = metavar
        self.read = read

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """How the help writes such a value."""
        return self.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The value of a text; defaults that are values stay as they are."""
        if not isinstance(value, str) or param is None:
            return value
        return self.read(max(param.opts, key=len).lstrip("-").replace("-", " "), value)


def number_of(option: str, text: str) -> float:
    """A number."""
    try:
        return float(text)
    except ValueError:
        raise InputError(option, text, "must be a number") from None


def whole_of(option: str, text: str) -> int:
    """A whole number."""
    try:
        return int(text)
    except ValueError:
        raise InputError(option, text, "must be a whole number") from None


def words_of(_: str, text: str) -> tuple[str, ...]:
    """Words with commas between them."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def numbers_of(option: str, text: str) -> tuple[float, ...]:
    """Numbers with commas between them."""
    return tuple(number_of(option, word) for word in words_of(option, text))


def file(metavar: str) -> Value:
    """A path."""
    return Value(metavar, lambda _, text: Path(text))


def text(metavar: str) -> Value:
    """Words that the command itself understands."""
    return Value(metavar, lambda _, text: text)


def words(metavar: str) -> Value:
    """Words with commas between them."""
    return Value(metavar, words_of)


def choice(*words: str) -> Value:
    """One of some words."""
    return Value("|".join(words), lambda option, text: one_of(option, text, words))


def or_word(word: str, kind: Value, metavar: str) -> Value:
    """A word that stays as it is, or a value of another type."""
    return Value(metavar, lambda option, text: word if text == word else kind.read(option, text))


def or_none(kind: Value) -> Value:
    """The word none, or a value of another type."""
    return or_word("none", kind, f"{kind.name}|none")


def coordinates(names: str) -> Value:
    """As many numbers as there are names, with commas between them."""

    def read(option: str, text: str) -> tuple[float, ...]:
        try:
            numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != names.count(",") + 1:
            raise InputError(option, text, f"must be {names}, numbers with commas between them")
        return numbers

    return Value(names, read)


def _grid_of(option: str, text: str) -> Any:
    from tacbench_cad.spec.sampling import SampleGrid

    if text == "default":
        return "grid"
    counts = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text)
    if counts is None:
        raise InputError(option, text, "must be NXxNY, as 189x201, or nothing for the preset's own grid")
    return SampleGrid(nx=int(counts[1]), ny=int(counts[2]))


def _tolerance_of(option: str, text: str) -> Any:
    from tacbench_cad.spec.sampling import Tolerance

    return Tolerance(mm=number_of(option, text))


def _key_of(option: str, text: str) -> float:
    from tacbench_cad.spec.block import KEY_MM

    return KEY_MM if text == "default" else number_of(option, text)


def _jobs_of(option: str, text: str) -> int:
    count = whole_of(option, text)
    if count < 1:
        raise InputError(option, count, "must be 1 or more")
    return count


def _every_processor() -> int:
    from tacbench_cad.util.processes import cpu_count

    return cpu_count()


COUNT = Value("N", whole_of)
NAMES = words("NAME,...")
NUMBER = Value("N", number_of)
MM = Value("MM", number_of)
SCALE = Value("S", number_of)
PRESET = choice("paper", "released")
LEVEL = or_word("all", COUNT, "all|N")
JOBS = Value("N", _jobs_of)


def option(
    name: str,
    kind: Value,
    help: str,
    *,
    dest: str | None = None,
    short: str | None = None,
    alone: str | None = None,
    show_default: bool | str = True,
    **attributes: Any,
) -> Decorator:
    """An option with a value.

    Args:
        name: How it is typed.
        kind: Type of the value.
        help: What it does.
        dest: The argument of the command that takes the value; None for the name's own.
        short: Another name, of one letter.
        alone: The text that it stands for where no value follows; None if one must.
        show_default: See :func:`click.option`.
        attributes: Likewise.
    """
    names = (name, *(word for word in (short, dest) if word is not None))
    if alone is not None:
        attributes |= {"is_flag": False, "flag_value": alone}
    return click.option(*names, type=kind, help=help, show_default=show_default, **attributes)


def flag(name: str, help: str, panel: str | None = None) -> Decorator:
    """An option without a value."""
    return click.option(name, is_flag=True, help=help, panel=panel)


def argument(name: str, kind: Value, help: str, *, many: bool = False, required: bool = True) -> Decorator:
    """A word that is no option, or as many of them as there are."""
    return click.argument(name, type=kind, help=help, nargs=-1 if many else 1, required=required)


def together(*decorators: Decorator) -> Decorator:
    """Several decorators as one."""

    def decorate(function: F, /) -> F:
        return reduce(lambda inner, decorator: decorator(inner), reversed(decorators), function)

    return decorate


def command(name: str, group: click.RichGroup | None = None) -> Callable[[Callable[..., None]], click.RichCommand]:
    """Make a command of a function, with the function's docstring as its help."""

    def decorate(function: Callable[..., None]) -> click.RichCommand:
        panels = [click.RichOptionPanel(title) for title in _PANELS]
        built = click.command(name, help=help_of(function.__doc__), panels=panels)(function)
        if group is not None:
            group.add_command(built)
        return built

    return decorate


class _Group(click.RichGroup):
    """Commands in the order in which they are written."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        refuse_old_name(ctx, cmd_name)
        return super().get_command(ctx, cmd_name)


def group(name: str) -> Callable[[Callable[..., None]], click.RichGroup]:
    """Make a group of commands of a function, likewise."""
    return lambda function: click.group(name, cls=_Group, no_args_is_help=False, help=help_of(function.__doc__))(
        function
    )


def help_of(docstring: str | None) -> str:
    """A docstring as a help text, in which the lines of the examples stay as they are."""
    return inspect.cleandoc(docstring or "").replace("\n\nExamples:\n", "\n\n\b\nExamples:\n")


json = flag("--json", "Print one JSON document.", panel=OUTPUT)
preset = option("--preset", PRESET, "Geometry to begin from.", default="paper", panel=WHAT)
scale = option("--scale", SCALE, "Multiply sides, height, mm per unit, press grid.", default="1", panel=SIZE)
textures = option(
    "--texture",
    words("1,4|FILE.toml|all"),
    "Textures, with commas between them.",
    dest="textures",
    default="all",
    panel=WHAT,
)
key = option(
    "--key",
    Value("[MM]", _key_of),
    "Cut the corner at (X, 0), 3 mm if no number follows.",
    dest="key_mm",
    alone="default",
    panel=WHAT,
)
jobs = option("--jobs", JOBS, "Processes.", default=_every_processor, show_default="one for each processor", panel=WORK)
dask = option("--dask", text("ADDRESS"), "Use a Dask cluster that is there: tcp://10.0.0.5:8786.", panel=WORK)
roi = option(
    "--roi",
    text("REGION"),
    "Region of interest: auto, circle:X,Y,R, rect:X0,Y0,X1,Y1 (pixels), a PNG file, white where the sensor is, "
    "or none. Default: what `tacbench runs roi` kept with the runs.",
)
marker_settings = together(
    option("--marker-sigma", NUMBER, "Width of a marker divided by 2.8, in pixels. Default: from the frames."),
    option("--marker-threshold", NUMBER, "The least contrast of a marker, in counts. Default: from the frames."),
)
#: What is taken of each frame.
look = together(
    option("--features", choice("pixels", "markers"), "The pixels, or how far the markers moved.", default="pixels"),
    roi,
    marker_settings,
)
runs = argument("runs", file("RUNS"), "Run folders, or folders that hold some.", many=True)

#: The options that describe a block and its fixtures, by the names of the fields of a ``Request``.
part = together(
    preset,
    flag("--label", "Engrave texture, preset and scale in the underside.", panel=WHAT),
    key,
    scale,
    option("--size", coordinates("X,Y"), "Sides in mm: more or fewer periods.", dest="size_mm", panel=SIZE),
    option("--height", MM, "Height of the highest point: another base.", dest="height_mm", panel=SIZE),
    option("--mm-per-unit", coordinates("X,Y,Z"), "Mapping of the formula to mm.", panel=SIZE),
    option(
        "--tolerance", Value("MM", _tolerance_of), "Distance of meshes from the formula. Default: 0.01.", panel=MESH
    ),
    option(
        "--grid",
        Value("[NXxNY]", _grid_of),
        "Join samples instead, the preset's if no size follows.",
        alone="default",
        panel=MESH,
    ),
    option("--fit", text("press|slip|loose|MM"), "Clearance of pockets, per side.", panel=FIXTURES),
    option("--rim", MM, "Holder's rim below the block's top.", dest="rim_mm", panel=FIXTURES),
    option("--slots", COUNT, "Pockets of the holder.", panel=FIXTURES),
    option("--nozzle", MM, "Nozzle that fixtures are for. Default: 0.4.", dest="nozzle_mm", panel=FIXTURES),
    option("--jig", choice("default", "all"), "all: 25 holes, for a resin printer.", panel=FIXTURES),
)


def out(metavar: str, help: str, **attributes: Any) -> Decorator:
    """Where the result goes."""
    return option("--out", file(metavar), help, short="-o", panel=OUTPUT, **attributes)


def request_fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords of a ``Request``: what was given of the options that are named by its fields.

    Raises:
        InputError: Both ``--grid`` and ``--tolerance`` are given.
    """
    given = {name: value for name, value in values.items() if value is not None and value is not False}
    tolerance, grid = given.pop("tolerance", None), given.pop("grid", None)
    if tolerance is not None and grid is not None:
        shown = grid if grid == "grid" else f"{grid.nx}x{grid.ny}"
        raise InputError("grid", shown, "a mesh follows either --grid or --tolerance, not both")
    sampling: Literal["grid"] | Any = tolerance or grid
    return given if sampling is None else {**given, "sampling": sampling}
