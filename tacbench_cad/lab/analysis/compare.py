"""The comparison of two sensors that pressed the same textures, with the smallest difference that the data can show.

The unit is the print. For each hold-out level and each texture, the accuracy on a print (the fraction of its frames
whose texture was predicted, mean over presses and trials) is one number.

- If both sensors pressed the same prints (run folders with equal names), the difference of the two numbers of each
  print is used. This removes the effect that some prints are easier than others.
- Otherwise two independent samples are compared (Welch 1947).

With the standard error SE of the mean difference and its degrees of freedom f, the 95 % interval is
``difference +- t(0.975, f) SE``. The smallest difference is ::

    smallest difference = (t(0.975, f) + t(0.8, f)) SE

A study like this one would detect it, at a level of 5 %, in four of five repetitions.

SE has a lower limit that follows from the number of presses. If h of n presses are predicted correctly, then
p = (h + 1) / (n + 2), and the variance of the accuracy on each print is at least p (1 - p) / (presses of the print).
Two sensors that are both always correct are therefore not called equal.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.tables import Column, Row, Table, interval_column, percent, truth
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: The level of the intervals, and the power for the smallest difference.
LEVEL, POWER = 0.95, 0.80
#: The value of ``texture`` in a row over all textures.
ALL_TEXTURES = "all"


def _prints(row: Row) -> str:
    return f"{row['prints_a']} pairs" if row["paired"] else f"{row['prints_a']}, {row['prints_b']}"


#: The columns of ``comparison.csv``.
COLUMNS = (
    Column("hold_out", head="held out"),
    Column("texture"),
    Column("accuracy_a", float, "A", text=percent),
    Column("accuracy_b", float, "B", text=percent),
    Column("difference", float, "B minus A", text=lambda value: f"{100.0 * value:+.1f}"),
    Column("low", float),
    Column("high", float),
    Column("smallest_difference", float, "detectable", text=percent),
    Column("paired", truth),
    Column("prints_a", int),
    Column("prints_b", int),
)
_SHOWN = (
    *("hold_out", "texture", "accuracy_a", "accuracy_b", "difference"),
    *(interval_column(signed=True), "smallest_difference"),
    Column("prints", derived=_prints, right=True),
)
_PREDICTIONS = tuple(Column(name) for name in ("estimator", "hold_out", "run", "press", "texture", "predicted"))


class PrintAccuracy(NamedTuple):
    """The accuracy on one print.

    Args:
        value: The fraction of its frames whose texture was predicted, over all trials.
        presses: The number of different presses.
    """

    value: float
    presses: int


#: Accuracies by hold-out level and texture, then by print.
Accuracies = Mapping[tuple[str, str], Mapping[str, PrintAccuracy]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """The classification of one sensor's study.

    Args:
        name: The name of the sensor in tables.
        record: The settings and the data of the classification.
        accuracies: The accuracy on each print.
    """

    name: str
    record: ClassificationRecord
    accuracies: Accuracies


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One row of the comparison; accuracies are fractions.

    Args:
        hold_out: The hold-out level.
        texture: The texture, or ``all``.
        accuracy_a: The mean accuracy over A's prints.
        accuracy_b: The mean accuracy over B's prints.
        difference: B minus A, over the shared prints if paired.
        low: The lower end of its 95 % interval; None for fewer than two prints.
        high: The upper end of its 95 % interval; None for fewer than two prints.
        smallest_difference: The smallest difference that the data can show; None for fewer than two prints.
        paired: Whether both sensors pressed the same prints.
        prints_a: The number of A's prints in the comparison.
        prints_b: The number of B's prints in the comparison.
    """

    hold_out: str
    texture: str
    accuracy_a: float
    accuracy_b: float
    difference: float
    low: float | None
    high: float | None
    smallest_difference: float | None
    paired: bool
    prints_a: int
    prints_b: int

    @property
    def verdict(self) -> str:
        """The better sensor, in a few words."""
        if self.low is None or self.high is None:
            return "too few prints"
        return "B better" if self.low > 0.0 else "A better" if self.high < 0.0 else "not told apart"


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """The comparison of two sensors.

    Args:
        a: The first sensor.
        b: The second sensor.
        estimator: The estimator of both classifications, or the names of two different ones.
        rows: The rows of each hold-out level: first all textures, then each texture.
        notes: Remarks that a reader must know.
    """

    a: Side
    b: Side
    estimator: str
    rows: tuple[Difference, ...]
    notes: tuple[str, ...]

    @property
    def simulated(self) -> tuple[str, ...]:
        """The simulated parts of both studies, each part once."""
        return tuple(dict.fromkeys((*self.a.record.simulated, *self.b.record.simulated)))

    @property
    def table(self) -> Table:
        """The rows as they are stored in ``comparison.csv``."""
        return Table.of(COLUMNS, self.rows)

    @property
    def shown(self) -> Table:
        """The rows as they are printed, with the better sensor of each row."""
        table = Table.of((*COLUMNS, Column("verdict", head="")), self.rows)
        a, b = (
            f"{letter}: {side.name} ({side.record.sensor})" for letter, side in zip("AB", (self.a, self.b), strict=True)
        )
        return table.select(*_SHOWN, "verdict", title=f"{a}, {b}; in %, {self.estimator}")

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        return {
            "a": {"name": self.a.name, "sensor": self.a.record.sensor},
            "b": {"name": self.b.name, "sensor": self.b.record.sensor},
            "estimator": self.estimator,
            "simulated": list(self.simulated),
            "notes": list(self.notes),
            "rows": Table.of((*COLUMNS, Column("verdict")), self.rows).records(),
        }


def read_side(folder: Path, name: str, estimator: str | None = None) -> tuple[Side, str]:
    """Read the classification of one sensor from an output folder of ``tacbench classify``.

    Args:
        folder: The folder.
        name: The name of the sensor in tables.
        estimator: The estimator to compare; None for the first one.

    Returns:
        The classification and the name of its estimator.

    Raises:
        InputError: The folder is not an output folder of ``tacbench classify --protocol leak-free``, or it has no
            results of the estimator.
    """
    record = ClassificationRecord.read(folder)
    if record.protocol != "leak-free":
        raise InputError(
            "classification", str(folder), "must be an output folder of tacbench classify --protocol leak-free"
        )
    chosen = estimator or record.estimators[0]
    if chosen not in record.estimators:
        raise InputError("estimator", chosen, f"must be one of {', '.join(record.estimators)}, as in {folder}")
    predictions: dict[tuple[str, str, str], list[Row]] = defaultdict(list)
    for row in Table.read(folder / "predictions.csv", _PREDICTIONS).rows:
        if row["estimator"] == chosen:
            predictions[row["hold_out"], row["texture"], row["run"]].append(row)
    if not predictions:
        raise InputError("predictions", str(folder / "predictions.csv"), f"has no row of the estimator {chosen}")
    accuracies: dict[tuple[str, str], dict[str, PrintAccuracy]] = defaultdict(dict)
    for (hold_out, texture, run), rows in predictions.items():
        correct = sum(row["predicted"] == texture for row in rows)
        presses = len({row["press"] for row in rows})
        accuracies[hold_out, texture][run] = PrintAccuracy(correct / len(rows), presses)
    return Side(name=name, record=record, accuracies=accuracies), chosen


def compare(a: Side, b: Side, estimator: str, *, same_prints: bool = True) -> Comparison:
    """Compare two sensors.

    Args:
        a: The first sensor.
        b: The second sensor.
        estimator: The estimator of both classifications, or the names of two different ones.
        same_prints: Whether runs with equal names used the same print; these are then compared in pairs.

    Raises:
        InputError: The studies have different textures, or no hold-out level in common.
    """
    textures = a.record.textures
    if textures != b.record.textures:
        only = sorted(set(textures) ^ set(b.record.textures))
        raise InputError(
            "textures",
            ", ".join(only),
            f"must be in both {a.name} and {b.name}; compare studies of the same textures",
        )
    common = {level for level, _ in b.accuracies}
    levels = [level for level in dict.fromkeys(level for level, _ in a.accuracies) if level in common]
    if not levels:
        raise InputError(
            "hold-out", None, f"{a.name} and {b.name} have no level in common; classify both with the same --hold-out"
        )
    rows = []
    for hold_out in levels:
        of_a, of_b = ({t: side.accuracies.get((hold_out, t), {}) for t in textures} for side in (a, b))
        every_a, every_b = (
            {run: accuracy for of in side.values() for run, accuracy in of.items()} for side in (of_a, of_b)
        )
        rows.append(_difference(hold_out, ALL_TEXTURES, every_a, every_b, same_prints))
        rows += [_difference(hold_out, t, of_a[t], of_b[t], same_prints) for t in textures if of_a[t] and of_b[t]]
    return Comparison(a=a, b=b, estimator=estimator, rows=tuple(rows), notes=tuple(_notes(a, b, rows)))


def _difference(
    hold_out: str, texture: str, a: Mapping[str, PrintAccuracy], b: Mapping[str, PrintAccuracy], same_prints: bool
) -> Difference:
    paired = same_prints and a.keys() == b.keys()
    x, y = (np.array([accuracy.value for accuracy in side.values()]) for side in (a, b))
    if paired:
        y = np.array([b[run].value for run in a])
        smallest = (_min_variance(a) + _min_variance(b)) / len(a)
        error, dof = _error(y - x)
    else:
        smallest = _min_variance(a) / len(a) + _min_variance(b) / len(b)
        error, dof = _error(x, y)
    difference = float(y.mean() - x.mean())
    low = high = shown = None
    if dof > 0.0:
        from scipy.stats import t

        error = math.sqrt(max(error, smallest))
        reach, power = float(t.ppf(0.5 + LEVEL / 2.0, dof)), float(t.ppf(POWER, dof))
        low, high = max(-1.0, difference - reach * error), min(1.0, difference + reach * error)
        shown = min(1.0, (reach + power) * error)
    return Difference(
        hold_out=hold_out,
        texture=texture,
        accuracy_a=float(x.mean()),
        accuracy_b=float(y.mean()),
        difference=difference,
        low=low,
        high=high,
        smallest_difference=shown,
        paired=paired,
        prints_a=len(a),
        prints_b=len(b),
    )


def _error(*samples: Floats) -> tuple[float, float]:
    """Return the squared standard error of a mean, or of the difference of two means, and its degrees of freedom.

    The degrees of freedom are those of Welch (1947); they are 0 if a sample has a single print.
    """
    smallest = min(map(len, samples))
    if smallest < 2:
        return 0.0, 0.0
    parts = [float(values.var(ddof=1)) / len(values) for values in samples]
    total = sum(parts)
    if total == 0.0 or len(samples) == 1:
        return total, smallest - 1.0
    return total, total**2 / sum(part**2 / (len(values) - 1) for part, values in zip(parts, samples, strict=True))


def _min_variance(prints: Mapping[str, PrintAccuracy]) -> float:
    """Return the smallest variance that the number of presses allows for the accuracy on a print, mean over prints."""
    values = []
    for accuracy in prints.values():
        p = (accuracy.value * accuracy.presses + 1.0) / (accuracy.presses + 2.0)
        values.append(p * (1.0 - p) / accuracy.presses)
    return float(np.mean(values))


def _notes(a: Side, b: Side, rows: Sequence[Difference]) -> list[str]:
    notes = []
    if rows[0].paired:
        notes.append(
            "the runs of both studies have the same names, so they are compared in pairs, as runs of the same prints; "
            "use --unpaired if the prints are different"
        )
    else:
        notes.append(
            f"the sensors pressed different prints ({rows[0].prints_a} and {rows[0].prints_b}), so differences between "
            "prints make the intervals wider; smaller differences can be shown if both sensors press the same prints"
        )
    for key in ("features", "series", "resolution", "components", "augmentation", "folds", "trials", "copies", "seed"):
        of_a, of_b = (to_plain(getattr(side.record, key)) for side in (a, b))
        if of_a != of_b:
            notes.append(f"{key}: {of_a} for A, {of_b} for B")
    if any(row.smallest_difference is None for row in rows):
        notes.append("no difference can be shown for a texture with a single print at a hold-out level")
    notes.append(
        f"the table has {len(rows)} differences; if the sensors are equally good, about one in twenty intervals "
        "excludes zero by chance"
    )
    return notes


def write_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write ``comparison.csv`` and ``comparison`` as PNG and PDF.

    Args:
        comparison: The comparison.
        folder: The folder, which must exist.

    Raises:
        InputError: A file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    from tacbench_cad.lab.analysis.figures import save, styled

    path = comparison.table.write(folder / "comparison.csv", comparison.simulated)
    with styled():
        return [path, *save(_figure(comparison), folder / "comparison", comparison.simulated)]


def _figure(comparison: Comparison) -> Figure:
    """Draw the accuracies on the left, and the differences of the recall of each texture on the right."""
    from tacbench_cad.lab.analysis.figures import COLOURS, INK, PAGE_IN, new_figure

    levels = list(dict.fromkeys(row.hold_out for row in comparison.rows))
    textures = comparison.a.record.textures
    figure = new_figure(PAGE_IN, 0.9 + max(2.4, 0.42 * len(levels) * max(1, len(textures) // 3)))
    accuracies, recall = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
    whole = {row.hold_out: row for row in comparison.rows if row.texture == ALL_TEXTURES}
    for i, hold_out in enumerate(levels):
        for j, accuracy in enumerate((whole[hold_out].accuracy_a, whole[hold_out].accuracy_b)):
            accuracies.plot(i + 0.16 * (j - 0.5), 100.0 * accuracy, "os"[j], color=COLOURS[j], markersize=5.0)
    accuracies.axhline(100.0 / len(textures), color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    accuracies.annotate("chance", (-0.48, 100.0 / len(textures)), ha="left", va="bottom", fontsize=7.0)
    accuracies.set_xticks(range(len(levels)), [level.replace("-", "-\n") for level in levels])
    accuracies.set(xlim=(-0.5, len(levels) - 0.5), ylim=(0.0, 104.0), ylabel="accuracy (%)")
    accuracies.set_title("by hold-out level", loc="left")
    step = 0.8 / len(levels)
    labels = [ALL_TEXTURES, *textures]
    for i, hold_out in enumerate(levels):
        for row in (row for row in comparison.rows if row.hold_out == hold_out):
            y = labels.index(row.texture) + (i - (len(levels) - 1) / 2.0) * step
            colour = COLOURS[(i + 2) % (len(COLOURS) - 1)]
            if row.low is not None and row.high is not None:
                recall.plot([100.0 * row.low, 100.0 * row.high], [y, y], color=colour, linewidth=1.0)
            recall.plot(100.0 * row.difference, y, "o", color=colour, markersize=3.5)
        recall.plot([], [], "o-", color=COLOURS[(i + 2) % (len(COLOURS) - 1)], markersize=3.5, label=hold_out)
    recall.axvline(0.0, color=INK, linewidth=0.8)
    recall.set_yticks(range(len(labels)), [label.removeprefix("texture-") for label in labels])
    recall.set(xlabel="recall, B minus A (percentage points)", ylabel="texture")
    recall.invert_yaxis()
    recall.set_title("difference with 95 % interval over prints", loc="left")
    for j, side in enumerate((comparison.a, comparison.b)):
        accuracies.plot([], [], "os"[j], color=COLOURS[j], markersize=5.0, label=f"{'AB'[j]}: {side.name}")
    handles = [*accuracies.get_legend_handles_labels()[0], *recall.get_legend_handles_labels()[0]]
    figure.legend(handles=handles, loc="outside upper left", ncols=4)
    return figure
