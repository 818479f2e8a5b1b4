"""Figures of a classification: the ladder with its intervals, confusion matrices, a sweep's curve."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.lab.analysis.classification.accuracy import Score
from tacbench_cad.lab.analysis.classification.classify import Result, beside_paper
from tacbench_cad.lab.analysis.classification.sweep import PARAMETERS, SweepResult
from tacbench_cad.lab.analysis.figures import COLOURS, COLUMN_IN, INK, PAGE_IN, new_figure, save, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

#: Marks of the estimators, beside their colours.
MARKERS = ("o", "s", "D", "^", "v", "P")
#: Columns of confusion matrices.
ACROSS = 3


def draw_result(result: Result, out: Path) -> list[Path]:
    """Draw ``ladder`` (or ``paper_table``) and ``confusion`` as PNG and PDF.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: A file cannot be written.
    """
    simulated = result.collection.simulated
    paths: list[Path] = []
    with styled():
        draw = _paper if result.settings.protocol == "paper" else _ladder
        paths += draw(result, out, simulated)
        paths += _confusions(result, out, simulated)
    return paths


def _whole(result: Result) -> list[Score]:
    """Rows of whole rungs, without the single held-out groups."""
    return [one for one in result.scores if one.tested_on in ("all", "all others", one.train_on)]


def _points(axes: Axes, x: Sequence[float], rows: Sequence[Score], index: int, label: str) -> None:
    """Accuracies with their intervals, in per cent."""
    colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
    for place, one in zip(x, rows, strict=True):
        if one.low is not None and one.high is not None:
            axes.plot([place, place], [100 * one.low, 100 * one.high], color=colour, lw=1.4, zorder=2)
    axes.plot(x, [100 * one.accuracy for one in rows], marker, color=colour, ms=4.5, label=label, zorder=3)


def _chance(axes: Axes, percent: float) -> None:
    axes.axhline(percent, color=INK, lw=0.7, ls=(0, (4, 3)), zorder=1)
    axes.text(1.0, percent + 1, "chance", transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=7)
    axes.set_ylim(0, 102)
    axes.set_ylabel("accuracy (%)")


def _ladder(result: Result, out: Path, simulated: Sequence[str]) -> list[Path]:
    names = result.settings.estimators
    rungs = list(dict.fromkeys(one.rung for one in result.scores))
    figure = new_figure(max(COLUMN_IN, 1.1 + 0.85 * len(rungs)), 2.8)
    axes = figure.add_subplot()
    single = False
    for index, name in enumerate(names):
        shift = 0.22 * (index - (len(names) - 1) / 2)
        rows = [one for one in result.scores if one.estimator == name and one.tested_on == "all"]
        _points(axes, [rungs.index(one.rung) + shift for one in rows], rows, index, name)
        for one in result.scores:
            if one.estimator == name and one.tested_on != "all":
                place = rungs.index(one.rung) + shift + 0.09
                axes.plot(place, 100 * one.accuracy, "_", color=COLOURS[index % len(COLOURS)], ms=5, mew=1.0, zorder=2)
                single = True
    if single:
        axes.plot([], [], "_", color=INK, ms=5, mew=1.0, label="one held-out group")
    units = {one.rung: one.units for one in result.scores if one.tested_on == "all"}
    axes.set_xticks(range(len(rungs)), [f"{rung}\n({_short(units[rung])})" for rung in rungs])
    axes.set_xlim(-0.5, len(rungs) - 0.5)
    axes.set_xlabel("held out (units of the 95 % interval)")
    _chance(axes, 100 * result.chance)
    figure.legend(loc="outside upper center", ncols=3)
    return list(save(figure, out / "ladder", simulated))


def _short(units: str) -> str:
    return units.replace("printer-filament combinations", "combinations")


def _paper(result: Result, out: Path, simulated: Sequence[str]) -> list[Path]:
    rows = beside_paper(result)
    columns = ("train", "test", "unseen")
    figure = new_figure(PAGE_IN, 2.9)
    panels = figure.subplots(1, len(result.settings.train_on), sharey=True, squeeze=False)[0]
    for panel, train_on in zip(panels, result.settings.train_on, strict=True):
        for index, name in enumerate(result.settings.estimators):
            shift = 0.24 * (index - (len(result.settings.estimators) - 1) / 2)
            mine = [
                next(
                    one for one in _whole(result) if (one.estimator, one.train_on, one.rung) == (name, train_on, column)
                )
                for column in columns
                if any((one.estimator, one.train_on, one.rung) == (name, train_on, column) for one in _whole(result))
            ]
            _points(panel, [columns.index(one.rung) + shift for one in mine], mine, index, name)
            theirs = next(one.paper for one in rows if (one.estimator, one.train_on) == (name, train_on))
            for place, value in enumerate(theirs):
                if value is not None:
                    panel.plot(place + shift + 0.08, value, "x", color=INK, ms=4.5, mew=1.0, zorder=4)
        panel.set_title(train_on.replace("_", ", "))
        panel.set_xticks(range(3), ["train", "test\n(inflated)", "unseen"])
        panel.set_xlim(-0.5, 2.5)
        _chance(panel, 100 * result.chance)
        panel.label_outer()
    handles, labels = panels[0].get_legend_handles_labels()
    if any(value is not None for one in rows for value in one.paper):
        handles.append(panels[0].plot([], [], "x", color=INK, ms=4.5, mew=1.0)[0])
        labels.append("printed in the paper")
    figure.legend(handles, labels, loc="outside upper center", ncols=4)
    return list(save(figure, out / "paper_table", simulated))


def _confusions(result: Result, out: Path, simulated: Sequence[str]) -> list[Path]:
    """Confusion matrices, one file an estimator (and training combination)."""
    paths: list[Path] = []
    rows = [one for one in _whole(result) if one.rung != "train"]
    for name, train_on in dict.fromkeys((one.estimator, one.train_on) for one in rows):
        mine = [one for one in rows if (one.estimator, one.train_on) == (name, train_on)]
        stem = f"confusion_{name.replace(':', '-').replace('.', '-')}"
        stem += "" if result.settings.protocol == "sound" else f"_{train_on}"
        down = -(-len(mine) // ACROSS)
        figure = new_figure(min(PAGE_IN, 1.2 + 2.1 * len(mine)), 0.4 + 2.35 * down)
        panels = figure.subplots(down, min(ACROSS, len(mine)), squeeze=False)
        short = [one.removeprefix("texture-") for one in result.textures]
        pictures = [_matrix(axes, one, short) for axes, one in zip(panels.flat, mine, strict=False)]
        for axes in panels.flat[len(mine) :]:
            axes.set_axis_off()
        figure.colorbar(pictures[0], ax=panels.ravel().tolist(), label="share of the texture's presses (%)", shrink=0.8)
        head = f"{name}" if result.settings.protocol == "sound" else f"{name} trained on {train_on.replace('_', ', ')}"
        figure.suptitle(head)
        paths += save(figure, out / stem, simulated)
    return paths


def _matrix(axes: Axes, score: Score, names: Sequence[str]) -> AxesImage:
    totals = score.confusion.sum(axis=1, keepdims=True)
    shares = np.full(score.confusion.shape, np.nan)
    np.divide(100.0 * score.confusion, totals, out=shares, where=totals > 0)
    picture = axes.imshow(shares, vmin=0, vmax=100, cmap="cividis")
    for i, j in np.ndindex(shares.shape):
        if np.isfinite(shares[i, j]) and shares[i, j] >= 0.5:
            colour = "white" if shares[i, j] < 55 else "black"
            axes.text(j, i, f"{shares[i, j]:.0f}", ha="center", va="center", color=colour, fontsize=6.5)
    axes.set_xticks(range(len(names)), names)
    axes.set_yticks(range(len(names)), names)
    axes.tick_params(length=0)
    axes.set_xlabel("said")
    axes.set_ylabel("texture")
    axes.set_title(f"{score.rung}: {100 * score.accuracy:.1f} %")
    return picture


def draw_sweep(result: SweepResult, out: Path, simulated: Sequence[str]) -> list[Path]:
    """Draw ``sweep_<parameter>`` as PNG and PDF: accuracy, intervals as bars, the spread of several trials as a band.

    Raises:
        MissingToolError: matplotlib is not installed.
        InputError: A file cannot be written.
    """
    with styled():
        figure = new_figure(4.6, 3.0)
        axes = figure.add_subplot()
        keys = list(dict.fromkeys((score.estimator, score.train_on, score.rung) for _, score in result.points))
        several = {which: len({key[which] for key in keys}) > 1 for which in range(3)}
        # Curves stand a little apart, so that no bar hides another.
        apart = 0.008 * float(np.ptp([value for value, _ in result.points]))
        for index, key in enumerate(keys):
            mine = [(value, one) for value, one in result.points if (one.estimator, one.train_on, one.rung) == key]
            rows, shift = [one for _, one in mine], apart * (index - (len(keys) - 1) / 2)
            x = [value + shift for value, _ in mine]
            y = 100 * np.array([one.accuracy for one in rows])
            spread = 100 * np.array([one.spread or 0.0 for one in rows])
            colour = COLOURS[index % len(COLOURS)]
            label = ", ".join(key[which] for which in range(3) if several[which]) or key[2]
            if spread.any():
                axes.fill_between(x, y - spread, y + spread, color=colour, alpha=0.2, lw=0)
            axes.plot(x, y, color=colour)
            _points(axes, x, rows, index, label)
        axes.set_xlabel(PARAMETERS[result.sweep.parameter])
        _chance(axes, 100 / result.textures)
        scores = [score for _, score in result.points]
        said = {
            "bar: 95 % interval": any(score.low is not None for score in scores),
            "band: standard deviation over the trials": any(score.spread for score in scores),
        }
        title = "; ".join(words for words, drawn in said.items() if drawn)
        figure.legend(loc="outside upper center", ncols=3, title=title or None)
        return list(save(figure, out / f"sweep_{result.sweep.parameter}", simulated))
