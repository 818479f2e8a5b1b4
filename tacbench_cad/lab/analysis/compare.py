"""Two sensors' studies of the same textures side by side, with the smallest difference that their data can show.

The unit is the print. For each hold-out level and each texture, the accuracy on a print (the fraction of its readings
whose texture was predicted, mean over presses and trials) is one number. Where both sensors pressed the same prints
(run folders of one name), the difference of each print's two numbers is taken, which leaves out that some prints are
easier; else two independent samples are compared (Welch 1947). With SE the standard error of the mean difference and
its degrees of freedom f, the 95 % interval is ``difference +- t(0.975, f) SE``, and::

    smallest difference = (t(0.975, f) + t(0.8, f)) SE

is what a study like this one would find, at a level of 5 %, in four of five repetitions. SE is never below what the
number of presses allows: with h of n presses predicted rightly, p = (h + 1) / (n + 2), and each print's accuracy varies
by at least p (1 - p) / (presses of the print). Two sensors that are both always right are therefore not called equal.
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


#: Level of the intervals, and power of the smallest difference that can be shown.
LEVEL, POWER = 0.95, 0.80
#: ``texture`` of a row over all textures.
ALL_TEXTURES = "all"


def _prints(row: Row) -> str:
    return f"{row['prints_a']} pairs" if row["paired"] else f"{row['prints_a']}, {row['prints_b']}"


#: The columns of ``comparison.csv``.
COLUMNS = (
    Column("hold_out", head="held out"),
    Column("texture"),
    Column("accuracy_a", float, "A", text=percent),
    Column("accuracy_b", float, "B", text=percent),
    Column("difference", float, "B less A", text=lambda value: f"{100.0 * value:+.1f}"),
    Column("low", float),
    Column("high", float),
    Column("smallest_difference", float, "smallest shown", text=percent),
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
        value: Fraction of its readings whose texture was predicted, all trials.
        presses: Different presses.
    """

    value: float
    presses: int


#: By hold-out level and texture, then by print.
Accuracies = Mapping[tuple[str, str], Mapping[str, PrintAccuracy]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Side:
    """One sensor's classification.

    Args:
        name: What it is called in tables.
        record: What was asked for, and of which data.
        accuracies: The accuracy on each print.
    """

    name: str
    record: ClassificationRecord
    accuracies: Accuracies


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One line of the comparison; accuracies as fractions.

    Args:
        hold_out: Hold-out level.
        texture: Texture, or ``all``.
        accuracy_a: Mean over A's prints.
        accuracy_b: Mean over B's prints.
        difference: B less A: over the shared prints if paired.
        low: Lower end of its 95 % interval, None for fewer than two prints.
        high: Upper end.
        smallest_difference: What the data could show; None for fewer than two prints.
        paired: Whether both pressed the same prints.
        prints_a: Prints of A that count.
        prints_b: Prints of B.
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
        """Which is better, in a word or two."""
        if self.low is None or self.high is None:
            return "too few prints"
        return "B better" if self.low > 0.0 else "A better" if self.high < 0.0 else "not told apart"


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Two sensors side by side.

    Args:
        a: The first.
        b: The second.
        estimator: The estimator that both were classified with, or the names of both.
        rows: Lines by hold-out level: all textures, then each.
        notes: What a reader must know.
    """

    a: Side
    b: Side
    estimator: str
    rows: tuple[Difference, ...]
    notes: tuple[str, ...]

    @property
    def simulated(self) -> tuple[str, ...]:
        """What of either was simulated, each once."""
        return tuple(dict.fromkeys((*self.a.record.simulated, *self.b.record.simulated)))

    @property
    def table(self) -> Table:
        """The lines as they are stored in ``comparison.csv``."""
        return Table.of(COLUMNS, self.rows)

    @property
    def shown(self) -> Table:
        """The lines as people see them, each with which sensor is better."""
        table = Table.of((*COLUMNS, Column("verdict", head="")), self.rows)
        a, b = (
            f"{letter}: {side.name} ({side.record.sensor})" for letter, side in zip("AB", (self.a, self.b), strict=True)
        )
        return table.select(*_SHOWN, "verdict", title=f"{a}, {b}; per cent, {self.estimator}")

    def document(self) -> dict[str, Any]:
        """The values of ``--json``."""
        return {
            "a": {"name": self.a.name, "sensor": self.a.record.sensor},
            "b": {"name": self.b.name, "sensor": self.b.record.sensor},
            "estimator": self.estimator,
            "simulated": list(self.simulated),
            "notes": list(self.notes),
            "rows": Table.of((*COLUMNS, Column("verdict")), self.rows).records(),
        }


def read_side(folder: Path, name: str, estimator: str | None = None) -> tuple[Side, str]:
    """One sensor's classification from a folder of ``tacbench classify``.

    Args:
        folder: The folder.
        name: What it is called.
        estimator: The estimator to take; None: the first there is.

    Returns:
        The side and its estimator.

    Raises:
        InputError: The folder is not what ``tacbench classify --protocol leak-free`` wrote, or lacks the estimator.
    """
    record = ClassificationRecord.read(folder)
    if record.protocol != "leak-free":
        raise InputError("classification", str(folder), "must be of tacbench classify --protocol leak-free")
    chosen = estimator or record.estimators[0]
    if chosen not in record.estimators:
        raise InputError("estimator", chosen, f"{folder} has {', '.join(record.estimators)}")
    readings: dict[tuple[str, str, str], list[Row]] = defaultdict(list)
    for row in Table.read(folder / "predictions.csv", _PREDICTIONS).rows:
        if row["estimator"] == chosen:
            readings[row["hold_out"], row["texture"], row["run"]].append(row)
    if not readings:
        raise InputError("predictions", str(folder / "predictions.csv"), f"has no row of the estimator {chosen}")
    accuracies: dict[tuple[str, str], dict[str, PrintAccuracy]] = defaultdict(dict)
    for (hold_out, texture, run), rows in readings.items():
        right = sum(row["predicted"] == texture for row in rows)
        presses = len({row["press"] for row in rows})
        accuracies[hold_out, texture][run] = PrintAccuracy(right / len(rows), presses)
    return Side(name=name, record=record, accuracies=accuracies), chosen


def compare(a: Side, b: Side, estimator: str, *, same_prints: bool = True) -> Comparison:
    """Put two sensors side by side.

    Args:
        a: The first.
        b: The second.
        estimator: What both were classified with, or what each was.
        same_prints: Whether runs of one name are of the same print, and so are compared in pairs.

    Raises:
        InputError: They are of different textures, or have no hold-out level in common.
    """
    textures = a.record.textures
    if textures != b.record.textures:
        only = sorted(set(textures) ^ set(b.record.textures))
        raise InputError(
            "textures",
            ", ".join(only),
            f"only one of {a.name} and {b.name} has it; compare studies of the same textures",
        )
    common = {level for level, _ in b.accuracies}
    levels = [level for level in dict.fromkeys(level for level, _ in a.accuracies) if level in common]
    if not levels:
        raise InputError(
            "hold-out", None, f"{a.name} and {b.name} share no level; classify both with the same --hold-out"
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
    """Squared standard error of a mean, or of the difference of two, and its degrees of freedom (Welch 1947).

    There are none where a sample has a single print.
    """
    fewest = min(map(len, samples))
    if fewest < 2:
        return 0.0, 0.0
    parts = [float(values.var(ddof=1)) / len(values) for values in samples]
    total = sum(parts)
    if total == 0.0 or len(samples) == 1:
        return total, fewest - 1.0
    return total, total**2 / sum(part**2 / (len(values) - 1) for part, values in zip(parts, samples, strict=True))


def _min_variance(prints: Mapping[str, PrintAccuracy]) -> float:
    """Mean over prints of the smallest variance that the accuracy on a print can have with its number of presses."""
    values = []
    for accuracy in prints.values():
        p = (accuracy.value * accuracy.presses + 1.0) / (accuracy.presses + 2.0)
        values.append(p * (1.0 - p) / accuracy.presses)
    return float(np.mean(values))


def _notes(a: Side, b: Side, rows: Sequence[Difference]) -> list[str]:
    notes = []
    if rows[0].paired:
        notes.append(
            "the runs of both have the same names, so they are taken to be of the same prints, in pairs (not with "
            "--unpaired)"
        )
    else:
        notes.append(
            f"the sensors did not press the same prints ({rows[0].prints_a} and {rows[0].prints_b}): that prints "
            "differ counts against every difference; pressing the same prints with both shows smaller ones"
        )
    for key in ("resolution", "components", "augmentation", "folds", "trials", "copies", "seed"):
        of_a, of_b = (to_plain(getattr(side.record, key)) for side in (a, b))
        if of_a != of_b:
            notes.append(f"{key}: {of_a} for A, {of_b} for B")
    if any(row.smallest_difference is None for row in rows):
        notes.append("where a sensor has a single print of a texture at a hold-out level, no difference can be shown")
    notes.append(
        f"{len(rows)} differences are looked at: about one in twenty of those that are not there is shown by chance"
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
    """Accuracies on the left, differences of recall by texture on the right."""
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
        for line in (row for row in comparison.rows if row.hold_out == hold_out):
            y = labels.index(line.texture) + (i - (len(levels) - 1) / 2.0) * step
            colour = COLOURS[(i + 2) % (len(COLOURS) - 1)]
            if line.low is not None and line.high is not None:
                recall.plot([100.0 * line.low, 100.0 * line.high], [y, y], color=colour, linewidth=1.0)
            recall.plot(100.0 * line.difference, y, "o", color=colour, markersize=3.5)
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
