"""The comparison of two sensors that pressed the same textures, with the smallest difference that the data can show.

The unit is the print. For each hold-out level and each texture, the accuracy on a print (the fraction of its frames
whose texture was predicted, mean over presses and trials) is one number. If the prints of imported samples are unknown,
the unit is the recording, or else the sample.

- If both sensors pressed the same prints (run folders with equal names), the difference of the two numbers of each
  print is used. This removes the effect that some prints are easier than others. Prints that only one of the sensors
  pressed are left out.
- Otherwise two independent samples are compared (Welch 1947). This is also done if most prints of both sensors would be
  left out.

All textures of a hold-out level have one variance between prints, so the verdict depends only on the difference if the
textures have equally many prints. It is the mean of the textures' variances, in which each weighs by itself: textures
that both sensors always predict correctly do not make the others look certain. The row over all textures has its own.

With the standard error SE of the mean difference and its degrees of freedom f, the 95 % interval is
``difference +- t(0.975, f) SE``. The smallest difference is ::

    smallest difference = (t(0.975, f) + t(0.8, f)) SE

In four of five studies like this one, the interval of such a difference excludes 0. A sensor is called better only if
the interval excludes 0 and the difference is at least as large as this.

SE has a lower limit that follows from the number of presses. If h of n presses are predicted correctly, then
p = (h + 1) / (n + 2), and the variance of the accuracy on each print is at least p (1 - p) / (presses of the print).
Two sensors that are both always correct are therefore not called equal. The h and n are those of the print, or of all
samples of a texture if the unit is the sample.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.comparison_sides import PrintAccuracy, Side
from tacbench_cad.lab.analysis.tables import Shown, frame_of, intervals, percent, records, write_csv
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The level of the intervals, and the power for the smallest difference.
LEVEL, POWER = 0.95, 0.80
#: The largest number of prints that a note names.
_MAX_NAMES = 6
#: The value of ``texture`` in a row over all textures.
ALL_TEXTURES = "all"


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One row of the comparison; accuracies are fractions.

    Args:
        hold_out: The hold-out level.
        texture: The texture, or ``all``.
        accuracy_a: The mean accuracy over A's prints.
        accuracy_b: The mean accuracy over B's prints.
        difference: B minus A.
        low: The lower end of its 95 % interval; None for fewer than two prints.
        high: The upper end of its 95 % interval; None for fewer than two prints.
        smallest_difference: The smallest difference that the data can show; None for fewer than two prints.
        paired: Whether the prints that both sensors pressed are compared in pairs, and no others.
        prints_a: The number of A's prints in the comparison; see ``Side.unit`` if prints are unknown.
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
        if self.low is None or self.high is None or self.smallest_difference is None:
            return TOO_FEW
        if self.low <= 0.0 <= self.high:
            return "not told apart"
        if abs(self.difference) < self.smallest_difference:
            return "not shown"
        return "B better" if self.difference > 0.0 else "A better"


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
    def table(self) -> pd.DataFrame:
        """The rows as they are stored in ``comparison.csv``."""
        return frame_of(self.rows, [field.name for field in fields(Difference)])

    @property
    def shown(self) -> Shown:
        """The rows as they are printed, with the better sensor of each row."""
        table = self.table
        prints = [f"{row.prints_a} pairs" if row.paired else f"{row.prints_a}, {row.prints_b}" for row in self.rows]
        frame = pd.DataFrame(
            {
                "held out": [shown_level(level, self.unknown_groups) for level in table["hold_out"]],
                "texture": table["texture"],
                "A": table["accuracy_a"].map(percent),
                "B": table["accuracy_b"].map(percent),
                "B minus A": table["difference"].map(lambda value: f"{100.0 * value:+.1f}"),
                "95 % interval": intervals(table, signed=True, empty=TOO_FEW),
                "detectable": table["smallest_difference"].map(percent),
                self.units: prints,
                "": [row.verdict for row in self.rows],
            }
        )
        return Shown(f"A: {self.a.name}, B: {self.b.name}; in %, {self.estimator}", frame)

    @property
    def unknown_groups(self) -> tuple[str, ...]:
        """The unknown groups of both classifications, see :attr:`.Collection.unknown_groups`."""
        return tuple(dict.fromkeys((*self.a.record.unknown_groups, *self.b.record.unknown_groups)))

    @property
    def units(self) -> str:
        """The units of the intervals: ``prints``, or ``samples and recordings`` if both sides differ."""
        return " and ".join(dict.fromkeys((self.a.unit, self.b.unit)))

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        return {
            **{
                letter: {"name": side.name, "sensor": side.record.sensor, "unit": side.unit}
                for letter, side in zip("ab", (self.a, self.b), strict=True)
            },
            "estimator": self.estimator,
            "simulated": list(self.simulated),
            "notes": list(self.notes),
            "rows": records(self.table.assign(verdict=[row.verdict for row in self.rows])),
        }

    def figure(self) -> Figure:
        """Draw the accuracies on the left, and the differences of the recall of each texture on the right."""
        from tacbench_cad.lab.analysis.figures import COLOURS, INK, PAGE_IN, new_figure

        levels = list(dict.fromkeys(row.hold_out for row in self.rows))
        shown = {level: shown_level(level, self.unknown_groups) for level in levels}
        textures = self.a.record.textures
        figure = new_figure(PAGE_IN, 0.9 + max(2.4, 0.42 * len(levels) * max(1, len(textures) // 3)))
        accuracies, recall = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
        whole = {row.hold_out: row for row in self.rows if row.texture == ALL_TEXTURES}
        for i, hold_out in enumerate(levels):
            for j, accuracy in enumerate((whole[hold_out].accuracy_a, whole[hold_out].accuracy_b)):
                accuracies.plot(i + 0.16 * (j - 0.5), 100.0 * accuracy, "os"[j], color=COLOURS[j], markersize=5.0)
        accuracies.axhline(100.0 / len(textures), color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        accuracies.annotate("chance", (-0.48, 100.0 / len(textures)), ha="left", va="bottom", fontsize=7.0)
        accuracies.set_xticks(
            range(len(levels)), [text.replace("-", "-\n").replace(", ", ",\n") for text in shown.values()]
        )
        accuracies.set(xlim=(-0.5, len(levels) - 0.5), ylim=(0.0, 104.0), ylabel="accuracy (%)")
        accuracies.set_title("by hold-out level", loc="left")
        step = 0.8 / len(levels)
        labels = [ALL_TEXTURES, *textures]
        for i, hold_out in enumerate(levels):
            colour = COLOURS[(i + 2) % (len(COLOURS) - 1)]
            for row in (row for row in self.rows if row.hold_out == hold_out):
                y = labels.index(row.texture) + (i - (len(levels) - 1) / 2.0) * step
                if row.low is not None and row.high is not None:
                    recall.plot([100.0 * row.low, 100.0 * row.high], [y, y], color=colour, linewidth=1.0)
                recall.plot(100.0 * row.difference, y, "o", color=colour, markersize=3.5)
            recall.plot([], [], "o-", color=colour, markersize=3.5, label=shown[hold_out])
        recall.axvline(0.0, color=INK, linewidth=0.8)
        recall.set_yticks(range(len(labels)), [label.removeprefix("texture-") for label in labels])
        recall.set(xlabel="recall, B minus A (percentage points)", ylabel="texture")
        recall.invert_yaxis()
        recall.set_title(f"difference with 95 % interval over {self.units}", loc="left")
        for j, side in enumerate((self.a, self.b)):
            accuracies.plot([], [], "os"[j], color=COLOURS[j], markersize=5.0, label=f"{'AB'[j]}: {side.name}")
        handles = [*accuracies.get_legend_handles_labels()[0], *recall.get_legend_handles_labels()[0]]
        figure.legend(handles=handles, loc="outside upper left", ncols=4)
        return figure

    def save(self, folder: Path) -> list[Path]:
        """Write ``comparison.csv`` and ``comparison`` as PNG and PDF into an existing folder.

        Raises:
            InputError: A file cannot be written.
            MissingToolError: matplotlib is not installed.
        """
        from tacbench_cad.lab.analysis.figures import save, styled

        path = write_csv(folder / "comparison.csv", self.table, self.simulated)
        with styled():
            return [path, *save(self.figure(), folder / "comparison", self.simulated)]


def compare(a: Side, b: Side, estimator: str, *, same_prints: bool = True) -> Comparison:
    """Compare two sensors.

    Args:
        a: The first sensor.
        b: The second sensor.
        estimator: The estimator of both classifications, or the names of two different ones.
        same_prints: Whether runs with equal names used the same print; these are then compared in pairs. Samples and
            recordings are compared in pairs only if both classifications have the same data.

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
    same_prints &= a.unit == b.unit and (a.unit == "prints" or a.record.data == b.record.data)
    rows, notes = [], []
    for hold_out in levels:
        of_a, of_b = ({t: dict(side.accuracies.get((hold_out, t), {})) for t in textures} for side in (a, b))
        units = [{unit for accuracies in of.values() for unit in accuracies} for of in (of_a, of_b)]
        shared = units[0] & units[1]
        paired = same_prints and len(shared) > 1 and 2 * len(shared) >= min(map(len, units))
        if paired:
            lost = [t for t in textures if of_a[t] and of_b[t] and not of_a[t].keys() & of_b[t].keys()]
            of_a, of_b = ({t: {u: x for u, x in s[t].items() if u in shared} for t in textures} for s in (of_a, of_b))
            notes += [
                f"{side.name} alone has the {side.unit} {_listed(sorted(own - shared))}; they are left out"
                for side, own in zip((a, b), units, strict=True)
                if own - shared
            ]
            notes += [f"{t}: no {a.unit[:-1]} was pressed by both sensors" for t in lost]
        elif same_prints and shared:
            notes.append(
                f"both sensors pressed only {len(shared)} of the {a.unit}, so all of them are compared as if they were "
                "different"
            )
        tables = [_pairs(of_a[t], of_b[t], paired) for t in textures if of_a[t] and of_b[t]]
        every_a, every_b = ({u: x for of in side.values() for u, x in of.items()} for side in (of_a, of_b))
        whole = _pairs(every_a, every_b, paired)
        rows.append(_difference(hold_out, ALL_TEXTURES, whole, [whole]))
        names = [t for t in textures if of_a[t] and of_b[t]]
        rows += [_difference(hold_out, t, pairs, tables) for t, pairs in zip(names, tables, strict=True)]
    notes = [*dict.fromkeys(notes), *_notes(a, b, rows, same_prints)]
    return Comparison(a=a, b=b, estimator=estimator, rows=tuple(rows), notes=tuple(notes))


class _Pairs(NamedTuple):
    """The accuracies on the prints of one texture, and what is compared.

    Args:
        a: A's accuracies, (n,).
        b: B's accuracies, (m,); for pairs in the order of ``a``.
        samples: The numbers whose means are compared: the differences of pairs, or both accuracies.
        smallest: The smallest variance of each sample that the numbers of presses allow.
    """

    a: Floats
    b: Floats
    samples: tuple[Floats, ...]
    smallest: tuple[float, ...]


def _pairs(a: Mapping[str, PrintAccuracy], b: Mapping[str, PrintAccuracy], paired: bool) -> _Pairs:
    order = list(a) if paired else list(b)
    x, y = np.array([accuracy.value for accuracy in a.values()]), np.array([b[unit].value for unit in order])
    smallest = _min_variance(a), _min_variance(b)
    return _Pairs(x, y, (y - x,), (sum(smallest),)) if paired else _Pairs(x, y, (x, y), smallest)


def _difference(hold_out: str, texture: str, pairs: _Pairs, tables: Sequence[_Pairs]) -> Difference:
    """Compare the accuracies of one texture; ``tables`` has all textures that share their variance."""
    difference = float(pairs.b.mean() - pairs.a.mean())
    low = high = shown = None
    if min(map(len, pairs.samples)) > 1:
        from scipy.stats import t

        samples = zip(*(zip(each.samples, each.smallest, strict=True) for each in tables), strict=True)
        common = [_common_variance(of_textures) for of_textures in samples]
        parts = [variance / len(sample) for (variance, _), sample in zip(common, pairs.samples, strict=True)]
        error = math.sqrt(sum(parts))
        dof = sum(parts) ** 2 / sum(part**2 / dof for part, (_, dof) in zip(parts, common, strict=True))
        reach, power = float(t.ppf(0.5 + LEVEL / 2.0, dof)), float(t.ppf(POWER, dof))
        low, high = max(-1.0, difference - reach * error), min(1.0, difference + reach * error)
        shown = min(1.0, (reach + power) * error)
    return Difference(
        hold_out=hold_out,
        texture=texture,
        accuracy_a=float(pairs.a.mean()),
        accuracy_b=float(pairs.b.mean()),
        difference=difference,
        low=low,
        high=high,
        smallest_difference=shown,
        paired=len(pairs.samples) == 1,
        prints_a=len(pairs.a),
        prints_b=len(pairs.b),
    )


def _common_variance(samples: Sequence[tuple[Floats, float]]) -> tuple[float, float]:
    """Return the common variance of some samples, in which each weighs by itself, and its degrees of freedom."""
    several = [(max(float(of.var(ddof=1)), least), len(of) - 1.0) for of, least in samples if len(of) > 1]
    total = sum(dof * variance for variance, dof in several)
    squares = sum(dof * variance**2 for variance, dof in several)
    return squares / total, total**2 / squares


def _min_variance(prints: Mapping[str, PrintAccuracy]) -> float:
    """Return the smallest variance that the number of presses allows for the accuracy on a print, mean over prints."""
    values, presses = np.array(list(prints.values()), dtype=np.float64).T
    correct, tested = values * presses, presses
    if presses.max() == 1.0:  # a single press says nothing about its own accuracy
        correct, tested = correct.sum(), presses.sum()
    p = (correct + 1.0) / (tested + 2.0)
    return float(np.mean(p * (1.0 - p) / presses))


def _notes(a: Side, b: Side, rows: Sequence[Difference], same_prints: bool) -> list[str]:
    notes = []
    unknown = " and ".join(dict.fromkeys(side.unit for side in (a, b) if side.unit != "prints"))
    if unknown:
        notes.append(
            f"the prints are unknown, so the {unknown} are compared as if they were independent: if several of them "
            "show one object, the intervals are too narrow"
        )
    elif any(row.paired for row in rows):
        notes.append(
            "the runs of both studies have the same names, so they are compared in pairs, as runs of the same prints; "
            "use --unpaired if the prints are different"
        )
    elif not same_prints or not _has_shared_prints(a, b):
        notes.append(
            f"the sensors pressed different prints ({rows[0].prints_a} and {rows[0].prints_b}), so differences between "
            "prints make the intervals wider; smaller differences can be shown if both sensors press the same prints"
        )
    for key in ("features", "series", "resolution", "components", "augmentation", "folds", "trials", "copies", "seed"):
        of_a, of_b = (to_plain(getattr(side.record, key)) for side in (a, b))
        if of_a != of_b:
            notes.append(f"{key}: {of_a} for A, {of_b} for B")
    if any(row.smallest_difference is None for row in rows):
        notes.append(f"no difference can be shown for a texture with a single one of the {a.unit} at a hold-out level")
    notes.append(
        f"the table has {len(rows)} differences; if the sensors are equally good, about one in twenty intervals "
        "excludes zero by chance"
    )
    return notes


def _has_shared_prints(a: Side, b: Side) -> bool:
    return any(prints.keys() & b.accuracies.get(key, {}).keys() for key, prints in a.accuracies.items())


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_MAX_NAMES]) + (f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else "")
