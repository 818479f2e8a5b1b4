"""Accuracy against one setting: resolution, components, copies in training, contact force."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis.classification.accuracy import Score
from tacbench_cad.lab.analysis.classification.classify import Progress, classify
from tacbench_cad.lab.analysis.classification.settings import Settings
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.csvfile import write_csv
from tacbench_cad.lab.parallel import Team
from tacbench_cad.util.errors import InputError, one_of

#: What can be swept, and what the axis is called.
PARAMETERS = {
    "resolution": "share of the image's width and height",
    "components": "principal components",
    "copies": "prints of each texture and combination in training",
    "forces": "force level (trained and tested at it alone)",
}
#: Values of a range where no number of them is given.
STEPS = 10
#: Heads of ``sweep.csv``.
COLUMNS = (
    *("protocol", "estimator", "train_on", "tested_on", "rung", "parameter", "value"),
    *("accuracy", "low", "high", "spread", "trials", "images"),
)


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
                low, high, steps = (*(float(one) for one in rest.split(":")), *[float(STEPS)] * (rest.count(":") == 1))
                values = np.linspace(low, high, int(steps)) if 2 <= steps <= 1000 and low < high else None
            else:
                values = np.unique([float(one) for one in rest.split(",")])
        except ValueError:
            values = None
        if not equals or values is None or re.search(r"nan|inf", rest, re.IGNORECASE):
            raise InputError("sweep", text, how)
        numbers = [round(float(one), 6) for one in values]
        if name != "resolution":
            if ":" not in rest and any(one != int(one) for one in numbers):
                raise InputError("sweep", text, f"{name} must be whole numbers")
            numbers = [float(round(one)) for one in numbers]
        if numbers[0] <= 0:
            raise InputError("sweep", text, f"{name} must be above 0")
        return cls(parameter=name, values=tuple(sorted(set(numbers))))

    def at(self, collection: Collection, settings: Settings, value: float) -> tuple[Collection, Settings]:
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
        raise InputError("force-level", level, f"the runs have {', '.join(str(one) for one in collection.levels)}")
    return collection.chosen(which)


@dataclass(frozen=True, kw_only=True, eq=False)
class SweepResult:
    """The rows at each value.

    Args:
        sweep: What was swept.
        settings: The rest.
        points: Value and row of each, for whole rungs.
        notes: What has to be known, each once.
        textures: How many there are.
    """

    sweep: Sweep
    settings: Settings
    points: tuple[tuple[float, Score], ...]
    notes: tuple[str, ...]
    textures: int


def run_sweep(
    collection: Collection,
    settings: Settings,
    sweep: Sweep,
    trials: int,
    out: Path,
    team: Team,
    progress: Progress | None = None,
) -> SweepResult:
    """Classify at every value; finished trials are kept as for one value.

    Args:
        collection: The presses of the study.
        settings: What holds at every value.
        sweep: The parameter and its values.
        trials: How many trials are made at each value.
        out: Where finished trials are kept.
        team: The processes that do it.
        progress: Called with what was done, how much is done, and how much there is.

    Raises:
        InputError: As :func:`.classify.classify`, or the protocol has no such setting.
        CheckFailedError: A reading is damaged.
    """
    if settings.protocol == "paper" and sweep.parameter == "copies":
        raise InputError("sweep", sweep.parameter, "is of the sound protocol; the paper's trains on all copies")
    if sweep.parameter == "components" and settings.components is None:
        raise InputError("sweep", sweep.parameter, "needs principal components; leave out --components none")
    points: list[tuple[float, Score]] = []
    notes: list[str] = []
    for value in sweep.values:
        data, one = sweep.at(collection, settings, value)

        def said(what: str, done: int, total: int, value: float = value) -> None:
            if progress is not None:
                progress(f"{sweep.parameter} {value:g}: {what}", done, total)

        result = classify(data, one, trials, out, team, said)
        whole = ("all", "all others", *one.train_on, *result.settings.train_on)
        points += [
            (value, score)
            for score in result.scores
            if score.tested_on in whole and not (score.rung == "unseen" and score.tested_on != "all others")
        ]
        notes += [f"{note}" for note in result.notes]
    return SweepResult(
        sweep=sweep,
        settings=settings,
        points=tuple(points),
        notes=tuple(dict.fromkeys(notes)),
        textures=len(collection.textures),
    )


def write_sweep(result: SweepResult, out: Path) -> Path:
    """Write ``sweep.csv``."""

    def row(value: float, score: Score) -> dict[str, Any]:
        whole = result.sweep.parameter != "resolution"
        named: Sequence[str] = [one for one in COLUMNS if one not in ("protocol", "parameter", "value")]
        return {
            "protocol": result.settings.protocol,
            "parameter": result.sweep.parameter,
            "value": int(value) if whole else value,
            **{name: getattr(score, name) for name in named},
        }

    return write_csv(out / "sweep.csv", COLUMNS, (row(value, score) for value, score in result.points))
