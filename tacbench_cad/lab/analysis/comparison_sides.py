"""The two sides of a comparison: the accuracy on each print, read from the results of a classification."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.tables import read_csv
from tacbench_cad.util.errors import InputError


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
    path = folder / "predictions.csv"
    rows = read_csv(path, ("estimator", "hold_out", "run", "press", "texture", "predicted"))
    rows = rows[rows["estimator"] == chosen]
    if rows.empty:
        raise InputError("predictions", str(path), f"has no row of the estimator {chosen}")
    unit = rows["run"] + " " + rows["press"].astype(str) if side.unit == "samples" else rows["run"]
    rows = rows.assign(unit=unit, right=rows["predicted"] == rows["texture"])
    accuracies: dict[tuple[str, str], dict[str, PrintAccuracy]] = defaultdict(dict)
    for key, of_unit in rows.groupby(["hold_out", "texture", "unit"], sort=False):
        hold_out, texture, name_of_unit = map(str, key)
        accuracy = PrintAccuracy(float(of_unit["right"].mean()), int(of_unit["press"].nunique()))
        accuracies[hold_out, texture][name_of_unit] = accuracy
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
