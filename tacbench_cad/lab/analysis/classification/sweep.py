"""Accuracy against one setting: resolution, components, copies in training, contact force."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.accuracy import Score
from tacbench_cad.lab.analysis.classification.classify import Progress, classify
from tacbench_cad.lab.analysis.classification.result import SCORE_COLUMNS, SHOWN, SWEEP_COLUMNS
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.tables import Column, Table
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError, one_of

#: What can be swept, and the label of its axis.
PARAMETERS = {
    "resolution": "fraction of the image's width and height",
    "components": "principal components",
    "copies": "prints of each texture and combination in training",
    "forces": "force level (trained and tested at it alone)",
}
#: Values of a range where no number of them is given.
STEPS = 10


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """One setting and its values.

    Args:
        parameter: Of :data:`PARAMETERS`.
        values: Rising.
    """

    parameter: str
    values: tuple[float, ...]

    @classmethod
    def parsed(cls, text: str) -> Sweep:
        """From ``resolution=0.025:0.475``, ``components=5:50:10`` or ``copies=1,2,5``.

        A range has :data:`STEPS` values or as many as its third number says, evenly; counts are whole numbers.

        Raises:
            InputError: The text cannot be read, or the setting is unknown.
        """
        name, equals, rest = text.partition("=")
        one_of("sweep", name.strip(), PARAMETERS)
        name = name.strip()
        how = f"must be {name}=LOW:HIGH, {name}=LOW:HIGH:STEPS or {name}=A,B,C"
        try:
            if ":" in rest:
                low, high, steps = (
                    *(float(part) for part in rest.split(":")),
                    *[float(STEPS)] * (rest.count(":") == 1),
                )
                values = np.linspace(low, high, int(steps)) if 2 <= steps <= 1000 and low < high else None
            else:
                values = np.unique([float(part) for part in rest.split(",")])
        except ValueError:
            values = None
        if not equals or values is None or re.search(r"nan|inf", rest, re.IGNORECASE):
            raise InputError("sweep", text, how)
        numbers = [round(float(value), 6) for value in values]
        if name != "resolution":
            if ":" not in rest and any(not number.is_integer() for number in numbers):
                raise InputError("sweep", text, f"{name} must be whole numbers")
            numbers = [float(round(number)) for number in numbers]
        if numbers[0] <= 0:
            raise InputError("sweep", text, f"{name} must be above 0")
        return cls(parameter=name, values=tuple(sorted(set(numbers))))

    def at(
        self, collection: Collection, settings: ClassificationSettings, value: float
    ) -> tuple[Collection, ClassificationSettings]:
        """Data and settings for one value.

        Args:
            collection: The presses of the study.
            settings: What holds at every value.
            value: A value of the parameter.

        Raises:
            InputError: The data have no such force level.
        """
        if self.parameter == "resolution":
            return collection, replace(settings, resolution=value)
        if self.parameter == "components":
            return collection, replace(settings, components=int(value))
        if self.parameter == "copies":
            return collection, replace(settings, copies=int(value))
        return at_level(collection, int(value)), settings


def at_level(collection: Collection, level: int) -> Collection:
    """The presses of one force level.

    Raises:
        InputError: There is none.
    """
    which = collection.level == level
    if not which.any():
        raise InputError("force-level", level, f"the runs have {', '.join(map(str, collection.levels))}")
    return collection.chosen(which)


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepResult:
    """The rows at each value.

    Args:
        sweep: What was swept.
        settings: The rest.
        points: Value and row of each, for whole hold-out levels.
        notes: What has to be known, each once.
        textures: How many textures there are.
        simulated: What of the data was simulated.
    """

    sweep: Sweep
    settings: ClassificationSettings
    points: tuple[tuple[float, Score], ...]
    notes: tuple[str, ...]
    textures: int
    simulated: tuple[str, ...]

    @property
    def chance(self) -> float:
        """The accuracy of guessing."""
        return 1.0 / self.textures

    @property
    def table(self) -> Table:
        """The rows, with all that is known of each."""
        rows = [
            {"parameter": self.sweep.parameter, "value": value if self.sweep.parameter == "resolution" else int(value)}
            | {column.name: getattr(score, column.name) for column in SCORE_COLUMNS}
            for value, score in self.points
        ]
        return Table(columns=SWEEP_COLUMNS, rows=tuple(rows))

    @property
    def shown(self) -> Iterator[Table]:
        """The table that people see."""
        title = f"protocol {self.settings.protocol}, per cent; chance is {100.0 * self.chance:.1f}"
        value = Column("value", head=self.sweep.parameter, text=lambda value: f"{value:g}")
        yield self.table.select(*SHOWN[:3], value, *SHOWN[4:7], "images", title=title)

    def document(self) -> dict[str, Any]:
        """The values of ``--json``."""
        parameter = self.sweep.parameter
        points = self.table.select(*SCORE_COLUMNS).records()
        return {
            "simulated": list(self.simulated),
            "settings": to_plain(self.settings),
            "parameter": parameter,
            "points": [{parameter: value, **row} for (value, _), row in zip(self.points, points, strict=True)],
            "notes": list(self.notes),
        }


def run_sweep(
    collection: Collection,
    settings: ClassificationSettings,
    sweep: Sweep,
    trials: int,
    out: Path,
    executor: Executor,
    progress: Progress | None = None,
) -> SweepResult:
    """Classify at every value; finished trials are kept as for one value.

    Args:
        collection: The presses of the study.
        settings: What holds at every value.
        sweep: The parameter and its values.
        trials: How many trials are made at each value.
        out: Where finished trials are kept.
        executor: Worker processes.
        progress: Called with what was done, how much is done, and how much there is.

    Raises:
        InputError: As :func:`.classify.classify`, or the protocol has no such setting.
        CheckFailedError: A reading is damaged.
    """
    if settings.protocol == "paper" and sweep.parameter == "copies":
        raise InputError("sweep", sweep.parameter, "is of the leak-free protocol; the paper's trains on all copies")
    if sweep.parameter == "components" and settings.components is None:
        raise InputError("sweep", sweep.parameter, "needs principal components; leave out --components none")
    points: list[tuple[float, Score]] = []
    notes: dict[str, None] = {}
    for value in sweep.values:
        data, changed = sweep.at(collection, settings, value)

        def show(what: str, done: int, total: int, value: float = value) -> None:
            if progress is not None:
                progress(f"{sweep.parameter} {value:g}: {what}", done, total)

        result = classify(data, changed, trials, out, executor, show)
        points += [(value, score) for score in result.scores if score.whole]
        notes |= dict.fromkeys(result.notes)
    return SweepResult(
        sweep=sweep,
        settings=settings,
        points=tuple(points),
        notes=tuple(notes),
        textures=len(collection.textures),
        simulated=collection.simulated,
    )


def write_sweep(result: SweepResult, out: Path) -> Path:
    """Write ``sweep.csv``."""
    return result.table.write(out / "sweep.csv")
