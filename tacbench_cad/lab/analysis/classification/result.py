"""The result of a classification, from which files, printed tables, JSON, figures and reports are made."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.classification.accuracy import FoldScore, is_whole
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.outcomes import TestOutcome
from tacbench_cad.lab.analysis.classification.paper_protocol import COLUMNS as PAPER_COLUMNS
from tacbench_cad.lab.analysis.classification.settings import (
    ClassificationRecord,
    ClassificationSettings,
    shown_protocol,
)
from tacbench_cad.lab.analysis.classification.splits import shown_level
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.conclusions import COLUMNS as ANSWER_COLUMNS
from tacbench_cad.lab.analysis.conclusions import Answer, shown
from tacbench_cad.lab.analysis.tables import Column, Row, Table, interval_column, percent
from tacbench_cad.util.convert import to_plain

_WHO = (
    Column("protocol"),
    Column("estimator"),
    Column("train_on", head="trained on"),
    Column("tested_on"),
    Column("hold_out", head="held out"),
)
_ACCURACY = Column("accuracy", float, text=percent, right=True)
_ENDS = (Column("low", float, text=percent), Column("high", float, text=percent))
_DEVIATION = Column("standard_deviation", float, text=percent, right=True)
_COUNTS = (Column("trials", int), Column("images", int))
#: The columns of ``classification.csv``.
COLUMNS = (*_WHO, _ACCURACY, *_ENDS, *_COUNTS)
#: The columns of ``confusion.csv``.
CONFUSION_COLUMNS = (*_WHO, Column("texture"), Column("predicted"), Column("count", int), Column("fraction", float))
#: The columns of ``predictions.csv``.
PREDICTION_COLUMNS = (
    *(*_WHO, Column("trial", int), Column("run"), Column("press", int), Column("augmentation"), Column("texture")),
    Column("predicted"),
)
#: The columns of ``sweep.csv``.
SWEEP_COLUMNS = (
    *(*_WHO, Column("parameter"), Column("value", float)),
    *(_ACCURACY, *_ENDS, _DEVIATION, *_COUNTS),
)
#: The keys of a score in JSON.
SCORE_COLUMNS = (*_WHO, _ACCURACY, _DEVIATION, *_ENDS, Column("units"), *_COUNTS, Column("recall"))


def level_column(unknown_groups: Sequence[str]) -> Column:
    """Return the column of hold-out levels for readers, see :func:`.splits.shown_level`."""
    return Column("hold_out", head="held out", text=lambda level: shown_level(level, unknown_groups))


def shown_scores(unknown_groups: Sequence[str]) -> tuple[str | Column, ...]:
    """Return the printed columns of a score."""
    return (
        *("estimator", level_column(unknown_groups), "train_on", "tested_on", "accuracy", "standard_deviation"),
        *(interval_column(empty=TOO_FEW), "units", "trials", "images"),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """The result of a classification, or of a sweep.

    Args:
        settings: The settings.
        outcomes: The predictions of the estimators.
        scores: The rows of the table.
        notes: Warnings, the hold-out levels that are left out, and the choices made where the paper is unclear.
        collection: The data.
        answers: The answers which textures can be told apart; empty except for the leak-free protocol.
        parameter: The setting of a sweep; empty for a single classification. A sweep has rows only for complete
            hold-out levels.
        values: The value of the setting in each row of a sweep.
    """

    settings: ClassificationSettings
    outcomes: tuple[TestOutcome, ...]
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
    def tables(self) -> dict[str, Table]:
        """The stored tables, by the names of their files.

        Training rows of the paper's protocol are in the first two tables, but not in the predictions.
        """
        if self.parameter:
            return {"sweep.csv": self._swept}
        return {
            "classification.csv": Table.of(COLUMNS, self.scores),
            "confusion.csv": Table.of(CONFUSION_COLUMNS, self._confusions()),
            "predictions.csv": Table.of(PREDICTION_COLUMNS, self._predictions()),
            "texture_answers.csv": Table.of(ANSWER_COLUMNS, self.answers),
        }

    @property
    def shown(self) -> Iterator[Table]:
        """The tables that are printed."""
        unknown = self.collection.unknown_groups
        protocol = shown_protocol(self.settings.protocol, unknown)
        title = f"protocol {protocol}, in %; chance is {100.0 * self.chance:.1f}"
        if self.parameter:
            value = Column("value", head=self.parameter, text=lambda value: f"{value:g}")
            shown_columns = shown_scores(unknown)
            yield self._swept.select(*shown_columns[:3], value, *shown_columns[4:7], "images", title=title)
            return
        if self.answers:
            yield shown(Table.of(ANSWER_COLUMNS, self.answers))
        if beside_paper(self):
            yield self._paper_shown()
        yield Table.of(SCORE_COLUMNS, self.scores).select(*shown_scores(unknown), title=title)
        yield recall_table(Table.of(CONFUSION_COLUMNS, self._confusions()), unknown)

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        protocol = shown_protocol(self.settings.protocol, self.collection.unknown_groups)
        settings = {**to_plain(self.settings), "protocol": protocol}
        head = {"simulated": list(self.collection.simulated), "settings": settings}
        if self.parameter:
            pairs = zip(self.values, self._swept.select(*SCORE_COLUMNS).records(), strict=True)
            points = [{self.parameter: value, **row} for value, row in pairs]
            return {**head, "parameter": self.parameter, "points": points, "notes": list(self.notes)}
        return {
            **head,
            "textures": list(self.textures),
            "chance": self.chance,
            "texture_answers": to_plain(self.answers),
            "scores": Table.of(SCORE_COLUMNS, self.scores).records(),
            "beside_paper": to_plain(beside_paper(self)),
            "notes": list(self.notes),
        }

    @property
    def record(self) -> ClassificationRecord:
        """The settings and the data of the classification."""
        return ClassificationRecord(
            **vars(self.settings),
            trials=max(outcome.trial for outcome in self.outcomes),
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
    def _swept(self) -> Table:
        """The rows of a sweep with all columns."""
        number = float if self.parameter == "resolution" else int
        rows = [
            {"parameter": self.parameter, "value": number(value), **row}
            for value, row in zip(self.values, Table.of(SCORE_COLUMNS, self.scores).rows, strict=True)
        ]
        return Table(columns=SWEEP_COLUMNS, rows=tuple(rows))

    def _confusions(self) -> Iterator[Row]:
        for score in self.scores:
            who = {column.name: getattr(score, column.name) for column in _WHO}
            fractions = score.fractions
            for (i, j), count in np.ndenumerate(score.confusion):
                yield {
                    **who,
                    "texture": self.textures[i],
                    "predicted": self.textures[j],
                    "count": int(count),
                    "fraction": None if np.isnan(fractions[i, j]) else float(fractions[i, j]),
                }

    def _predictions(self) -> Iterator[Row]:
        names = [run.info.printed.name for run in self.collection.runs]
        runs, numbers = self.collection.run.tolist(), self.collection.number.tolist()
        truth = self.collection.texture.tolist()
        copies = self.settings.augmentation.names
        for outcome in self.outcomes:
            if outcome.hold_out == "train":
                continue
            who = {"protocol": shown_protocol(self.settings.protocol, self.collection.unknown_groups)}
            who |= {column.name: getattr(outcome, column.name) for column in _WHO[1:]}
            rows = (outcome.press.tolist(), outcome.copied.tolist(), outcome.predicted.tolist())
            for press, copied, predicted in zip(*rows, strict=True):
                yield {
                    **who,
                    "trial": outcome.trial,
                    "run": names[runs[press]],
                    "press": numbers[press],
                    "augmentation": copies[copied],
                    "texture": truth[press],
                    "predicted": self.textures[predicted],
                }

    def _paper_shown(self) -> Table:
        def two_digits(value: float) -> str:
            return f"{value:.2f}"

        heads = [f"{column}, {whose}" for column in PAPER_COLUMNS["as-published"] for whose in ("ours", "paper")]
        rows = []
        for row in beside_paper(self):
            values = [value for pair in zip(row.ours, row.paper, strict=True) for value in pair]
            rows.append({**dict(zip(heads, values, strict=True)), "estimator": row.estimator, "train_on": row.train_on})
        columns = [Column(head, float, text=two_digits, right=True) for head in heads[:-1]]
        title = "your results beside the paper's table, in % (computed as in the authors' notebooks; other copies: "
        title += "without copy 1)"
        return Table.of((*_WHO[1:3], *columns), rows, title)


def recall_table(confusion: Table, unknown_groups: Sequence[str]) -> Table:
    """Return the recall of each texture at complete hold-out levels, from the rows of ``confusion.csv``."""
    recalls: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in confusion.rows:
        if is_whole(row["tested_on"], row["train_on"]) and row["texture"] == row["predicted"]:
            who = {name: row[name] for name in ("estimator", "hold_out", "train_on")}
            recalls.setdefault(tuple(who.values()), who)[row["texture"]] = row["fraction"]
    textures = dict.fromkeys(row["texture"] for row in confusion.rows)
    columns = (
        _WHO[1],
        level_column(unknown_groups),
        _WHO[2],
        *(Column(name, float, head=name, text=percent, right=True) for name in textures),
    )
    return Table.of(columns, recalls.values(), "recall of each texture (%)")


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
