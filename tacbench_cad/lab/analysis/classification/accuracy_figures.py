"""The figures of a classification: hold-out levels with intervals, confusion matrices, the curve of a sweep."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.lab.analysis.classification.accuracy import FoldScore
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.paper_protocol import COLUMNS as PAPER_COLUMNS
from tacbench_cad.lab.analysis.classification.result import Result, beside_paper
from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.classification.sweep import PARAMETERS
from tacbench_cad.lab.analysis.figures import COLOURS, COLUMN_IN, INK, PAGE_IN, new_figure, save, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

#: The markers of the estimators.
MARKERS = ("o", "s", "D", "^", "v", "P")
#: The number of confusion matrices in a row.
ACROSS = 3


def draw_result(result: Result, out: Path) -> list[Path]:
    """Draw a classification as PNG and PDF: accuracies and confusion matrices, or the curve of a sweep.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: A file cannot be written.
    """
    with styled():
        if result.parameter:
            figures = {f"sweep_{result.parameter}": _sweep(result)}
        elif result.settings.protocol in PAPER_COLUMNS:
            stem = "paper_table" if result.settings.protocol == "paper" else "published_table"
            figures = {stem: _paper(result), **_confusions(result)}
        else:
            figures = {"hold_out_levels": _levels(result), **_confusions(result)}
        simulated = result.collection.simulated
        return [path for stem, figure in figures.items() for path in save(figure, out / stem, simulated)]


def _points(axes: Axes, x: Sequence[float], rows: Sequence[FoldScore], index: int, label: str) -> None:
    """Draw accuracies with their intervals, in %."""
    colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
    for place, score in zip(x, rows, strict=True):
        if score.low is not None and score.high is not None:
            axes.plot([place, place], [100 * score.low, 100 * score.high], color=colour, lw=1.4, zorder=2)
    axes.plot(x, [100 * score.accuracy for score in rows], marker, color=colour, ms=4.5, label=label, zorder=3)


def _chance(axes: Axes, fraction: float) -> None:
    axes.axhline(100 * fraction, color=INK, lw=0.7, ls=(0, (4, 3)), zorder=1)
    axes.text(
        1.0, 100 * fraction + 1, "chance", transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=7
    )
    axes.set_ylim(0, 102)
    axes.set_ylabel("accuracy (%)")


def _levels(result: Result) -> Figure:
    names = result.settings.estimators
    levels = list(dict.fromkeys(score.hold_out for score in result.scores))
    figure = new_figure(max(COLUMN_IN, 1.1 + 0.85 * len(levels)), 2.8)
    axes = figure.add_subplot()
    for index, name in enumerate(names):
        shift = 0.22 * (index - (len(names) - 1) / 2)
        mine = [score for score in result.scores if score.estimator == name]
        rows = [score for score in mine if score.whole]
        _points(axes, [levels.index(score.hold_out) + shift for score in rows], rows, index, name)
        for score in mine:
            if not score.whole:
                place = levels.index(score.hold_out) + shift + 0.09
                colour = COLOURS[index % len(COLOURS)]
                axes.plot(place, 100 * score.accuracy, "_", color=colour, ms=5, mew=1.0, zorder=2)
    if not all(score.whole for score in result.scores):
        axes.plot([], [], "_", color=INK, ms=5, mew=1.0, label="one held-out group")
    whole = {score.hold_out: score for score in result.scores if score.whole}
    units = {
        level: score.units.replace("printer-filament combinations", "combinations") for level, score in whole.items()
    }
    unknown = result.collection.unknown_groups
    shown = {level: shown_level(level, unknown).replace(", ", ",\n") for level in levels}
    few = {level: f"\n{TOO_FEW}" if score.low is None else "" for level, score in whole.items()}
    axes.set_xticks(range(len(levels)), [f"{shown[level]}\n({units[level]}){few[level]}" for level in levels])
    axes.set_xlim(-0.5, len(levels) - 0.5)
    axes.set_xlabel("held out (units of the 95 % interval)")
    _chance(axes, result.chance)
    figure.legend(loc="outside upper center", ncols=3)
    return figure


def _paper(result: Result) -> Figure:
    names, columns = result.settings.estimators, PAPER_COLUMNS[result.settings.protocol]
    paper = {(row.train_on, row.estimator): row.paper for row in beside_paper(result)}
    figure = new_figure(PAGE_IN, 2.9)
    panels = figure.subplots(1, len(result.settings.train_on), sharey=True, squeeze=False)[0]
    for panel, train_on in zip(panels, result.settings.train_on, strict=True):
        for index, name in enumerate(names):
            shift = 0.24 * (index - (len(names) - 1) / 2)
            mine = [s for s in result.scores if s.whole and (s.estimator, s.train_on) == (name, train_on)]
            _points(panel, [columns.index(score.hold_out) + shift for score in mine], mine, index, name)
            for place, value in enumerate(paper.get((train_on, name), ())):
                if value is not None:
                    panel.plot(place + shift + 0.08, value, "x", color=INK, ms=4.5, mew=1.0, zorder=4)
        panel.set_title(train_on.replace("_", ", "))
        inflated = ("test", "all copies")
        panel.set_xticks(range(len(columns)), [f"{name}\n(inflated)" if name in inflated else name for name in columns])
        panel.tick_params(axis="x", labelsize=6.5)
        panel.set_xlim(-0.5, len(columns) - 0.5)
        _chance(panel, result.chance)
        panel.label_outer()
    if any(value is not None for values in paper.values() for value in values):
        panels[0].plot([], [], "x", color=INK, ms=4.5, mew=1.0, label="printed in the paper")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _confusions(result: Result) -> dict[str, Figure]:
    """Draw the confusion matrices, one figure for each estimator (and training combination)."""
    figures: dict[str, Figure] = {}
    rows = [score for score in result.scores if score.whole and score.hold_out != "train"]
    paper = result.settings.protocol != "leak-free"
    for name, train_on in dict.fromkeys((score.estimator, score.train_on) for score in rows):
        mine = [score for score in rows if (score.estimator, score.train_on) == (name, train_on)]
        down = -(-len(mine) // ACROSS)
        figure = new_figure(min(PAGE_IN, 1.2 + 2.1 * len(mine)), 0.4 + 2.35 * down)
        panels = figure.subplots(down, min(ACROSS, len(mine)), squeeze=False)
        short = [texture.removeprefix("texture-") for texture in result.textures]
        levels = [shown_level(score.hold_out, result.collection.unknown_groups) for score in mine]
        matrices = [_matrix(*each) for each in zip(panels.flat, mine, [short] * len(mine), levels, strict=False)]
        for axes in panels.flat[len(mine) :]:
            axes.set_axis_off()
        label = "fraction of the texture's presses (%)"
        figure.colorbar(matrices[0], ax=panels.ravel().tolist(), label=label, shrink=0.8)
        figure.suptitle(f"{name} trained on {train_on.replace('_', ', ')}" if paper else name)
        stem = f"confusion_{name.replace(':', '-').replace('.', '-')}"
        figures[f"{stem}_{train_on}" if paper else stem] = figure
    return figures


def _matrix(axes: Axes, score: FoldScore, names: Sequence[str], level: str) -> AxesImage:
    percent = 100.0 * score.fractions
    matrix = axes.imshow(percent, vmin=0, vmax=100, cmap="cividis")
    for i, j in np.argwhere(percent >= 0.5):
        colour = "white" if percent[i, j] < 55 else "black"
        axes.text(j, i, f"{percent[i, j]:.0f}", ha="center", va="center", color=colour, fontsize=6.5)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.set_xlabel("predicted")
    axes.set_ylabel("texture")
    axes.set_title(f"{level}: {100 * score.accuracy:.1f} %")
    return matrix


def _sweep(result: Result) -> Figure:
    """Draw the accuracy over the setting: intervals as bars, the standard deviation over trials as a band."""
    figure = new_figure(4.6, 3.0)
    axes = figure.add_subplot()
    curves: dict[tuple[str, str, str], list[tuple[float, FoldScore]]] = {}
    for value, score in zip(result.values, result.scores, strict=True):
        curves.setdefault((score.estimator, score.train_on, score.hold_out), []).append((value, score))
    several = [len(set(words)) > 1 for words in zip(*curves, strict=True)]
    # The curves are shifted a little, so that no bar hides another.
    apart = 0.008 * float(np.ptp(result.values))
    for index, (key, points) in enumerate(curves.items()):
        rows, shift = [score for _, score in points], apart * (index - (len(curves) - 1) / 2)
        x = [value + shift for value, _ in points]
        y = 100 * np.array([score.accuracy for score in rows])
        deviation = 100 * np.array([score.standard_deviation or 0.0 for score in rows])
        colour = COLOURS[index % len(COLOURS)]
        if deviation.any():
            axes.fill_between(x, y - deviation, y + deviation, color=colour, alpha=0.2, lw=0)
        axes.plot(x, y, color=colour)
        label = ", ".join(word for word, differs in zip(key, several, strict=True) if differs)
        _points(axes, x, rows, index, label or key[2])
    axes.set_xlabel(PARAMETERS[result.parameter])
    _chance(axes, result.chance)
    entries = {
        "bar: 95 % interval": any(score.low is not None for score in result.scores),
        "band: standard deviation over the trials": any(score.standard_deviation for score in result.scores),
    }
    title = "; ".join(text for text, drawn in entries.items() if drawn)
    figure.legend(loc="outside upper center", ncols=3, title=title or None)
    return figure
