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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import t

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.classification.hold_out import shown_level, unit_name
from tacbench_cad.lab.analysis.figures import COLOURS, INK, PAGE_IN, new_figure, save_results, styled
from tacbench_cad.lab.analysis.tables import Shown, intervals, percent, records
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
#: The columns of ``comparison.csv``.
COLUMNS = [
    *("hold_out", "texture", "accuracy_a", "accuracy_b", "difference", "low", "high", "smallest_difference"),
    *("paired", "prints_a", "prints_b", "verdict"),
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """The comparison of two sensors.

    Args:
        a: The classification of the first sensor.
        b: The classification of the second sensor.
        names: The names of the sensors.
        estimators: The estimator of each classification.
        table: The rows of each hold-out level: first all textures, then each texture. Accuracies are means over the
            prints of each side, and ``difference`` is B minus A, with the ends ``low`` and ``high`` of its 95 %
            interval. ``smallest_difference`` is the smallest that the data can show. ``paired`` says whether the prints
            that both sensors pressed are compared in pairs, and no others.
        notes: Remarks that a reader must know.
    """

    a: Classification
    b: Classification
    names: tuple[str, str]
    estimators: tuple[str, str]
    table: pd.DataFrame
    notes: tuple[str, ...]

    @property
    def simulated(self) -> tuple[str, ...]:
        """The simulated parts of both studies, each part once."""
        return tuple(dict.fromkeys((*self.a.record.simulated, *self.b.record.simulated)))

    @property
    def unknown_groups(self) -> tuple[str, ...]:
        """The unknown groups of both classifications, see :attr:`.Design.unknown_groups`."""
        return tuple(dict.fromkeys((*self.a.record.unknown_groups, *self.b.record.unknown_groups)))

    @property
    def units(self) -> str:
        """The units of the intervals: ``prints``, or ``samples and recordings`` if both sides differ."""
        return " and ".join(dict.fromkeys(map(_unit, (self.a, self.b))))

    def shown(self) -> Iterator[tuple[str, Shown]]:
        """Yield the table for readers, with the name of its CSV file."""
        table = self.table
        counts = zip(table["paired"], table["prints_a"], table["prints_b"], strict=True)
        columns = {
            "held out": [shown_level(level, self.unknown_groups) for level in table["hold_out"]],
            "texture": table["texture"],
            "A": table["accuracy_a"].map(percent),
            "B": table["accuracy_b"].map(percent),
            "B minus A": table["difference"].map(lambda value: f"{100.0 * value:+.1f}"),
            "95 % interval": intervals(table, signed=True, empty=TOO_FEW),
            "detectable": table["smallest_difference"].map(percent),
            self.units: [f"{a} pairs" if paired else f"{a}, {b}" for paired, a, b in counts],
            "": table["verdict"],
        }
        estimators = " and ".join(dict.fromkeys(self.estimators))
        title = f"A: {self.names[0]}, B: {self.names[1]}; in %, {estimators}"
        yield "comparison", Shown(title, pd.DataFrame(columns))

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        sides = zip("ab", self.names, (self.a, self.b), strict=True)
        return {
            **{x: {"name": name, "sensor": side.record.sensor, "unit": _unit(side)} for x, name, side in sides},
            "estimator": " and ".join(dict.fromkeys(self.estimators)),
            "simulated": list(self.simulated),
            "notes": list(self.notes),
            "rows": records(self.table),
        }

    def figure(self) -> Figure:
        """Draw the accuracies on the left, and the differences of the recall of each texture on the right."""
        chance, labels = 100.0 * self.a.record.chance, [ALL_TEXTURES, *self.a.record.textures]
        levels = dict(list(self.table.groupby("hold_out", sort=False)))
        shown = [shown_level(str(level), self.unknown_groups) for level in levels]
        with styled():
            figure = new_figure(PAGE_IN, 0.9 + max(2.4, 0.42 * len(levels) * max(1, (len(labels) - 1) // 3)))
            accuracies, recall = figure.subplots(1, 2, width_ratios=(1.0, 1.35))
            whole = self.table[self.table["texture"] == ALL_TEXTURES]
            for j, (name, side) in enumerate(zip(self.names, "ab", strict=True)):
                x, y = np.arange(len(whole)) + 0.16 * (j - 0.5), 100.0 * whole[f"accuracy_{side}"]
                accuracies.plot(x, y, "os"[j], color=COLOURS[j], markersize=5.0, label=f"{'AB'[j]}: {name}")
            accuracies.axhline(chance, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
            accuracies.annotate("chance", (-0.48, chance), ha="left", va="bottom", fontsize=7.0)
            accuracies.set_xticks(range(len(levels)), [text.replace("-", "-\n").replace(", ", ",\n") for text in shown])
            accuracies.set(xlim=(-0.5, len(levels) - 0.5), ylim=(0.0, 104.0), ylabel="accuracy (%)")
            accuracies.set_title("by hold-out level", loc="left")
            for i, (text, rows) in enumerate(zip(shown, levels.values(), strict=True)):
                colour = COLOURS[(i + 2) % (len(COLOURS) - 1)]
                y = rows["texture"].map(labels.index) + (i - (len(levels) - 1) / 2.0) * 0.8 / len(levels)
                recall.hlines(y, 100.0 * rows["low"], 100.0 * rows["high"], color=colour, linewidth=1.0)
                recall.plot(100.0 * rows["difference"], y, "o", color=colour, markersize=3.5, label=text)
            recall.axvline(0.0, color=INK, linewidth=0.8)
            recall.set_yticks(range(len(labels)), [label.removeprefix("texture-") for label in labels])
            recall.set(xlabel="recall, B minus A (percentage points)", ylabel="texture")
            recall.invert_yaxis()
            recall.set_title(f"difference with 95 % interval over {self.units}", loc="left")
            figure.legend(loc="outside upper left", ncols=4)
        return figure

    def save(self, folder: str | Path) -> list[Path]:
        """Write ``comparison.csv`` and ``comparison`` as PNG and PDF into a folder.

        Raises:
            InputError: A file cannot be written.
            MissingToolError: matplotlib is not installed.
        """
        return save_results(folder, {"comparison": self.table}, {"comparison": self.figure()}, self.simulated)


def compare(
    a: Classification,
    b: Classification,
    *,
    estimators: tuple[str, str] | None = None,
    names: tuple[str, str] = ("A", "B"),
    same_prints: bool = True,
) -> Comparison:
    """Compare two sensors.

    Args:
        a: The classification of the first sensor, with the leak-free protocol.
        b: The classification of the second sensor.
        estimators: The estimator of each; None for the first estimator of A for both.
        names: The names of the sensors.
        same_prints: Whether runs with equal names used the same print; these are then compared in pairs. Samples and
            recordings are compared in pairs only if both classifications have the same data.

    Raises:
        InputError: A classification has another protocol or no such estimator, or the two have different textures or no
            hold-out level in common.
    """
    textures, both = a.record.textures, " and ".join(names)
    if textures != b.record.textures:
        only = ", ".join(sorted(set(textures) ^ set(b.record.textures)))
        raise InputError("textures", only, f"must be in both {both}; compare studies of the same textures")
    estimators = estimators or (a.settings.estimators[0],) * 2
    sides = [_accuracies(*each) for each in zip((a, b), names, estimators, strict=True)]
    keys = ["hold_out", "texture", "unit"]
    prints = sides[0].merge(sides[1], on=keys, how="outer", suffixes=("_a", "_b"), sort=False)
    levels = [level for level in sides[0]["hold_out"].unique() if level in set(sides[1]["hold_out"])]
    if not levels:
        raise InputError("hold-out", None, f"{both} have no level in common; classify both with the same --hold-out")
    unit = _unit(a)
    same_prints &= unit == _unit(b) and (unit == "prints" or a.record.data == b.record.data)
    rows: list[dict[str, Any]] = []
    notes: list[str] = []
    for level in levels:
        mine = prints[prints["hold_out"] == level]
        units = [set(mine["unit"][mine[f"value_{side}"].notna()]) for side in "ab"]
        shared = units[0] & units[1]
        paired = same_prints and len(shared) > 1 and 2 * len(shared) >= min(map(len, units))
        if paired:
            mine = mine.dropna()
            for name, own in zip(names, units, strict=True):
                if own - shared:
                    notes.append(f"{name} alone has the {unit} {_listed(sorted(own - shared))}; they are left out")
            lost = [texture for texture in textures if texture not in set(mine["texture"])]
            notes += [f"{texture}: no {unit[:-1]} was pressed by both sensors" for texture in lost]
        elif same_prints and shared:
            what = f"both sensors pressed only {len(shared)} of the {unit}, so all of them are compared as if they were"
            notes.append(f"{what} different")
        of_textures = {texture: mine[mine["texture"] == texture] for texture in textures}
        of_textures = {name: of for name, of in of_textures.items() if of[["value_a", "value_b"]].notna().any().all()}
        alike = [_samples(of, paired) for of in of_textures.values()]
        rows.append(_difference(mine, paired, [_samples(mine, paired)]) | {"hold_out": level, "texture": ALL_TEXTURES})
        for texture, of in of_textures.items():
            rows.append(_difference(of, paired, alike) | {"hold_out": level, "texture": texture})
    table = pd.DataFrame(rows, columns=COLUMNS).astype({"low": float, "high": float, "smallest_difference": float})
    shares = same_prints and bool(prints[["value_a", "value_b"]].notna().all(axis=1).any())
    notes = [*dict.fromkeys(notes), *_notes(a, b, table, shares)]
    return Comparison(a=a, b=b, names=names, estimators=estimators, table=table, notes=tuple(notes))


def _unit(side: Classification) -> str:
    """Return the unit of the intervals: ``prints``, or ``recordings`` or ``samples`` if the prints are unknown."""
    return unit_name("copy", side.record.unknown_groups)


def _accuracies(side: Classification, name: str, estimator: str) -> pd.DataFrame:
    """Return the accuracy on each print (``value``) and the number of its presses, by hold-out level and texture."""
    if side.settings.protocol != "leak-free":
        raise InputError("classification", name, "must be an output folder of tacbench classify --protocol leak-free")
    if estimator not in side.settings.estimators:
        known = ", ".join(side.settings.estimators)
        raise InputError("estimator", estimator, f"must be one of {known}, as in {name}")
    rows = side.predictions[side.predictions["estimator"] == estimator]
    unit = rows["run"] + " " + rows["press"].astype(str) if _unit(side) == "samples" else rows["run"]
    rows = rows.assign(unit=unit, value=rows["predicted"] == rows["texture"])
    found = rows.groupby(["hold_out", "texture", "unit"], sort=False)
    return found.agg(value=("value", "mean"), presses=("press", "nunique")).reset_index()


def _samples(prints: pd.DataFrame, paired: bool) -> list[tuple[Floats, float]]:
    """Return the numbers whose means are compared: the differences of pairs, or the accuracies of both sides.

    Each sample has the smallest variance that the numbers of presses allow.
    """
    (x, least_x), (y, least_y) = (
        (of.to_numpy()[:, 0], _min_variance(*of.to_numpy().T))
        for of in (prints[[f"value_{side}", f"presses_{side}"]].dropna() for side in "ab")
    )
    return [(y - x, least_x + least_y)] if paired else [(x, least_x), (y, least_y)]


def _difference(
    prints: pd.DataFrame, paired: bool, alike: Sequence[Sequence[tuple[Floats, float]]]
) -> dict[str, float | str | None]:
    """Return the row of some prints; ``alike`` has the samples of all textures that share their variance."""
    means, counts = prints[["value_a", "value_b"]].mean(), prints[["value_a", "value_b"]].count()
    difference = float(means["value_b"] - means["value_a"])
    low = high = smallest = None
    verdict, samples = TOO_FEW, [sample for sample, _ in _samples(prints, paired)]
    if min(map(len, samples)) > 1:
        common = [_common_variance(of_textures) for of_textures in zip(*alike, strict=True)]
        parts = [variance / len(sample) for (variance, _), sample in zip(common, samples, strict=True)]
        error = math.sqrt(sum(parts))
        dof = sum(parts) ** 2 / sum(part**2 / dof for part, (_, dof) in zip(parts, common, strict=True))
        reach, power = float(t.ppf(0.5 + LEVEL / 2.0, dof)), float(t.ppf(POWER, dof))
        low, high = max(-1.0, difference - reach * error), min(1.0, difference + reach * error)
        smallest = min(1.0, (reach + power) * error)
        verdict = "not shown" if abs(difference) < smallest else "B better" if difference > 0.0 else "A better"
        verdict = "not told apart" if low <= 0.0 <= high else verdict
    ends = {"low": low, "high": high, "smallest_difference": smallest, "verdict": verdict}
    sides = {"accuracy_a": means["value_a"], "accuracy_b": means["value_b"], "difference": difference}
    return {**sides, **ends, "paired": paired, "prints_a": counts["value_a"], "prints_b": counts["value_b"]}


def _common_variance(samples: Sequence[tuple[Floats, float]]) -> tuple[float, float]:
    """Return the common variance of some samples, in which each weighs by itself, and its degrees of freedom."""
    several = [(max(float(of.var(ddof=1)), least), len(of) - 1.0) for of, least in samples if len(of) > 1]
    total = sum(dof * variance for variance, dof in several)
    squares = sum(dof * variance**2 for variance, dof in several)
    return squares / total, total**2 / squares


def _min_variance(values: Floats, presses: Floats) -> float:
    """Return the smallest variance that the number of presses allows for the accuracy on a print, mean over prints."""
    correct, tested = values * presses, presses
    if presses.max() == 1.0:  # a single press says nothing about its own accuracy
        correct, tested = correct.sum(keepdims=True), presses.sum(keepdims=True)
    p = (correct + 1.0) / (tested + 2.0)
    return float(np.mean(p * (1.0 - p) / presses))


def _notes(a: Classification, b: Classification, table: pd.DataFrame, shares_prints: bool) -> Iterator[str]:
    """Yield the notes on how the sensors were compared."""
    unit = _unit(a)
    unknown = " and ".join(dict.fromkeys(name for name in map(_unit, (a, b)) if name != "prints"))
    if unknown:
        yield (
            f"the prints are unknown, so the {unknown} are compared as if they were independent: if several of them "
            "show one object, the intervals are too narrow"
        )
    elif table["paired"].any():
        yield (
            "the runs of both studies have the same names, so they are compared in pairs, as runs of the same prints; "
            "use --unpaired if the prints are different"
        )
    elif not shares_prints:
        yield (
            f"the sensors pressed different prints ({table['prints_a'][0]} and {table['prints_b'][0]}), so differences "
            "between prints make the intervals wider; smaller differences can be shown if both sensors press the same "
            "prints"
        )
    facts = [{**vars(side.settings), **vars(side.record)} for side in (a, b)]
    for key in ("features", "steps", "components", "augmentation", "folds", "trials", "copies", "seed"):
        if facts[0][key] != facts[1][key]:
            yield f"{key}: {to_plain(facts[0][key])} for A, {to_plain(facts[1][key])} for B"
    if table["smallest_difference"].isna().any():
        yield f"no difference can be shown for a texture with a single one of the {unit} at a hold-out level"
    yield (
        f"the table has {len(table)} differences; if the sensors are equally good, about one in twenty intervals "
        "excludes zero by chance"
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_MAX_NAMES]) + (f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else "")
