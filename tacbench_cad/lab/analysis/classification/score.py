"""Scoring predictions, made by anything, against a split file.

Predictions are a CSV file with a head and one row for each press that a fold tests. These columns are read, in any
order; others are left alone:

=============== =====================================================================================
``fold``        name of the fold in the split file
``run``         name of the run, as in the split file
``force_level`` ``repeat``, ``position``: the press key, whole numbers from 1
``predicted``   name of the texture, as in the split file: ``texture-4``
=============== =====================================================================================

The interval has prints as its unit: presses of one print are alike, so a thousand presses of six prints are little more
than six trials. It is that of :func:`.accuracy.interval`; where every press or none is right,
prints do not differ to be seen, and each counts as one trial.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.lab.analysis.classification.accuracy import interval
from tacbench_cad.lab.analysis.classification.split_files import Key, Split, named
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Ints

#: Columns that a file of predictions must have.
COLUMNS = ("fold", "run", "force_level", "repeat", "position", "predicted")


@dataclass(frozen=True, kw_only=True)
class Share:
    """A share of presses that were told right.

    Args:
        right: Presses told right.
        presses: Presses.
        prints: Prints that they are of.
        low: Lower end of the 95 % interval, None for one print.
        high: Upper end.
    """

    right: int
    presses: int
    prints: int
    low: float | None
    high: float | None

    @property
    def value(self) -> float:
        """The share."""
        return self.right / self.presses

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "share": self.value,
            "low": self.low,
            "high": self.high,
            "right": self.right,
            "presses": self.presses,
            "prints": self.prints,
        }


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A prediction that is missing, doubled or unknown.

    Args:
        kind: ``missing``, ``doubled`` or ``unknown``.
        text: Which one, and why.
    """

    kind: str
    text: str


class PredictionsError(CheckFailedError):
    """Predictions do not fit their split.

    Args:
        path: The file of predictions.
        faults: Every fault.
    """

    def __init__(self, path: Path, faults: Sequence[Fault]) -> None:
        self.path, self.faults = path, tuple(faults)
        kinds = Counter(one.kind for one in faults)
        counts = ", ".join(f"{count:,} {kind}" for kind, count in kinds.items())
        super().__init__(f"{path}: predictions do not fit the split: {counts}; the first: {faults[0].text}")

    def __reduce__(self) -> tuple[type[PredictionsError], tuple[Path, tuple[Fault, ...]]]:
        return (type(self), (self.path, self.faults))


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """What predictions are worth.

    Args:
        split: The split.
        accuracy: Over all tested presses of all folds.
        folds: By fold.
        recall: By texture.
        confusion: Presses by (pressed, predicted), in the order of ``split.textures``, shape (t, t).
    """

    split: Split
    accuracy: Share
    folds: Mapping[str, Share]
    recall: Mapping[str, Share]
    confusion: Ints

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "protocol": self.split.protocol,
            "data_sha256": self.split.data_sha256,
            "rung": self.split.rung,
            "simulated": list(self.split.simulated),
            "chance": 1.0 / len(self.split.textures),
            "accuracy": self.accuracy.as_dict(),
            "folds": {name: one.as_dict() for name, one in self.folds.items()},
            "recall": {name: one.as_dict() for name, one in self.recall.items()},
            "textures": list(self.split.textures),
            "confusion": self.confusion.tolist(),
        }


def score(path: Path, split: Split) -> Score:
    """Score a file of predictions.

    Args:
        path: The CSV file.
        split: What it was made for.

    Raises:
        InputError: The file cannot be read or lacks a column.
        PredictionsError: A prediction is missing, stands there twice, or is of something that the split does not test
            or have; all of them are named.
    """
    predicted = _matched(path, split)
    textures = split.textures
    at = {name: i for i, name in enumerate(textures)}
    confusion = np.zeros((len(textures), len(textures)), dtype=np.int64)
    fold, texture, run, right = [], [], [], []
    for (name, index), answer in predicted.items():
        press = split.presses[index]
        confusion[at[press.texture], at[answer]] += 1
        fold.append(name)
        texture.append(press.texture)
        run.append(press.key[0])
        right.append(answer == press.texture)
    return Score(
        split=split,
        accuracy=share_of(right, run),
        folds={one.name: _share_where(right, run, fold, one.name) for one in split.folds},
        recall={one: _share_where(right, run, texture, one) for one in textures if one in texture},
        confusion=confusion,
    )


def share_of(right: ArrayLike, prints: ArrayLike) -> Share:
    """The share that was told right, with an interval over prints.

    Args:
        right: Whether a press was told right, shape (n,).
        prints: The print of each, shape (n,).
    """
    hits, units = np.asarray(right, dtype=np.float64), np.asarray(prints)
    count = len(np.unique(units))
    low, high = interval(hits, np.ones(len(hits)), units)
    return Share(right=int(hits.sum()), presses=len(hits), prints=count, low=low, high=high)


def _share_where(right: Sequence[bool], run: Sequence[str], labels: Sequence[str], label: str) -> Share:
    chosen = [i for i, one in enumerate(labels) if one == label]
    return share_of([right[i] for i in chosen], [run[i] for i in chosen])


def _matched(path: Path, split: Split) -> dict[tuple[str, int], str]:
    """The predicted texture of every tested press, by fold and index, in the order of the split.

    Raises:
        PredictionsError: See :func:`score`.
    """
    index = {one.key: i for i, one in enumerate(split.presses)}
    wanted = {(fold.name, i): "" for fold in split.folds for i in fold.test}
    folds = {one.name for one in split.folds}
    lines: dict[tuple[str, int], int] = {}
    faults: list[Fault] = []
    for line, row in _rows(path):
        where = f"line {line}"
        try:
            key: Key = (row["run"], *(int(row[name]) for name in ("force_level", "repeat", "position")))  # type: ignore[assignment]
        except ValueError:
            faults.append(
                Fault(kind="unknown", text=f"{where}: force_level, repeat and position must be whole numbers")
            )
            continue
        what = f"fold {row['fold']}, {named(key)}"
        pair = (row["fold"], index.get(key, -1))
        if row["fold"] not in folds:
            faults.append(Fault(kind="unknown", text=f"{where}: {what}: the split has no such fold"))
        elif key not in index:
            faults.append(Fault(kind="unknown", text=f"{where}: {what}: the split has no such press"))
        elif pair not in wanted:
            faults.append(Fault(kind="unknown", text=f"{where}: {what}: this fold does not test it"))
        elif pair in lines:
            faults.append(Fault(kind="doubled", text=f"{where}: {what}: stands in line {lines[pair]} already"))
        elif row["predicted"] not in split.textures:
            allowed = ", ".join(split.textures)
            text = f"{where}: {what}: predicted {row['predicted']!r} is no texture of the split ({allowed})"
            faults.append(Fault(kind="unknown", text=text))
            lines[pair] = line
        else:
            wanted[pair] = row["predicted"]
            lines[pair] = line
    for name, i in wanted:
        if (name, i) not in lines:
            text = f"fold {name}, {named(split.presses[i].key)}: has no prediction"
            faults.append(Fault(kind="missing", text=text))
    if faults:
        raise PredictionsError(path, faults)
    return wanted


def _rows(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Line numbers and rows of a file of predictions."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.DictReader(stream, restval="")
            lacking = [one for one in COLUMNS if one not in (reader.fieldnames or ())]
            if lacking:
                raise InputError("predictions", str(path), f"has no column {lacking[0]}; columns: {', '.join(COLUMNS)}")
            for row in reader:
                yield reader.line_num, {name: (row[name] or "").strip() for name in COLUMNS}
    except OSError as error:
        raise InputError("predictions", str(path), f"cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError("predictions", str(path), f"is no CSV file in UTF-8: {error}") from None
