"""The figures of a classification: hold-out levels with intervals, confusion matrices, the curve of a sweep."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.classification.accuracy import ALL
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.hold_out import shown_level
from tacbench_cad.lab.analysis.figures import COLOURS, COLUMN_IN, INK, PAGE_IN, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


#: The markers of the estimators.
MARKERS = ("o", "s", "D", "^", "v", "P")
#: The number of confusion matrices in a row.
ACROSS = 3


def _points(axes: Axes, x: pd.Series[float], rows: pd.DataFrame, index: int, label: str) -> None:
    """Draw accuracies with their intervals, in %."""
    colour, marker = COLOURS[index % len(COLOURS)], MARKERS[index % len(MARKERS)]
    axes.vlines(x, 100 * rows["low"], 100 * rows["high"], color=colour, lw=1.4, zorder=2)
    axes.plot(x, 100 * rows["accuracy"], marker, color=colour, ms=4.5, label=label, zorder=3)


def _chance(axes: Axes, fraction: float) -> None:
    axes.axhline(100 * fraction, color=INK, lw=0.7, ls=(0, (4, 3)), zorder=1)
    where = axes.get_yaxis_transform()
    axes.text(1.0, 100 * fraction + 1, "chance", transform=where, ha="right", va="bottom", fontsize=7)
    axes.set_ylim(0, 102)
    axes.set_ylabel("accuracy (%)")


def accuracy_figure(
    table: pd.DataFrame, paper: pd.DataFrame, chance: float, unknown: Sequence[str], *, titled: bool
) -> Figure:
    """Draw the accuracies at each hold-out level or column of the paper, in a panel for each training combination.

    Args:
        table: The accuracies, see :func:`.accuracy.scores`.
        paper: The figures of the paper, see :func:`.accuracy.beside_paper`; empty for none.
        chance: The accuracy expected from guessing, from 0 to 1.
        unknown: The unknown groups, see :attr:`.Design.unknown_groups`.
        titled: Whether a panel has the training combination as its title.
    """
    levels, combinations = list(table["hold_out"].unique()), table["train_on"].unique()
    estimators = list(table["estimator"].unique())
    width = min(PAGE_IN, max(COLUMN_IN, 1.1 + 0.85 * len(levels) * len(combinations)))
    with styled():
        figure = new_figure(width, 2.9)
        panels = figure.subplots(1, len(combinations), sharey=True, squeeze=False)[0]
        for panel, train_on in zip(panels, combinations, strict=True):
            here = table[table["train_on"] == train_on].assign(place=lambda rows: rows["hold_out"].map(levels.index))
            for index, name in enumerate(estimators):
                shift = 0.22 * (index - (len(estimators) - 1) / 2)
                mine = here[here["estimator"] == name]
                whole, groups = mine[mine["tested_on"] == ALL], mine[mine["tested_on"] != ALL]
                _points(panel, whole["place"] + shift, whole, index, name)
                colour = COLOURS[index % len(COLOURS)]
                panel.plot(groups["place"] + shift + 0.09, 100 * groups["accuracy"], "_", color=colour, ms=5)
                if len(paper):
                    printed = paper[(paper["train_on"] == train_on) & (paper["estimator"] == name)]
                    x = printed["hold_out"].map(levels.index) + shift + 0.08
                    panel.plot(x, printed["paper"], "x", color=INK, ms=4.5, mew=1.0, zorder=4)
            of_level = here[here["tested_on"] == ALL].drop_duplicates("hold_out")
            panel.set_xticks(of_level["place"], [_tick(row, unknown) for row in of_level.to_dict("records")])
            panel.tick_params(axis="x", labelsize=6.5 if len(panels) > 1 else None)
            panel.set_xlim(-0.5, len(levels) - 0.5)
            if titled:
                panel.set_title(train_on.replace("_", ", "))
            _chance(panel, chance)
            panel.label_outer()
        figure.supxlabel("held out (units of the 95 % interval)", fontsize=8.0)
        if (table["tested_on"] != ALL).any():
            panels[0].plot([], [], "_", color=INK, ms=5, mew=1.0, label="one held-out group")
        if len(paper) and paper["paper"].notna().any():
            panels[0].plot([], [], "x", color=INK, ms=4.5, mew=1.0, label="printed in the paper")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    return figure


def _tick(row: Mapping[Hashable, Any], unknown_groups: Sequence[str]) -> str:
    """Return the label of a hold-out level: its name, the units of the interval, and what a reader must know."""
    units = row["units"].replace("printer-filament combinations", "combinations")
    inflated = "\ninflated" * (row["hold_out"] in ("test", "all copies"))
    few = f"\n{TOO_FEW}" * bool(pd.isna(row["low"]))
    return f"{shown_level(row['hold_out'], unknown_groups)}\n({units}){inflated}{few}".replace(", ", ",\n")


def confusion_figures(
    table: pd.DataFrame, textures: Sequence[str], unknown: Sequence[str], *, titled: bool
) -> dict[str, Figure]:
    """Draw the confusion matrices, one figure for each estimator (and training combination), by the files' names.

    Args:
        table: The confusion matrices, see :func:`.accuracy.confusion`.
        textures: The textures.
        unknown: The unknown groups, see :attr:`.Design.unknown_groups`.
        titled: Whether a figure has the training combination in its title and its name.
    """
    from sklearn.metrics import ConfusionMatrixDisplay

    figures: dict[str, Figure] = {}
    short = [texture.removeprefix("texture-") for texture in textures]
    table = table[table["hold_out"] != "train"]
    for (name, train_on), mine in table.groupby(["estimator", "train_on"], sort=False):
        title = f"{name} trained on {train_on}" if titled else str(name)
        matrices = {str(level): rows for level, rows in mine.groupby("hold_out", sort=False)}
        down = -(-len(matrices) // ACROSS)
        with styled():
            figure = new_figure(min(PAGE_IN, 1.2 + 2.1 * len(matrices)), 0.4 + 2.35 * down)
            panels = figure.subplots(down, min(ACROSS, len(matrices)), squeeze=False)
            for axes, (level, rows) in zip(panels.flat, matrices.items(), strict=False):
                matrix = rows.pivot(index="texture", columns="predicted", values="fraction")
                matrix = matrix.loc[list(textures), list(textures)]
                display = ConfusionMatrixDisplay(100.0 * matrix.to_numpy(), display_labels=short)
                how = {"im_kw": {"vmin": 0, "vmax": 100}, "text_kw": {"fontsize": 6.5}, "colorbar": False}
                display.plot(ax=axes, cmap="cividis", values_format=".0f", **how)
                for text in display.text_.flat:
                    text.set_visible(text.get_text() not in ("0", "nan"))
                right = rows.loc[rows["texture"] == rows["predicted"], "count"].sum() / rows["count"].sum()
                axes.set_title(f"{shown_level(level, unknown)}: {100 * right:.1f} %")
                axes.set(xlabel="predicted", ylabel="texture")
            for axes in panels.flat[len(matrices) :]:
                axes.set_axis_off()
            label = "fraction of the texture's presses (%)"
            figure.colorbar(display.im_, ax=panels.ravel().tolist(), label=label, shrink=0.8)
            figure.suptitle(title.replace("_", ", ") if titled else title)
        stem = f"confusion_{name}".replace(":", "-").replace(".", "-")
        figures[f"{stem}_{train_on}" if titled else stem] = figure
    return figures


def sweep_figure(table: pd.DataFrame, label: str, chance: float) -> Figure:
    """Draw the accuracy over a setting: intervals as bars, the standard deviation over trials as a band.

    Args:
        table: The accuracies of a sweep.
        label: The label of the setting.
        chance: The accuracy expected from guessing, from 0 to 1.
    """
    names = ["estimator", "train_on", "hold_out"]
    several = [name for name in names if table[name].nunique() > 1] or ["hold_out"]
    # The curves are shifted a little, so that no bar hides another.
    curves = list(table.groupby(names, sort=False))
    apart = 0.008 * float(np.ptp(table["value"]))
    with styled():
        figure = new_figure(4.6, 3.0)
        axes = figure.add_subplot()
        for index, (_, rows) in enumerate(curves):
            x = rows["value"] + apart * (index - (len(curves) - 1) / 2)
            y, deviation = 100 * rows["accuracy"], 100 * rows["standard_deviation"].fillna(0.0)
            colour = COLOURS[index % len(COLOURS)]
            axes.fill_between(x, y - deviation, y + deviation, color=colour, alpha=0.2, lw=0)
            axes.plot(x, y, color=colour)
            _points(axes, x, rows, index, ", ".join(rows[several].iloc[0]))
        axes.set_xlabel(label)
        _chance(axes, chance)
        entries = {"bar: 95 % interval": "low", "band: standard deviation over the trials": "standard_deviation"}
        title = "; ".join(text for text, column in entries.items() if table[column].notna().any())
        figure.legend(loc="outside upper center", ncols=3, title=title or None)
    return figure
