"""Accuracy against one setting: resolution, components, copies in training, contact force."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacbench_cad.lab.analysis.classification.accuracy import Score
from tacbench_cad.lab.analysis.classification.classify import Progress, classify
from tacbench_cad.lab.analysis.classification.result import Result
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.parallel import Executor
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
        return collection.at_level(int(value)), settings


def run_sweep(
    collection: Collection,
    settings: ClassificationSettings,
    sweep: Sweep,
    trials: int,
    out: Path,
    executor: Executor,
    progress: Progress | None = None,
) -> Result:
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
    if settings.protocol != "leak-free" and sweep.parameter == "copies":
        raise InputError("sweep", sweep.parameter, "is of the leak-free protocol; the paper's has its own copies")
    if sweep.parameter == "components" and settings.components is None:
        raise InputError("sweep", sweep.parameter, "needs principal components; leave out --components none")
    points: list[tuple[float, Score]] = []
    notes: list[str] = []
    for value in sweep.values:
        data, changed = sweep.at(collection, settings, value)

        def show(what: str, done: int, total: int, value: float = value) -> None:
            if progress is not None:
                progress(f"{sweep.parameter} {value:g}: {what}", done, total)

        result = classify(data, changed, trials, out, executor, show)
        points += [(value, score) for score in result.scores if score.whole]
        notes += result.notes
    values, scores = zip(*points, strict=True)
    return Result(
        settings=settings,
        outcomes=(),
        scores=scores,
        notes=tuple(dict.fromkeys(notes)),
        collection=collection,
        parameter=sweep.parameter,
        values=values,
    )
