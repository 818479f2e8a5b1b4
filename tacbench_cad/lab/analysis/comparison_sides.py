"""The two sides of a comparison: the accuracy on each print, read from the results of a classification."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.tables import Column, Row, Table
from tacbench_cad.util.errors import InputError

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

    @property
    def unit(self) -> str:
        """The unit of the intervals: ``prints``, or ``recordings`` or ``samples`` if the prints are unknown."""
        unknown = self.record.unknown_groups
        return "prints" if "prints" not in unknown else "samples" if "sessions" in unknown else "recordings"


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
    side = Side(name=name, record=record, accuracies={})
    predictions: dict[tuple[str, str, str], list[Row]] = defaultdict(list)
    for row in Table.read(folder / "predictions.csv", _PREDICTIONS).rows:
        if row["estimator"] == chosen:
            unit = f"{row['run']} {row['press']}" if side.unit == "samples" else row["run"]
            predictions[row["hold_out"], row["texture"], unit].append(row)
    if not predictions:
        raise InputError("predictions", str(folder / "predictions.csv"), f"has no row of the estimator {chosen}")
    accuracies: dict[tuple[str, str], dict[str, PrintAccuracy]] = defaultdict(dict)
    for (hold_out, texture, unit), rows in predictions.items():
        correct = sum(row["predicted"] == texture for row in rows)
        presses = len({row["press"] for row in rows})
        accuracies[hold_out, texture][unit] = PrintAccuracy(correct / len(rows), presses)
    return replace(side, accuracies=accuracies), chosen


def side_names(folders: tuple[Path, Path], records: Sequence[ClassificationRecord]) -> tuple[str, str] | None:
    """Return two different names for the sides of a comparison: of the sensors, of the folders, or their paths.

    Returns:
        The names; None if both sides are the same folder.
    """
    sensors = tuple(record.sensor for record in records)
    for a, b in (sensors, tuple(folder.resolve().name for folder in folders), tuple(map(str, folders))):
        if a and b and a != b:
            return a, b
    return None
