"""Types of values on the command line, and the options that several commands share."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from functools import reduce
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import rich_click as click

from tacbench_cad.cli.completing import (
    Completer,
    Items,
    nothing,
    of_features,
    of_files,
    of_folders,
    of_lists,
    of_run_folders,
    of_words,
)
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import decimal_hint

F = TypeVar("F", bound=Callable[..., Any])


class Decorator(Protocol):
    """A decorator that adds an option to the function of a command."""

    def __call__(self, function: F, /) -> F:
        """Return the function with the option."""
        ...


#: The panels of options in the help, in their order: the options that users need first come first.
PANELS = (
    *("Arguments", "Parts", "Size", "Printer", "Input", "Content"),
    *("Method", "Frames", "Picture", "Virtual rig", "Page", "Repair"),
    *("Output", "Fixtures", "Accuracy", "Processes", "Advanced", "General"),
)
ARGUMENTS, PARTS, SIZE, PRINTER, INPUT, CONTENT = PANELS[:6]
METHOD, FRAMES, PICTURE, VIRTUAL_RIG, PAGE, REPAIR = PANELS[6:12]
OUTPUT, FIXTURES, ACCURACY, PROCESSES, ADVANCED, GENERAL = PANELS[12:]
#: If the choices take more characters than this, they are listed in the text of the option, not after its name.
_MAX_CHOICES = 20


class Value(click.ParamType):  # type: ignore[type-arg]
    """A type of values.

    Args:
        metavar: The word for such a value in the help.
        read: Converts a text to the value. Its first argument is the name of the option, for error messages.
        complete: Returns the completions of an incomplete value.
    """

    def __init__(self, metavar: str, read: Callable[[str, str], Any], complete: Completer = nothing) -> None:
        self.name = metavar
        self.read = read
        self.complete = complete

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """The word for such a value in the help."""
        return self.name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Convert a text to the value. A default that is already a value is returned unchanged."""
        if not isinstance(value, str) or param is None:
            return value
        return self.read(max(param.opts, key=len).lstrip("-").replace("-", " "), value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> Items:
        """The completions of an incomplete value."""
        return self.complete(ctx, incomplete)


def number_of(option: str, text: str) -> float:
    """A number."""
    try:
        return float(text)
    except ValueError:
        raise InputError(option, text, f"must be a number{decimal_hint(text)}") from None


def whole_of(option: str, text: str) -> int:
    """A whole number."""
    try:
        return int(text)
    except ValueError:
        raise InputError(option, text, "must be a whole number") from None


def words_of(_: str, text: str) -> tuple[str, ...]:
    """Words that are separated by commas."""
    return tuple(word.strip() for word in text.split(",") if word.strip())


def numbers_of(option: str, text: str) -> tuple[float, ...]:
    """Numbers that are separated by commas."""
    return tuple(number_of(option, word) for word in words_of(option, text))


def file(metavar: str, complete: Completer | None = None) -> Value:
    """A path. If ``metavar`` begins with DIR, it is the path of a folder."""
    usual = of_folders if metavar.startswith("DIR") else of_files
    return Value(metavar, lambda _, text: Path(text), complete or usual)


def text(metavar: str, *words: str, complete: Completer | None = None) -> Value:
    """A text that the command itself interprets. The tab key completes ``words``."""
    return Value(metavar, lambda _, text: text, complete or of_words(*words))


def words(metavar: str, *words: str, suffix: str | None = None) -> Value:
    """Words that are separated by commas. The tab key completes ``words`` and files with ``suffix``."""
    return Value(metavar, words_of, of_lists(*words, suffix=suffix))


def choice(*words: str, metavar: str | None = None) -> Value:
    """One of these words."""
    shown = "|".join(words)
    if metavar is None:
        metavar = shown if len(shown) <= _MAX_CHOICES else "NAME"
    return Value(metavar, lambda option, text: one_of(option, text, words), of_words(*words))


def or_word(word: str, kind: Value, metavar: str) -> Value:
    """A certain word, or a value of another type."""
    return Value(metavar, lambda option, text: word if text == word else kind.read(option, text), of_words(word))


def or_none(kind: Value) -> Value:
    """The word none, or a value of another type."""
    return or_word("none", kind, f"{kind.name}|none")


def coordinates(names: str) -> Value:
    """Numbers that are separated by commas, one for each name."""

    def read(option: str, text: str) -> tuple[float, ...]:
        try:
            numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != names.count(",") + 1:
            raise InputError(option, text, f"must be {names}: numbers such as 1.5, separated by commas")
        return numbers

    return Value(names, read)


def _grid_of(option: str, text: str) -> Any:
    from tacbench_cad.spec.sampling import SampleGrid

    if text == "default":
        return "grid"
    counts = re.fullmatch(r"(\d{1,9})x(\d{1,9})", text)
    if counts is None:
        raise InputError(option, text, "must be NXxNY, for example 189x201, or nothing for the grid of the preset")
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
    panel: str,
    *,
    dest: str | None = None,
    short: str | None = None,
    alone: str | None = None,
    show_default: bool | str = True,
    **attributes: Any,
) -> Decorator:
    """An option with a value.

    Args:
        name: The name, with its hyphens.
        kind: The type of the value.
        help: The text in the help.
        panel: The panel of the help that shows it.
        dest: The argument of the command that takes the value; None for the name's own.
        short: Another name, of one letter.
        alone: The text that the option stands for if no value follows; None if a value must follow.
        show_default: See :func:`click.option`.
        attributes: Likewise.
    """
    names = (name, *(word for word in (short, dest) if word is not None))
    if alone is not None:
        attributes |= {"is_flag": False, "flag_value": alone}
    return click.option(*names, type=kind, help=help, panel=panel, show_default=show_default, **attributes)


def flag(name: str, help: str, panel: str) -> Decorator:
    """An option without a value."""
    return click.option(name, is_flag=True, help=help, panel=panel)


def argument(name: str, kind: Value, help: str, *, many: bool = False, required: bool = True) -> Decorator:
    """An argument: one word that is not an option, or any number of words."""
    return click.argument(name, type=kind, help=help, nargs=-1 if many else 1, required=required)


def together(*decorators: Decorator) -> Decorator:
    """Combine several decorators into one."""

    def decorate(function: F, /) -> F:
        return reduce(lambda inner, decorator: decorator(inner), reversed(decorators), function)

    return decorate


def command(name: str, parent: str | click.RichGroup) -> Callable[[Callable[..., None]], click.RichCommand]:
    """Make a command from a function. The docstring of the function becomes the help.

    Args:
        name: The word of the command.
        parent: The heading under which ``tacbench --help`` lists the command, or the group to which it belongs.
    """

    def decorate(function: Callable[..., None]) -> click.RichCommand:
        # An argument's name is its metavar: the help shows it once.
        panels = [click.RichOptionPanel(ARGUMENTS, column_types=["metavar", "help"])]
        panels += [click.RichOptionPanel(title) for title in PANELS[1:]]
        heading = parent if isinstance(parent, str) else None
        built = click.command(name, help=help_of(function.__doc__), panels=panels, panel=heading)(function)
        if isinstance(parent, click.RichGroup):
            parent.add_command(built)
        return built

    return decorate


class _Group(click.RichGroup):
    """A group that lists its commands in the order of the source."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


def group(name: str, heading: str) -> Callable[[Callable[..., None]], click.RichGroup]:
    """Make a group of commands from a function, in the same way."""
    return lambda function: click.group(
        name, cls=_Group, no_args_is_help=False, help=help_of(function.__doc__), panel=heading
    )(function)


def help_of(docstring: str | None) -> str:
    """Make a help text from a docstring. The lines of the examples are not wrapped."""
    return inspect.cleandoc(docstring or "").replace("\n\nExamples:\n", "\n\n\b\nExamples:\n")


#: The words for the paper's textures on the command line.
TEXTURES = (
    *("1", "2", "3", "4", "5", "6", "all", "later"),
    *("ripple", "rings", "diamond", "weave", "hexagons", "ridges", "rock", "dunes", "dimples", "scales", "knurl"),
    *("swirl", "chevron", "coral"),
)
#: The parts and file formats of ``make``; a test compares these words with those of the request.
PART_NAMES = ("blocks", "holder", "jig", "coupon")
FILE_FORMATS = ("stl", "3mf", "step")
#: Hold-out levels, in the words of ``--hold-out``; a test compares them with those of the analysis.
LEVELS = ("press", "position", "force", "copy", "printer-filament", "session")
TEXTURE = text("T", complete=of_lists(*(name for name in TEXTURES if name not in ("all", "later")), suffix=".toml"))

json = flag("--json", "Print the result as one JSON document.", OUTPUT)
preset = option(
    "--preset",
    PRESET,
    "Geometry: paper for new work, released to compare with the authors' prints.",
    PARTS,
    default="paper",
)
scale = option(
    "--scale", SCALE, "Factor that multiplies all lengths of the block, and the press grid.", SIZE, default="1"
)
_WHICH_TEXTURES = (
    "1 to 6, all, names such as dunes, later for all fourteen such names, or TOML files; for example 1,dunes."
)
textures = option(
    "--texture",
    words("LIST", *TEXTURES, suffix=".toml"),
    _WHICH_TEXTURES,
    PARTS,
    dest="textures",
    default="all",
)
drawn_textures = argument("textures", words("TEXTURES", *TEXTURES, suffix=".toml"), _WHICH_TEXTURES)
formats = option(
    "--formats", words("LIST", *FILE_FORMATS), "File formats: stl, 3mf, step. Default: all of them.", PARTS
)
copies = option("--copies", COUNT, "Make N files of each block, labelled with the number of the copy.", PARTS)
key = option(
    "--key",
    Value("[MM]", _key_of),
    "Cut off the corner with the largest x and the smallest y, so that the block fits into the holder in only one "
    "orientation. Without a value: by 3 mm.",
    PARTS,
    dest="key_mm",
    alone="default",
)
jobs = option(
    "--jobs",
    JOBS,
    "Number of processes. Default: one for each processor.",
    PROCESSES,
    default=_every_processor,
    show_default=False,
)
#: The address of pages that only this machine can open.
LOCAL = "127.0.0.1"
host = option(
    "--host",
    text("ADDRESS"),
    "Address of this machine at which others in the same network can watch the page, for example on a phone.",
    PAGE,
    default=LOCAL,
)
port = option("--port", COUNT, "Port of the page. Default: a free one.", PAGE, default="0", show_default=False)
no_browser = flag("--no-browser", "Only print the address of the page, and do not open it.", PAGE)
dask = option("--dask", text("ADDRESS"), "Use a running Dask cluster, for example tcp://10.0.0.5:8786.", PROCESSES)
REGION = text("REGION", "auto", "none", "circle:", "rect:")
roi = option(
    "--roi",
    REGION,
    "Region of interest: auto, none, circle:X,Y,R or rect:X0,Y0,X1,Y1 in pixels, or a PNG file that is white inside "
    "the region. Default: the region stored with the runs.",
    FRAMES,
)
features = option(
    "--features",
    text("NAME", complete=of_features),
    "Feature that is analysed: pixels, with --series also forces, or the feature of an extension, such as markers. "
    "Its settings follow a colon: markers:sigma_px=3.5.",
    FRAMES,
    default="pixels",
)
series = flag(
    "--series",
    "Analyse the series of frames that were taken while the sensor moved in contact (a slide). Default: "
    "the frame of each press.",
    FRAMES,
)
#: The options for what is used of each frame.
look = together(features, series, roi)
runs = argument("runs", file("RUNS", of_run_folders), "Run folders, or folders that contain run folders.", many=True)

#: The options that describe a block and its fixtures, by the names of the fields of a ``Request``.
part = together(
    preset,
    key,
    flag("--label", "Engrave texture, preset and scale in the underside.", PARTS),
    scale,
    option("--size", coordinates("X,Y"), "Sides in mm. Changes the number of periods.", SIZE, dest="size_mm"),
    option(
        "--outline",
        text("WORD", "disc", "hexagon", "ring", "triangle", "square", "pentagon", "octagon"),
        "Outline of the block: disc, hexagon, ring and so on for the largest one in the sides; or with sizes in mm: "
        "disc:30, hexagon:30, ring:30,12 or polygon:0,0,20,0,10,15 with its corners x,y.",
        SIZE,
    ),
    option(
        "--height", MM, "Height of the highest point in mm. Changes the thickness of the base.", SIZE, dest="height_mm"
    ),
    option("--mm-per-unit", coordinates("X,Y,Z"), "Length of one unit of u, v and z of the formula, in mm.", SIZE),
    option(
        "--tolerance",
        Value("MM", _tolerance_of),
        "Largest distance of a mesh from the formula. Default: 0.01, or more if the texture needs it.",
        ACCURACY,
    ),
    option(
        "--grid",
        Value("[NXxNY]", _grid_of),
        "Build the mesh from a grid of samples; --grid without a value takes the preset's grid.",
        ACCURACY,
        alone="default",
    ),
    option(
        "--fit",
        text("FIT", "press", "slip", "loose"),
        "Clearance of the pockets on each side: press, slip, loose, or a number in mm. Default: slip.",
        FIXTURES,
    ),
    option(
        "--rim",
        MM,
        "Height of the block's highest point above the holder's rim. Default: 1.18.",
        FIXTURES,
        dest="rim_mm",
    ),
    option("--slots", COUNT, "Number of pockets of the holder. Default: 1.", FIXTURES),
    option("--nozzle", MM, "Nozzle that will print the fixtures. Default: 0.4.", FIXTURES, dest="nozzle_mm"),
    option(
        "--jig",
        choice("default", "all"),
        "Holes of the jig: default (corners and centre) or all 25 positions, for a resin printer.",
        FIXTURES,
    ),
)


def out(metavar: str, help: str, **attributes: Any) -> Decorator:
    """The option ``--out``, for the path of the result."""
    return option("--out", file(metavar), help, OUTPUT, short="-o", **attributes)


def request_fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a ``Request`` from the options of the command line. Options without a value are left out.

    Raises:
        InputError: Both ``--grid`` and ``--tolerance`` are given.
    """
    given = {name: value for name, value in values.items() if value is not None and value is not False}
    tolerance, grid = given.pop("tolerance", None), given.pop("grid", None)
    if tolerance is not None and grid is not None:
        shown = grid if grid == "grid" else f"{grid.nx}x{grid.ny}"
        raise InputError("grid", shown, "cannot be combined with --tolerance; leave out one of them")
    sampling: Literal["grid"] | Any = tolerance or grid
    return given if sampling is None else {**given, "sampling": sampling}
