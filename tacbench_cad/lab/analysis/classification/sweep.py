"""Sweeps: the accuracy for several values of one setting.

The setting is the resolution, the contact force, or the number of components, of training prints or of moving frames.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.classification.accuracy import FoldScore
from tacbench_cad.lab.analysis.classification.classify import Progress, classify
from tacbench_cad.lab.analysis.classification.outcomes import OUTCOMES
from tacbench_cad.lab.analysis.classification.result import Result
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.parallel import Executor
from tacbench_cad.util.errors import InputError, one_of

#: The settings that can be swept, and the labels of their axes.
PARAMETERS = {
    "resolution": "fraction of the image's width and height",
    "components": "principal components",
    "copies": "prints of each texture and combination in training",
    "forces": "force level (trained and tested at it alone)",
    "frames": "frames from the start of each series",
}
#: The default number of values in a range.
STEPS = 10


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """One setting and its values.

    Args:
        parameter: The setting, one of :data:`PARAMETERS`.
        values: The values in rising order.
    """

    parameter: str
    values: tuple[float, ...]

    @classmethod
    def parsed(cls, text: str) -> Sweep:
        """Parse ``resolution=0.025:0.475``, ``components=5:50:10`` or ``copies=1,2,5``.

        A range has :data:`STEPS` evenly spaced values, or as many as its third number. Counts are whole numbers.

        Raises:
            InputError: The text has another form, or the setting is unknown.
        """
        name, equals, rest = text.partition("=")
        one_of("sweep", name.strip(), PARAMETERS)
        name = name.strip()
        allowed = f"must be {name}=LOW:HIGH, {name}=LOW:HIGH:STEPS or {name}=A,B,C"
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
            raise InputError("sweep", text, allowed)
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
        """Return the data and the settings for one value.

        Args:
            collection: The presses of the study.
            settings: The settings that are equal for all values.
            value: A value of the setting that is swept.

        Raises:
            InputError: The data do not have this force level.
        """
        if self.parameter == "resolution":
            return collection, replace(settings, resolution=value)
        if self.parameter == "components":
            return collection, replace(settings, components=int(value))
        if self.parameter == "copies":
            return collection, replace(settings, copies=int(value))
        if self.parameter == "frames":
            return collection, replace(settings, frames=int(value))
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
    """Classify for every value. Finished trials are stored and not repeated, as in :func:`.classify.classify`.

    Args:
        collection: The presses of the study.
        settings: The settings that are equal for all values.
        sweep: The setting that is swept, and its values.
        trials: The number of trials for each value.
        out: The folder in which finished trials are stored.
        executor: The worker processes.
        progress: Receives progress updates: the name of the step, the steps done and their total number.

    Raises:
        InputError: Same as for :func:`.classify.classify`, or the protocol does not have this setting.
        CheckFailedError: A frame is damaged.
    """
    if settings.protocol != "leak-free" and sweep.parameter == "copies":
        raise InputError(
            "sweep", sweep.parameter, "needs --protocol leak-free; the paper's protocols fix the number of prints"
        )
    if sweep.parameter == "components" and settings.components is None:
        raise InputError("sweep", sweep.parameter, "needs principal components; leave out --components none")
    if sweep.parameter == "frames" and not settings.series:
        raise InputError("sweep", sweep.parameter, "needs series of frames; also give --series")
    points: list[tuple[float, FoldScore]] = []
    notes: list[str] = []
    for value in sweep.values:
        data, changed = sweep.at(collection, settings, value)

        def show(what: str, done: int, total: int, value: float = value) -> None:
            if progress is not None:
                progress(f"{sweep.parameter} {value:g}: {what}", done, total)

        result = classify(data, changed, trials, out, executor, show, beside_plain=False)
        points += [(value, score) for score in result.scores if score.whole]
        notes += result.notes
    values, scores = zip(*points, strict=True)
    return Result(
        settings=settings,
        outcomes=pd.DataFrame(columns=list(OUTCOMES)),
        scores=scores,
        notes=tuple(dict.fromkeys(notes)),
        collection=collection,
        parameter=sweep.parameter,
        values=values,
    )
