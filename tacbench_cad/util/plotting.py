"""Plots in the project's style, independent of the user's matplotlib settings, written to files without a date."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.files import replacing
from tacbench_cad.util.types import Bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

#: Colours that colour-blind people can distinguish (Okabe and Ito), dark colours first.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#f0e442")
BLUE, ORANGE, GREEN = COLOURS[:3]
#: The colour of text and axes.
INK = "#222222"
#: The resolution of a picture, in dots per inch.
DPI = 150
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.edgecolor": INK,
    "axes.titlesize": 9.0,
    "xtick.direction": "out",
    # Letters in a PDF stay letters, which programs can search; names inside of an SVG are the same on every run.
    "pdf.fonttype": 42,
    "svg.hashsalt": "tacbench-cad",
}
#: Metadata that is left out, so that files are reproducible: the date, and the programs that wrote the file.
_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
    "svg": {"Date": None, "Creator": None},
}
#: The metadata key of a description, for each file format.
_ABOUT = {"png": "Description", "pdf": "Subject", "svg": "Description"}
#: The suffixes of the file formats that a figure can be written to.
SUFFIXES = tuple(f".{kind}" for kind in _METADATA)


def picture_format(path: Path) -> str:
    """The format that the ending of a picture's file name asks for: ``png``, ``pdf`` or ``svg``.

    Raises:
        InputError: The name has another ending.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError("out", str(path), f"must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    return path.suffix.lower().removeprefix(".")


def require_single_picture(out: Path | None, count: int) -> None:
    """Check that a chosen name of a picture names a single one.

    Args:
        out: The name; None if each picture gets its own.
        count: The number of pictures.

    Raises:
        InputError: There are several pictures with one name.
    """
    if out is not None and count > 1:
        raise InputError("out", str(out), f"is the name of one picture, but there are {count}; leave out --out")


@contextlib.contextmanager
def only_style(what: str, style: Mapping[str, Any]) -> Iterator[None]:
    """Use matplotlib's defaults with some changes in the body, and restore the user's settings afterwards.

    Args:
        what: The kind of output, for the error message if matplotlib is missing: ``pictures``.
        style: The changes to matplotlib's defaults.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise MissingToolError(f'{what} need matplotlib: pip install "tacbench-cad[plot]"') from None
    # Reading the setting "backend" would import pyplot, which is slow. The figures of this package do not use it.
    defaults = {name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"}
    with matplotlib.rc_context({**defaults, **style}):
        yield


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Use the style of the project's pictures in the body.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    with only_style("pictures", _STYLE):
        yield


@cache
def text_width_mm(text: str, points: float) -> float:
    """Width of a line of text on paper, in mm.

    Args:
        text: The line.
        points: Size of the letters in points.
    """
    from matplotlib.font_manager import findfont, get_font

    font = get_font(findfont("DejaVu Sans"))
    # The letters are measured at a large size, at which rounding to whole pixels does not matter.
    font.set_size(100.0, 72.0)
    font.set_text(text, 0.0)
    return float(font.get_width_height()[0]) / 64.0 * points / 100.0 * 25.4 / 72.0


def load() -> None:
    """Import what :func:`new_figure` needs. It takes a third of a second."""
    import matplotlib.backends.backend_agg
    import matplotlib.figure  # noqa: F401


def new_figure(inches: tuple[float, float], dpi: int = DPI, layout: Literal["constrained"] | None = None) -> Figure:
    """Make a figure without a window, independent of pyplot.

    Args:
        inches: The width and height.
        dpi: The resolution of its files, in dots per inch.
        layout: The name of matplotlib's layout engine; None if all positions are fixed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def fill_figure(figure: Figure, image: Bytes) -> None:
    """Lay an image behind everything else in a figure, pixel by pixel.

    Args:
        figure: The figure; its size in dots is the image's.
        image: RGB image, shape (height, width, 3).
    """
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), zorder=-1.0)
    axes.imshow(image, interpolation="none", aspect="auto")
    axes.set_axis_off()


def colour_bar(axes: Axes, mapped: Any, label: str, **style: Any) -> float:
    """Draw a colour bar on the right side of a map.

    Args:
        axes: The axes of the map, with equal scales.
        mapped: The image or contour set that defines the colours.
        label: The label of the bar.
        style: Further arguments of matplotlib's ``colorbar``.

    Returns:
        The left side of the bar, as a fraction of the figure's width.
    """
    axes.apply_aspect()
    box = axes.get_position()
    left = box.x1 + 0.012
    axes.figure.colorbar(mapped, cax=axes.figure.add_axes((left, box.y0, 0.014, box.height)), **style).set_label(label)
    return float(left)


def save_figure(figure: Figure, path: Path, box: Bbox | None = None, about: str = "") -> None:
    """Write a figure to a file without a date. An interrupted call leaves no file.

    Args:
        figure: The figure. Its own resolution (dots per inch) is used.
        path: The file; its name ends in ``.png``, ``.pdf`` or ``.svg``.
        box: The part of the figure to write, in inches; None for the whole figure.
        about: A description for the file's metadata (``Description`` of a PNG, ``Subject`` of a PDF).

    Raises:
        InputError: The file's name has another ending, or the file cannot be written.
    """
    kind = picture_format(path)
    metadata = {**_METADATA[kind], **({_ABOUT[kind]: about} if about else {})}
    with replacing(path) as temporary:
        figure.savefig(temporary, format=kind, bbox_inches=box, metadata=metadata)
