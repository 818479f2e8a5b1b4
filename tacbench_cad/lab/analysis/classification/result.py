"""The result of a classification, from which files, printed tables, JSON, figures and reports are made."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification.accuracy import FoldScore, is_whole
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.paper_protocol import COLUMNS as PAPER_COLUMNS
from tacbench_cad.lab.analysis.classification.settings import (
    ClassificationRecord,
    ClassificationSettings,
    shown_protocol,
)
from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.conclusions import Answer, answer_table, shown_answers
from tacbench_cad.lab.analysis.tables import Shown, frame_of, intervals, percent, records
from tacbench_cad.util.convert import to_plain

#: The columns that name a row: how it was trained, and on what it was tested.
WHO = ("protocol", "estimator", "train_on", "tested_on", "hold_out")
#: The columns of ``classification.csv``, ``sweep.csv``, and the keys of a score in JSON.
COLUMNS = (*WHO, "accuracy", "low", "high", "trials", "images")
SWEEP_COLUMNS = (*WHO, "parameter", "value", "accuracy", "low", "high", "standard_deviation", "trials", "images")
SCORE_COLUMNS = (*WHO, "accuracy", "standard_deviation", "low", "high", "units", "trials", "images", "recall")
#: The columns of ``confusion.csv`` and of ``predictions.csv``.
CONFUSION_COLUMNS = (*WHO, "texture", "predicted", "count", "fraction")
PREDICTION_COLUMNS = (*WHO, "trial", "run", "press", "augmentation", "texture", "predicted")


def shown_scores(scores: pd.DataFrame, unknown_groups: Sequence[str], title: str, parameter: str = "") -> Shown:
    """Return a table of accuracies for readers.

    Args:
        scores: The accuracies, with :data:`COLUMNS` and perhaps more columns.
        unknown_groups: See :attr:`.Collection.unknown_groups`.
        title: The title.
        parameter: The setting of a sweep, whose column is ``value``.
    """
    frame = scores[["estimator", "train_on", "tested_on"]].copy()
    frame.insert(1, "held out", [shown_level(level, unknown_groups) for level in scores["hold_out"]])
    if parameter:
        frame = frame.drop(columns="tested_on").assign(**{parameter: scores["value"].map("{:g}".format)})
    for name in ("accuracy", "standard_deviation"):
        if name in scores:
            frame[name] = scores[name].map(percent)
    frame["95 % interval"] = intervals(scores, empty=TOO_FEW)
    for name in ("units", "trials", "images"):
        if name in scores and not (parameter and name != "images"):
            frame[name] = scores[name]
    names = {name: str(name).replace("_", " ") for name in frame} | {"train_on": "trained on"}
    return Shown(title, frame.rename(columns=names))


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """The result of a classification, or of a sweep.

    Args:
        settings: The settings.
        outcomes: The predictions of the estimators, see :data:`.outcomes.OUTCOMES`; empty for a sweep.
        scores: The rows of the table.
        notes: Warnings, the hold-out levels that are left out, and the choices made where the paper is unclear.
        collection: The data.
        answers: The answers which textures can be told apart; empty except for the leak-free protocol.
        parameter: The setting of a sweep; empty for a single classification. A sweep has rows only for complete
            hold-out levels.
        values: The value of the setting in each row of a sweep.
    """

    settings: ClassificationSettings
    outcomes: pd.DataFrame
    scores: tuple[FoldScore, ...]
    notes: tuple[str, ...]
    collection: Collection
    answers: tuple[Answer, ...] = ()
    parameter: str = ""
    values: tuple[float, ...] = ()

    @property
    def textures(self) -> tuple[str, ...]:
        """The textures, sorted."""
        return self.collection.textures

    @property
    def chance(self) -> float:
        """The accuracy expected from guessing, from 0 to 1."""
        return 1.0 / len(self.textures)

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The stored tables, by the names of their files.

        Training rows of the paper's protocol are in the first two tables, but not in the predictions.
        """
        if self.parameter:
            return {"sweep.csv": self._swept[list(SWEEP_COLUMNS)]}
        return {
            "classification.csv": frame_of(self.scores, COLUMNS),
            "confusion.csv": frame_of(self._confusions(), CONFUSION_COLUMNS),
            "predictions.csv": self._predictions()[list(PREDICTION_COLUMNS)],
            "texture_answers.csv": answer_table(self.answers),
        }

    @property
    def shown(self) -> Iterator[Shown]:
        """The tables that are printed."""
        unknown = self.collection.unknown_groups
        protocol = shown_protocol(self.settings.protocol, unknown)
        title = f"protocol {protocol}, in %; chance is {100.0 * self.chance:.1f}"
        if self.parameter:
            yield shown_scores(self._swept, unknown, title, self.parameter)
            return
        if self.answers:
            yield shown_answers(answer_table(self.answers))
        if beside_paper(self):
            yield self._paper_shown()
        yield shown_scores(frame_of(self.scores, SCORE_COLUMNS), unknown, title)
        yield recall_table(frame_of(self._confusions(), CONFUSION_COLUMNS), unknown)

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        protocol = shown_protocol(self.settings.protocol, self.collection.unknown_groups)
        settings = {**to_plain(self.settings), "protocol": protocol}
        head = {"simulated": list(self.collection.simulated), "settings": settings}
        scores = records(frame_of(self.scores, SCORE_COLUMNS))
        if self.parameter:
            points = [{self.parameter: value, **row} for value, row in zip(self.values, scores, strict=True)]
            return {**head, "parameter": self.parameter, "points": points, "notes": list(self.notes)}
        return {
            **head,
            "textures": list(self.textures),
            "chance": self.chance,
            "texture_answers": to_plain(self.answers),
            "scores": scores,
            "beside_paper": to_plain(beside_paper(self)),
            "notes": list(self.notes),
        }

    @property
    def record(self) -> ClassificationRecord:
        """The settings and the data of the classification."""
        return ClassificationRecord(
            **vars(self.settings),
            trials=int(self.outcomes["trial"].max()),
            textures=self.textures,
            sensor=str(self.collection.info.sensor.get("name", "")),
            units=self.settings.feature.unit or self.collection.units,
            summary=self.settings.feature.summary,
            simulated=self.collection.simulated,
            data=self.collection.data_key,
            unknown_groups=self.collection.unknown_groups,
            notes=self.notes,
        )

    @property
    def _swept(self) -> pd.DataFrame:
        """The rows of a sweep with all columns."""
        number = float if self.parameter == "resolution" else int
        values = [number(value) for value in self.values]
        return frame_of(self.scores, SCORE_COLUMNS).assign(parameter=self.parameter, value=values)

    def _confusions(self) -> Iterator[dict[str, Any]]:
        for score in self.scores:
            who = {name: getattr(score, name) for name in WHO}
            fractions = score.fractions
            for (i, j), count in np.ndenumerate(score.confusion):
                names = {"texture": self.textures[i], "predicted": self.textures[j]}
                yield {**who, **names, "count": int(count), "fraction": float(fractions[i, j])}

    def _predictions(self) -> pd.DataFrame:
        """The rows of ``predictions.csv``."""
        rows, collection = self.outcomes[self.outcomes["hold_out"] != "train"], self.collection
        press = rows["press"].to_numpy()
        return rows.assign(
            protocol=shown_protocol(self.settings.protocol, collection.unknown_groups),
            run=np.array([run.info.printed.name for run in collection.runs])[collection.run[press]],
            press=collection.number[press],
            augmentation=np.array(self.settings.augmentation.names)[rows["copied"]],
            texture=collection.texture[press],
        )

    def _paper_shown(self) -> Shown:
        rows = []
        for row in beside_paper(self):
            cells = {"estimator": row.estimator, "trained on": row.train_on}
            for column, *values in zip(PAPER_COLUMNS["as-published"], row.ours, row.paper, strict=True):
                texts = ["" if value is None else f"{value:.2f}" for value in values]
                cells |= {f"{column}, {whose}": text for whose, text in zip(("ours", "paper"), texts, strict=True)}
            rows.append(cells)
        title = "your results beside the paper's table, in % (computed as in the authors' notebooks; other copies: "
        return Shown(title + "without copy 1)", pd.DataFrame(rows).drop(columns="other copies, paper"))


def recall_table(confusion: pd.DataFrame, unknown_groups: Sequence[str]) -> Shown:
    """Return the recall of each texture at complete hold-out levels, from the rows of ``confusion.csv``."""
    recalls: dict[tuple[str, ...], dict[str, str]] = {}
    for row in records(confusion[confusion["texture"] == confusion["predicted"]]):
        if is_whole(row["tested_on"], row["train_on"]):
            level = shown_level(row["hold_out"], unknown_groups)
            who = {"estimator": row["estimator"], "held out": level, "trained on": row["train_on"]}
            of_row = recalls.setdefault(tuple(who.values()), who)
            of_row[row["texture"]] = "" if row["fraction"] is None else percent(row["fraction"])
    return Shown("recall of each texture (%)", pd.DataFrame(recalls.values()))


@dataclass(frozen=True, kw_only=True)
class Beside:
    """A row of our results with the same row of the paper's table, in %; None for missing values.

    Args:
        estimator: The estimator.
        train_on: The training combination.
        ours: Our accuracies: train, test, all copies, other copies.
        paper: The paper's accuracies: train, test, unseen prints (which are all copies), and None for other copies.
    """

    estimator: str
    train_on: str
    ours: tuple[float | None, ...]
    paper: tuple[float | None, ...]


def beside_paper(result: Result) -> list[Beside]:
    """Return our results with the paper's table, one row for each combination; empty for other quantities."""
    if result.settings.protocol != "as-published" or result.parameter:
        return []
    printed = {
        ("_".join(row.train_on), row.model): (row.train, row.test, row.unseen, None) for row in published.CLASSIFICATION
    }
    accuracies = {
        (score.train_on, score.estimator, score.hold_out): 100.0 * score.accuracy
        for score in result.scores
        if score.whole
    }
    return [
        Beside(
            estimator=name,
            train_on=train_on,
            ours=tuple(accuracies.get((train_on, name, column)) for column in PAPER_COLUMNS["as-published"]),
            paper=printed.get((train_on, name), (None,) * 4),
        )
        for train_on in result.settings.train_on
        for name in result.settings.estimators
    ]
