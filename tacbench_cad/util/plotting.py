"""Drawing with matplotlib in a style of our own, whatever the user's settings say, to files without a date."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.util.errors import MissingToolError
from tacbench_cad.util.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

#: Colours that people with any colour vision tell apart (Okabe and Ito), the darker ones first.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#f0e442")
BLUE, ORANGE, GREEN = COLOURS[:3]
#: Colour of text and axes.
INK = "#222222"
#: Dots per inch of a picture.
DPI = 150
_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.linewidth": 0.7,
    "axes.edgecolor": INK,
    "axes.titlesize": 9.0,
    "xtick.direction": "out",
}
#: What no file may hold: a date, or the names of the programs that wrote it.
_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "pdf": {"CreationDate": None, "Producer": None, "Creator": None},
    "svg": {"Date": None, "Creator": None},
}
#: What each kind calls the words on what a file shows.
_ABOUT = {"png": "Description", "pdf": "Subject", "svg": "Description"}
#: Suffixes of the files that a figure can be written to.
SUFFIXES = tuple(f".{kind}" for kind in _METADATA)


@contextlib.contextmanager
def only_style(what: str, style: Mapping[str, Any]) -> Iterator[None]:
    """Draw with matplotlib's own defaults and these changes to them; afterwards all is as it was.

    Args:
        what: What is drawn, for the message where matplotlib is missing: ``pictures``.
        style: Changes to matplotlib's defaults.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise MissingToolError(f'{what} need matplotlib: pip install "tacbench-cad[plot]"') from None
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, "backend": matplotlib.rcParams["backend"], **style}):
        yield


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Draw in the style of our pictures.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    with only_style("pictures", _STYLE):
        yield


def new_figure(inches: tuple[float, float], dpi: int = DPI, layout: Literal["constrained"] | None = None) -> Figure:
    """A figure of its own, which no window knows of.

    Args:
        inches: Width and height.
        dpi: Dots per inch of its files.
        layout: matplotlib's layout engine; None where everything has its place.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches, dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def colour_bar(axes: Axes, mapped: Any, label: str, **style: Any) -> float:
    """Draw a colour bar along the right side of a map.

    Args:
        axes: The map, whose sides are true to scale.
        mapped: What has the colours.
        label: What stands beside the bar.
        style: Passed on to matplotlib.

    Returns:
        Left side of the bar, as a fraction of the figure's width.
    """
    axes.apply_aspect()
    box = axes.get_position()
    left = box.x1 + 0.012
    axes.figure.colorbar(mapped, cax=axes.figure.add_axes((left, box.y0, 0.014, box.height)), **style).set_label(label)
    return float(left)


def save_figure(figure: Figure, path: Path, kind: str = "png", box: Bbox | None = None, about: str = "") -> None:
    """Write a figure, whole or not at all, without a date.

    Args:
        figure: The figure, with its own dots per inch.
        path: The file.
        kind: ``png``, ``pdf`` or ``svg``.
        box: What of the plane is written, in inches; None for the figure itself.
        about: Words for the file's metadata: a PNG's ``Description``, a PDF's ``Subject``.

    Raises:
        InputError: The file cannot be written.
    """
    metadata = {**_METADATA[kind], **({_ABOUT[kind]: about} if about else {})}
    with replacing(path) as temporary:
        figure.savefig(temporary, format=kind, bbox_inches=box, metadata=metadata)
