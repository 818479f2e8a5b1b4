"""Score the predictions of any classifier against a split file.

Predictions are a CSV file with a header and one row for each press that a fold tests. These columns are read, in any
order; others are ignored:

=============== =====================================================================================
``fold``        name of the fold in the split file
``run``         name of the run, as in the split file
``force_level`` ``repeat``, ``position``: the press key, whole numbers from 1
``predicted``   name of the texture, as in the split file: ``texture-4``
=============== =====================================================================================

The unit of the interval is the print: presses of one print are similar, so a thousand presses of six prints contain
little more information than six trials. All rows have the same correlation of the presses of one print, see
:mod:`tacbench_cad.lab.analysis.classification.accuracy_intervals`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW, correlation_of, interval_of
from tacbench_cad.lab.analysis.classification.split_files import Split, named
from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.tables import Shown, intervals, percent
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Ints
from tacbench_cad.util.untrusted import read_table

#: The columns that a file of predictions must have.
COLUMNS = ("fold", "run", "force_level", "repeat", "position", "predicted")


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """The accuracy over some presses.

    Args:
        fraction: The fraction of presses predicted correctly.
        low: The lower end of the 95 % interval; None if there are too few prints.
        high: The upper end of the 95 % interval; None if there are too few prints.
        right: The number of presses predicted correctly.
        presses: The number of presses.
        prints: The number of different prints.
    """

    fraction: float
    low: float | None
    high: float | None
    right: int
    presses: int
    prints: int


class PredictionFault(NamedTuple):
    """A prediction that is missing, doubled or unknown.

    Args:
        kind: ``missing``, ``doubled`` or ``unknown``.
        text: The line or press, and the reason.
    """

    kind: str
    text: str


class PredictionsError(CheckFailedError):
    """Predictions do not fit their split.

    Args:
        path: The file of predictions.
        faults: All faults.
    """

    def __init__(self, path: Path, faults: Sequence[PredictionFault]) -> None:
        self.path, self.faults = path, tuple(faults)
        kinds = Counter(fault.kind for fault in faults)
        counts = ", ".join(f"{count:,} {kind}" for kind, count in kinds.items())
        super().__init__(f"{path}: predictions do not fit the split: {counts}; the first: {faults[0].text}")

    def __reduce__(self) -> tuple[type[PredictionsError], tuple[Path, tuple[PredictionFault, ...]]]:
        return (type(self), (self.path, self.faults))


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """The score of predictions.

    Args:
        split: The split.
        accuracy: The accuracy over all tested presses of all folds.
        folds: The accuracy of each fold.
        recall: The accuracy for each texture.
        confusion: The number of presses by true and predicted texture, shape (t, t), in the order of
            ``split.textures``.
    """

    split: Split
    accuracy: Accuracy
    folds: Mapping[str, Accuracy]
    recall: Mapping[str, Accuracy]
    confusion: Ints

    @property
    def shown(self) -> Iterator[Shown]:
        """The tables that are printed."""
        rows = {"all folds": self.accuracy, **self.folds}
        rows |= {f"{texture} (recall)": accuracy for texture, accuracy in self.recall.items()}
        frame = pd.DataFrame(map(vars, rows.values()))
        unknown = self.split.unknown_groups
        level = shown_level(self.split.hold_out, unknown)
        title = f"{self.split.protocol}{f', {level}' if level != self.split.hold_out else ''}: accuracy (%)"
        columns = {
            "of": list(rows),
            "accuracy": frame["fraction"].map(percent),
            "95 % interval": intervals(frame, empty=TOO_FEW),
            **{name: frame[name] for name in ("right", "presses")},
            "runs" if "prints" in unknown else "prints": frame["prints"],
        }
        yield Shown(title, pd.DataFrame(columns))
        counts = pd.DataFrame(self.confusion, columns=self.split.textures)
        counts.insert(0, "", self.split.textures)
        yield Shown("pressed (rows) and predicted (columns)", counts)

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        names = ("protocol", "data_sha256", "hold_out", "simulated", "unknown_groups")
        return {
            **{name: to_plain(getattr(self.split, name)) for name in names},
            "chance": 1.0 / len(self.split.textures),
            **{name: to_plain(getattr(self, name)) for name in ("accuracy", "folds", "recall")},
            "textures": list(self.split.textures),
            "confusion": self.confusion.tolist(),
        }


def score(path: Path, split: Split) -> Score:
    """Score a file of predictions.

    Args:
        path: The CSV file.
        split: The split for which the predictions were made.

    Raises:
        InputError: The file cannot be read, or a column is missing.
        PredictionsError: A prediction is missing or occurs twice, or its press or texture is not part of the split. All
            faults are named.
    """
    rows = _matched(path, split)
    textures = split.textures
    index = {name: number for number, name in enumerate(textures)}
    truth, answers = (rows[name].map(index).to_numpy() for name in ("texture", "predicted"))
    prints, folds = rows["run"].to_numpy(), rows["fold"].to_numpy()
    confusion = np.zeros((len(textures), len(textures)), dtype=np.int64)
    np.add.at(confusion, (truth, answers), 1)

    right = truth == answers
    correlation = correlation_of(right, np.ones(len(right)), prints, truth)

    def accuracy(where: Any = slice(None)) -> Accuracy:
        return accuracy_of(right[where], prints[where], correlation)

    return Score(
        split=split,
        accuracy=accuracy(),
        folds={fold.name: accuracy(folds == fold.name) for fold in split.folds},
        recall={str(name): accuracy(truth == i) for i, name in enumerate(textures) if (truth == i).any()},
        confusion=confusion,
    )


def accuracy_of(right: ArrayLike, prints: ArrayLike, correlation: float | None) -> Accuracy:
    """Compute the fraction of correct predictions, with an interval over prints.

    Args:
        right: Whether each press was predicted correctly, shape (n,).
        prints: The print of each press, shape (n,).
        correlation: The correlation of the presses of one print, from :func:`.accuracy_intervals.correlation_of`.
    """
    hits, sizes = np.asarray(right, dtype=np.bool_), np.unique(np.asarray(prints), return_counts=True)[1]
    correct, count = int(hits.sum()), len(hits)
    low, high = interval_of(correct / count, sizes, correlation)
    return Accuracy(fraction=correct / count, low=low, high=high, right=correct, presses=count, prints=len(sizes))


def _matched(path: Path, split: Split) -> pd.DataFrame:
    """Return the test presses of all folds with their textures and predictions, in the order of the split.

    Raises:
        InputError: Same as for :func:`score`.
        PredictionsError: Same as for :func:`score`.
    """
    heads, texts = read_table(path, "predictions")
    missing = [name for name in COLUMNS if name not in heads]
    if missing:
        raise InputError("predictions", str(path), f"has no column {missing[0]}; it must have {', '.join(COLUMNS)}")
    given = pd.DataFrame(texts, columns=heads)[list(COLUMNS)].apply(lambda column: column.str.strip())
    given["line"] = range(2, len(given) + 2)
    tests = [(fold.name, split.presses[i]) for fold in split.folds for i in fold.test]
    expected = pd.DataFrame([{"fold": fold, **to_plain(press)} for fold, press in tests])
    keys = list(COLUMNS[:-1])
    rows = expected.astype(dict.fromkeys(keys, str)).merge(given, on=keys, how="outer", indicator="found", sort=False)
    faults: list[PredictionFault] = []
    for row in rows[(rows["found"] == "right_only") | rows.duplicated(keys)].to_dict("records"):
        kind, fault = "unknown", "is not a test press of this fold in the split file"
        if row["found"] == "both":
            kind, fault = "doubled", "already has a prediction"
        faults.append(PredictionFault(kind, f"line {row['line']:.0f}: {_named(row)}: {fault}"))
    for row in rows[(rows["found"] == "both") & ~rows["predicted"].isin(split.textures)].to_dict("records"):
        fault = f"predicted = {row['predicted']!r} is not a texture of the split file ({', '.join(split.textures)})"
        faults.append(PredictionFault("unknown", f"line {row['line']:.0f}: {_named(row)}: {fault}"))
    for row in rows[rows["found"] == "left_only"].to_dict("records"):
        faults.append(PredictionFault("missing", f"{_named(row)}: has no prediction"))
    if faults:
        raise PredictionsError(path, faults)
    return rows


def _named(row: Mapping[Hashable, Any]) -> str:
    """Return the name of the fold and of a press in words."""
    return f"fold {row['fold']}, {named((row['run'], row['force_level'], row['repeat'], row['position']))}"
