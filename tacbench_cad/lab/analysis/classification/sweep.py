"""Sweeps: the accuracy for several values of one setting.

The setting is the resolution, the contact force, or the number of components, of training prints or of moving frames.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd
from sklearn.base import clone

from tacbench_cad.lab.analysis.classification.accuracy import shown_scores
from tacbench_cad.lab.analysis.classification.accuracy_figures import sweep_figure
from tacbench_cad.lab.analysis.classification.classification import Classification, ClassificationRecord
from tacbench_cad.lab.analysis.classification.classify import RESOLUTION, Progress, classify
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, default_settings
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.figures import save_results
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.study_design import Design, at_level
from tacbench_cad.lab.analysis.tables import Shown, records
from tacbench_cad.lab.runs.press_table import STEP
from tacbench_cad.util.errors import InputError, one_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Sweep:
    """The result of a sweep.

    Args:
        parameter: The setting, one of :data:`PARAMETERS`.
        points: The classification for each value.
    """

    parameter: str
    points: Mapping[float, Classification]

    @property
    def record(self) -> ClassificationRecord:
        """The settings and the data for the smallest value."""
        return next(iter(self.points.values())).record

    @property
    def table(self) -> pd.DataFrame:
        """The accuracies of whole hold-out levels, with the columns ``parameter`` and ``value``."""
        parts = [point.whole.assign(parameter=self.parameter, value=value) for value, point in self.points.items()]
        return pd.concat(parts, ignore_index=True)

    @property
    def notes(self) -> tuple[str, ...]:
        """The notes of all classifications, each once."""
        return tuple(dict.fromkeys(note for point in self.points.values() for note in point.notes))

    def shown(self) -> Iterator[tuple[str, Shown]]:
        """Yield the table for readers, with the name of its CSV file."""
        shown = shown_scores(self.table, self.record.unknown_groups, self.record.title, self.parameter)
        yield "sweep", shown

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        about = {"parameter": self.parameter, "points": records(self.table), "notes": list(self.notes)}
        return self.record.document() | about

    def figure(self) -> Figure:
        """Draw the accuracy over the setting."""
        return sweep_figure(self.table, PARAMETERS[self.parameter], self.record.chance)

    def save(self, folder: str | Path) -> list[Path]:
        """Write ``sweep.csv`` and the figure (PNG and PDF) into a folder.

        Raises:
            InputError: A file cannot be written.
            MissingToolError: matplotlib is not installed.
        """
        figures = {f"sweep_{self.parameter}": self.figure()}
        return save_results(folder, {"sweep": self.table}, figures, self.record.simulated)


def sweep(
    presses: pd.DataFrame,
    text: str,
    feature: Feature | None = None,
    settings: ClassificationSettings | None = None,
    *,
    progress: Progress = lambda what, done, total: None,
    **how: Any,
) -> Sweep:
    """Classify for several values of a setting.

    Args:
        presses: See :func:`.classify.classify`, like the other arguments.
        text: The setting and its values: ``resolution=0.025:0.475``, ``components=5:50:10`` or ``copies=1,2,5``.
        feature: The feature.
        settings: The settings that are equal for all values.
        progress: Receives progress updates.
        how: The other arguments of :func:`.classify.classify`.

    Raises:
        InputError: Same as for :func:`.classify.classify`, or the setting or a value is not allowed.
        CheckFailedError: A frame is damaged.
    """
    parameter, values = parsed(text)
    feature = feature or Pixels(resolution=RESOLUTION)
    settings = settings or default_settings(Design.of(presses), feature)
    refusals = {
        "copies": (settings.protocol != "leak-free", "needs --protocol leak-free; the others fix the number of prints"),
        "components": (settings.components is None, "needs principal components; leave out --components none"),
        "frames": (STEP not in presses, "needs series of frames; also give --series"),
        "resolution": ("resolution" not in feature.get_params(), f"is not a setting of the feature {feature.name}"),
    }
    refused, reason = refusals.get(parameter, (False, ""))
    if refused:
        raise InputError("sweep", parameter, reason)
    points = {}
    for value in values:
        data, changed, used = presses, settings, feature
        if parameter == "resolution":
            used = clone(feature).set_params(resolution=value)
        elif parameter == "frames":
            data = presses[presses[STEP] <= value]
        elif parameter == "forces":
            data = at_level(presses, int(value))
        else:
            changed = replace(settings, **cast(Any, {parameter: int(value)}))

        def show(what: str, done: int, total: int, value: float = value) -> None:
            progress(f"{parameter} {value:g}: {what}", done, total)

        points[value] = classify(data, used, changed, progress=show, **how)
    return Sweep(parameter=parameter, points=points)


def parsed(text: str) -> tuple[str, tuple[float, ...]]:
    """Parse the text of a sweep into the setting and its values in rising order.

    A range has :data:`STEPS` evenly spaced values, or as many as its third number. Counts are whole numbers.

    Raises:
        InputError: The text has another form, or the setting is unknown.
    """
    name, _, rest = text.partition("=")
    name = one_of("sweep", name.strip(), PARAMETERS)
    try:
        values = np.array([float(part) for part in re.split("[:,]", rest)])
    except ValueError:
        values = np.array([np.nan])
    if ":" in rest:
        low, high, count = [*values, STEPS, np.nan, np.nan][:3]
        fits = len(values) in (2, 3) and 2 <= count <= 1000 and low < high < np.inf
        values = np.linspace(low, high, int(count)) if fits else np.array([np.nan])
    if not np.isfinite(values).all():
        raise InputError("sweep", text, f"must be {name}=LOW:HIGH, {name}=LOW:HIGH:STEPS or {name}=A,B,C")
    whole = values.round(6 if name == "resolution" else 0)
    if ":" not in rest and (whole != values.round(6)).any():
        raise InputError("sweep", text, f"{name} must be whole numbers")
    if whole.min() <= 0:
        raise InputError("sweep", text, f"{name} must be above 0")
    return name, tuple(np.unique(whole).tolist())
