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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from tacbench_cad.lab.analysis.classification.accuracy import scores
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.hold_out import shown_level
from tacbench_cad.lab.analysis.classification.split_files import KEY, Split, SplitPress, named
from tacbench_cad.lab.analysis.tables import Shown, intervals, percent, records
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.untrusted import read_table

#: The columns that a file of predictions must have.
COLUMNS = ("fold", *KEY, "predicted")


class PredictionsError(CheckFailedError):
    """Predictions do not fit their split.

    Args:
        path: The file of predictions.
        faults: All faults: the line or press, and the reason. Each begins with ``missing``, ``doubled`` or ``unknown``.
    """

    def __init__(self, path: Path, faults: Sequence[str]) -> None:
        self.faults = tuple(faults)
        kinds = Counter(fault.partition(":")[0] for fault in faults)
        counts = ", ".join(f"{count:,} {kind}" for kind, count in kinds.items())
        super().__init__(f"{path}: predictions do not fit the split: {counts}; the first: {faults[0]}")


@dataclass(frozen=True, kw_only=True, eq=False)
class Score:
    """The score of predictions.

    Args:
        split: The split.
        table: The accuracies over all folds, of each fold, and of each texture (its recall), see
            :func:`.accuracy.scores`.
        confusion: The number of presses by true texture (rows) and predicted texture (columns).
    """

    split: Split
    table: pd.DataFrame
    confusion: pd.DataFrame

    def shown(self) -> Iterator[Shown]:
        """Yield the tables that are printed."""
        split, table = self.split, self.table
        level = shown_level(split.hold_out, split.unknown_groups)
        title = f"{split.protocol}{f', {level}' if level != split.hold_out else ''}: accuracy (%)"
        columns: dict[str, Any] = {"tested on": table["tested_on"], "accuracy": table["accuracy"].map(percent)}
        columns |= {
            "95 % interval": intervals(table, empty=TOO_FEW),
            "units": table["units"],
            "presses": table["images"],
        }
        yield Shown(title, pd.DataFrame(columns | {"presses": table["images"]}))
        counts = self.confusion.rename_axis(index="", columns=None).reset_index()
        yield Shown("pressed (rows) and predicted (columns)", counts)

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        names = ("protocol", "data_sha256", "hold_out", "simulated", "unknown_groups", "textures")
        about = {name: to_plain(getattr(self.split, name)) for name in names}
        accuracies, counts = records(self.table), self.confusion.to_numpy().tolist()
        return {**about, "chance": 1.0 / len(self.split.textures), "accuracies": accuracies, "confusion": counts}


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
    rows, names = _matched(path, split), list(split.textures)
    same: dict[str, Any] = {
        "estimator": "",
        "train_on": "",
        "hold_out": "copy",
        "trial": 1,
    }  # the units are prints at every level
    rows = rows.assign(**same, press=rows.index, unit=rows["run"])
    folds, recall = (scores(rows.assign(tested_on=rows[column])) for column in ("fold", "texture"))
    recall = recall[1:].sort_values("tested_on", key=lambda textures: textures.map(names.index))
    table = pd.concat([folds, recall.assign(tested_on=recall["tested_on"] + " (recall)")], ignore_index=True)
    table = table[["tested_on", "accuracy", "low", "high", "units", "images"]]
    if "prints" in split.unknown_groups:
        table = table.assign(units=table["units"].str.replace("prints", "runs"))
    counts = pd.crosstab(rows["texture"], rows["predicted"]).reindex(index=names, columns=names, fill_value=0)
    return Score(split=split, table=table, confusion=counts)


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
    tests = [(fold.name, *split.presses[i]) for fold in split.folds for i in fold.test]
    keys = ["fold", *KEY]
    expected = pd.DataFrame(tests, columns=["fold", *SplitPress._fields]).astype(dict.fromkeys(keys, str))
    rows = expected.merge(given, on=keys, how="outer", indicator="found", sort=False)
    faults = []
    for row, again in zip(rows.to_dict("records"), rows.duplicated(keys), strict=True):
        press = f"fold {row['fold']}, {named([row[name] for name in KEY])}"
        where = f"line {row['line']:.0f}: {press}"
        if row["found"] == "left_only":
            faults.append(f"missing: {press}: has no prediction")
        elif row["found"] == "right_only":
            faults.append(f"unknown: {where}: is not a test press of this fold in the split file")
        elif again:
            faults.append(f"doubled: {where}: already has a prediction")
        elif row["predicted"] not in split.textures:
            what = f"{row['predicted']!r} is not a texture of the split file ({', '.join(split.textures)})"
            faults.append(f"unknown: {where}: predicted = {what}")
    if faults:
        raise PredictionsError(path, faults)
    return rows
