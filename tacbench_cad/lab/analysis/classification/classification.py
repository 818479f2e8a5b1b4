"""The result of a classification, from which files, printed tables, JSON, figures and reports are made."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import pandas as pd
from annotated_types import Len

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.classification import accuracy, accuracy_figures
from tacbench_cad.lab.analysis.classification.accuracy import PREDICTIONS
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, shown_protocol
from tacbench_cad.lab.analysis.conclusions import shown_answers
from tacbench_cad.lab.analysis.figures import save_results
from tacbench_cad.lab.analysis.study_design import Design, at_level, data_key
from tacbench_cad.lab.analysis.tables import Shown, records, write_settings
from tacbench_cad.lab.runs.press_table import read
from tacbench_cad.util.convert import read_json, to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.untrusted import read_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: The name of the settings file beside the tables.
SETTINGS_FILE = "classification_settings.json"
#: The name of the main figure's files, by protocol.
FIGURES = {"leak-free": "hold_out_levels", "paper": "paper_table", "as-published": "published_table"}


@dataclass(frozen=True, kw_only=True)
class ClassificationRecord:
    """The settings and the data of a finished classification; the fields are the keys of its file.

    Args:
        settings: The settings.
        features: The feature with its settings, as scikit-learn prints it: ``Pixels(resolution=0.4)``.
        summary: What the numbers are that were classified, for texts.
        units: Their unit.
        steps: The number of frames of each series; 0 for the frames of presses.
        trials: The number of trials.
        textures: The names of the textures, sorted.
        sensor: The name of the sensor.
        simulated: The simulated parts of the data.
        data: The key of the data, see :attr:`.Design.data_key`.
        unknown_groups: See :attr:`.Design.unknown_groups`.
        notes: Remarks that a reader must know.
        analysis: The kind of analysis.
        version: The version of this program.
    """

    settings: ClassificationSettings
    features: str
    summary: str
    units: str
    steps: int = 0
    trials: int
    textures: Annotated[tuple[str, ...], Len(2)]
    sensor: str
    simulated: tuple[str, ...]
    data: str
    unknown_groups: tuple[str, ...] = ()
    notes: tuple[str, ...]
    analysis: Literal["classification"] = "classification"
    version: str = __version__

    @property
    def title(self) -> str:
        """The title of a table of accuracies."""
        protocol = shown_protocol(self.settings.protocol, self.unknown_groups)
        return f"protocol {protocol}, in %; chance is {100.0 * self.chance:.1f}"

    @property
    def chance(self) -> float:
        """The accuracy expected from guessing, from 0 to 1."""
        return 1.0 / len(self.textures)

    def document(self) -> dict[str, Any]:
        """Return the beginning of the document of ``--json``."""
        settings = to_plain(self.settings) | {"protocol": shown_protocol(self.settings.protocol, self.unknown_groups)}
        names = ("features", "simulated", "textures", "chance", "notes")
        return {"settings": settings, **{name: to_plain(getattr(self, name)) for name in names}}


@dataclass(frozen=True, kw_only=True, eq=False)
class Classification:
    """The result of a classification.

    Args:
        record: The settings and the data.
        predictions: The predictions of the estimators, see :data:`.accuracy.PREDICTIONS`.
    """

    record: ClassificationRecord
    predictions: pd.DataFrame

    @classmethod
    def open(cls, folder: Path, design: Design | None = None) -> Classification:
        """Read an earlier classification from an output folder of ``tacbench classify``.

        Args:
            folder: The folder.
            design: The study that must have been classified, all presses or all at one force level; None for any.

        Raises:
            InputError: A file is missing or damaged, or other presses were classified.
        """
        record = read_json(folder / SETTINGS_FILE, ClassificationRecord, "settings")
        path = folder / "predictions.csv"
        types = {**dict.fromkeys(PREDICTIONS, "str"), "trial": "int64", "press": "int64"}
        text = io.StringIO(read_text(path, "predictions", "table"))
        try:
            predictions = pd.read_csv(text, usecols=PREDICTIONS, dtype=types, keep_default_na=False)
        except ValueError as error:
            raise InputError("predictions", str(path), f"cannot be read: {error}; classify again") from None
        if predictions.empty:
            raise InputError("predictions", str(path), "has no row; classify again")
        if design is not None:
            if record.steps and not design.steps:
                runs = [run.folder for run in design.runs]
                design = Design.of(read(runs, series=True, frames=record.steps))
            of_levels = (data_key(at_level(design.presses, level)) for level in design.levels)
            if record.data not in (design.data_key, *of_levels):
                what = "must be a classification of all presses of these runs; classify them again"
                raise InputError("classify", str(folder), what)
        return cls(record=record, predictions=predictions)

    @property
    def settings(self) -> ClassificationSettings:
        """The settings."""
        return self.record.settings

    @property
    def notes(self) -> tuple[str, ...]:
        """Warnings, the hold-out levels that are left out, and the choices made where the paper is unclear."""
        return self.record.notes

    @cached_property
    def table(self) -> pd.DataFrame:
        """The accuracies, see :func:`.accuracy.scores`."""
        return accuracy.scores(self.predictions, self.record.unknown_groups)

    @property
    def whole(self) -> pd.DataFrame:
        """The accuracies of whole hold-out levels."""
        return self.table[self.table["tested_on"] == accuracy.ALL]

    @cached_property
    def confusion(self) -> pd.DataFrame:
        """How often each texture was predicted as each texture, see :func:`.accuracy.confusion`."""
        return accuracy.confusion(self.predictions, self.record.textures)

    @cached_property
    def answers(self) -> pd.DataFrame:
        """The answers which textures can be told apart; empty except for the leak-free protocol."""
        leak_free = self.settings.protocol == "leak-free"
        about = (self.record.textures, self.record.unknown_groups, self.notes)
        return accuracy.texture_answers(self.predictions, *about) if leak_free else pd.DataFrame()

    @property
    def beside_paper(self) -> pd.DataFrame:
        """The accuracies beside the paper's, see :func:`.accuracy.beside_paper`; empty for other quantities."""
        return accuracy.beside_paper(self.whole) if self.settings.protocol == "as-published" else pd.DataFrame()

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The stored tables, by the names of their CSV files without suffix."""
        tables = {"classification": self.table, "confusion": self.confusion, "predictions": self.predictions}
        return tables if self.answers.empty else {**tables, "texture_answers": self.answers}

    def shown(self) -> Iterator[tuple[str, Shown]]:
        """Yield the tables for readers, each with the name of the CSV file that has all digits."""
        if len(self.answers):
            yield "texture_answers", shown_answers(self.answers)
        if len(self.beside_paper):
            yield "classification", accuracy.shown_beside_paper(self.beside_paper)
        yield "classification", accuracy.shown_scores(self.table, self.record.unknown_groups, self.record.title)
        yield "confusion", accuracy.recall_table(self.confusion, self.record.unknown_groups)

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        tables = {"texture_answers": self.answers, "scores": self.table, "confusion": self.confusion}
        tables["beside_paper"] = self.beside_paper
        return self.record.document() | {name: records(table) for name, table in tables.items()}

    def figure(self) -> Figure:
        """Draw the accuracies at the hold-out levels, with their intervals."""
        about = (self.record.chance, self.record.unknown_groups)
        titled = self.settings.protocol != "leak-free"
        return accuracy_figures.accuracy_figure(self.table, self.beside_paper, *about, titled=titled)

    def figures(self) -> Mapping[str, Figure]:
        """Draw all figures, by the names of their files without suffix: the accuracies, and the confusion matrices."""
        about = (self.confusion, self.record.textures, self.record.unknown_groups)
        matrices = accuracy_figures.confusion_figures(*about, titled=self.settings.protocol != "leak-free")
        return {FIGURES[self.settings.protocol]: self.figure(), **matrices}

    def save(self, folder: str | Path) -> list[Path]:
        """Write the settings, the tables and the figures (PNG and PDF) into a folder.

        Raises:
            InputError: A file cannot be written.
            MissingToolError: matplotlib is not installed.
        """
        paths = save_results(folder, self.tables, self.figures(), self.record.simulated)
        return [*paths, write_settings(Path(folder) / SETTINGS_FILE, self.record)]
