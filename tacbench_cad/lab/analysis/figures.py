"""The common parts of all figures of the analysis: style, colours, and files that say if their data are simulated.

This module needs matplotlib (extra ``plot``), which is imported when a figure is made. Every figure is written as PNG
and as PDF. Each file is written completely or not at all, and contains no date.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from tacbench_cad.lab.analysis.tables import write_csv
from tacbench_cad.util import plotting
from tacbench_cad.util.files import refusing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS, INK = plotting.COLOURS, plotting.INK
#: The colour map for magnitudes.
MAP = "viridis"
#: The colour of the mark on figures of simulated data.
MARK = "#b03a00"
#: The width of a column and the width of a page in most journals, in inches.
COLUMN_IN, PAGE_IN = 3.5, 7.2
#: The height of the mark, in inches.
_MARK_IN = 0.16

_STYLE = {
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "figure.titlesize": 9.0,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "image.cmap": MAP,
    "image.interpolation": "nearest",
    "lines.linewidth": 1.2,
    # The text in a PDF file stays text, so that it can be searched.
    "pdf.fonttype": 42,
}


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Draw in the project's style and ignore the user's matplotlib settings.

    Raises:
        MissingToolError: matplotlib is not installed.
    """
    with plotting.only_style("figures", _STYLE):
        import matplotlib
        from cycler import cycler

        matplotlib.rcParams["axes.prop_cycle"] = cycler(color=list(COLOURS))
        yield


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return a new figure without a window, with matplotlib's constrained layout."""
    return plotting.new_figure((width_in, height_in), layout="constrained")


def save(figure: Figure, stem: Path, simulated: Sequence[str]) -> tuple[Path, Path]:
    """Write a figure as PNG and as PDF.

    Args:
        figure: The figure. Call this function inside :func:`styled`.
        stem: The path of the files without suffix. The folder must exist.
        simulated: The simulated parts of the data (``Design.simulated``); empty for real data. They are written
            into the files' metadata, and the text "simulated data" is added below the figure.

    Returns:
        The path of the PNG file and the path of the PDF file.

    Raises:
        InputError: A file cannot be written.
    """
    from matplotlib.transforms import Bbox

    width, height = (float(size) for size in figure.get_size_inches())
    box = Bbox.from_extents(0.0, -_MARK_IN if simulated else 0.0, width, height)
    about = f"simulated data: {'; '.join(simulated)}" if simulated else ""
    mark = None
    if simulated:
        place = (0.06 / width, -0.02 / height)
        mark = figure.text(*place, "simulated data", ha="left", va="top", fontsize=6.5, color=MARK, style="italic")
        mark.set_in_layout(False)
    paths = stem.with_name(f"{stem.name}.png"), stem.with_name(f"{stem.name}.pdf")
    try:
        for path in paths:
            plotting.save_figure(figure, path, box, about)
            figure.set_layout_engine("none")  # the second file uses the same layout as the first
    finally:
        if mark is not None:
            mark.remove()
    return paths


def save_results(
    folder: str | Path, tables: Mapping[str, pd.DataFrame], figures: Mapping[str, Figure], simulated: Sequence[str]
) -> list[Path]:
    """Write the tables and the figures of an analysis into a folder.

    Args:
        folder: The folder. It is made if it does not exist.
        tables: The tables, by the names of their CSV files without suffix.
        figures: The figures, by the names of their files without suffix.
        simulated: The simulated parts of the data.

    Returns:
        The paths of the files.

    Raises:
        InputError: A file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    path = Path(folder)
    with refusing(path):
        path.mkdir(parents=True, exist_ok=True)
    paths = [write_csv(path / f"{name}.csv", table, simulated) for name, table in tables.items()]
    with styled():
        return [*paths, *(file for stem, of in figures.items() for file in save(of, path / stem, simulated))]
