"""The results that a report shows: the runs and their checks, the variance tables and the classifications."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import pandas as pd

from tacbench_cad.lab.analysis.classification.accuracy import is_whole
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.splits import UNITS, quoted_level, shown_level
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.conclusions import WHICH_TEXTURES
from tacbench_cad.lab.analysis.report.classification import Classification
from tacbench_cad.lab.analysis.report.facts import press_words, record_tables
from tacbench_cad.lab.analysis.report.parts import ReportSection, text_part
from tacbench_cad.lab.analysis.tables import Shown, frame_of, percent, records
from tacbench_cad.lab.analysis.variance.cells import Cell, Level, name_of, parts_of, shown_levels
from tacbench_cad.lab.analysis.variance.grade import Grade
from tacbench_cad.lab.analysis.variance.view import VarianceView
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.util.entries import entries, load
from tacbench_cad.util.errors import MissingToolError
from tacbench_cad.util.text import interval, short

#: The hold-out level at which training has not seen the tested prints.
UNSEEN = "copy"
_OF_CELL = ("force_level", "variance", "low", "high", "noise_alone")
#: The columns of ``textures.csv``, the table to quote.
COLUMNS = (
    *("texture", "printer", "filament", "prints", "presses", *_OF_CELL),
    *("hold_out", "recall", "recall_low", "recall_high"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """The results that a report shows.

    Args:
        collection: The study.
        reports: The results of the check of each run.
        variance: The variance table; None if there is none.
        no_variance: The reason why there is no variance table.
        published: The table of the quantity that the paper printed; None if there is none.
        no_published: The reason why there is no such table.
        grades: The comparison of each printer with the paper's printers.
        classifications: The classifications.
        no_classification: The reason why there is no classification.
    """

    collection: Collection
    reports: tuple[RunReport, ...]
    variance: VarianceView | None = None
    no_variance: str = ""
    published: VarianceView | None = None
    no_published: str = ""
    grades: tuple[Grade, ...] = ()
    classifications: tuple[Classification, ...] = ()
    no_classification: str = ""

    @property
    def leak_free(self) -> Classification | None:
        """The first classification with the leak-free protocol; None if there is none."""
        return next((result for result in self.classifications if result.record.protocol == "leak-free"), None)

    @cached_property
    def records(self) -> Mapping[str, Any]:
        """The tables of the print records."""
        return record_tables(self.collection)

    @cached_property
    def added(self) -> Mapping[str, ReportSection]:
        """The sections that extensions and other packages add, by the names of their entry points.

        An entry point of the group ``tacbench.report_sections`` names a function that makes a section from the results.
        """
        sections = {}
        for name, entry in entries("tacbench.report_sections").items():
            try:
                sections[name] = load(entry)(self)
            except MissingToolError as error:
                sections[name] = ReportSection(title=name, parts=[text_part(f"This section is missing: {error}.")])
        return sections

    @cached_property
    def level(self) -> Level | None:
        """The force level to quote: the level with the most intervals, preferably the mean of all forces."""
        levels = shown_levels(self.variance.cells) if self.variance else ()
        return max(
            reversed(levels), key=lambda level: sum(c.low is not None for c in self.cells_at(level)), default=None
        )

    def cells_at(self, level: Level) -> list[Cell]:
        """Return the cells of the variance table at a force level."""
        return [cell for cell in self.variance.cells if cell.force_level == level] if self.variance else []

    @cached_property
    def hold_out(self) -> str:
        """The hold-out level to quote: unseen prints, or else unseen sessions, or else the easiest computed level."""
        levels = set(self.leak_free.scores["hold_out"]) if self.leak_free else set()
        return next((level for level in (UNSEEN, "session", *UNITS) if level in levels), "")

    @property
    def shown_hold_out(self) -> str:
        """The words for the level to quote: ``on unseen prints``, ``held out: press`` or ``random split, may leak``."""
        quoted = quoted_level(self.hold_out, self.collection.unknown_groups)
        if self.hold_out == UNSEEN:
            return quoted.replace(UNSEEN, "on unseen prints", 1)
        may_leak = shown_level(self.hold_out, self.collection.unknown_groups) != self.hold_out
        return quoted if may_leak else f"held out: {quoted}"

    def score(self, hold_out: str) -> Mapping[str, Any] | None:
        """Return the accuracy of the first estimator at a hold-out level, over all held-out groups; None if missing."""
        rows = self._quoted(self.leak_free.scores, hold_out) if self.leak_free else []
        return next(iter(rows), None)

    def _quoted(self, table: pd.DataFrame, hold_out: str) -> list[dict[str, Any]]:
        """Return the rows of the first estimator at a hold-out level, over all held-out groups."""
        first = self.leak_free.record.estimators[0] if self.leak_free else ""
        mine = table[(table["estimator"] == first) & (table["hold_out"] == hold_out)]
        return [row for row in records(mine) if is_whole(row["tested_on"], row["train_on"])]

    @cached_property
    def confusion(self) -> Mapping[str, Mapping[str, float]]:
        """For each texture, the fraction of its presses by predicted texture: first estimator, quoted level."""
        fractions: dict[str, dict[str, float]] = {}
        for row in self._quoted(self.leak_free.confusion, self.hold_out) if self.leak_free else ():
            if row["fraction"] is not None:
                fractions.setdefault(row["texture"], {})[row["predicted"]] = row["fraction"]
        return fractions

    @cached_property
    def texture_answers(self) -> Mapping[str, Mapping[str, Any]]:
        """The answer for each texture on unseen prints. If nothing is known, the only key is "", with the reason."""
        rows = records(self.leak_free.answers) if self.leak_free else []
        return {row["about"] or "": row for row in rows if row["question"] == WHICH_TEXTURES}

    @cached_property
    def textures(self) -> pd.DataFrame:
        """The main table, with a row for each texture and printer-filament."""
        study = self.collection
        cells = {(cell.texture, cell.combination): cell for cell in self.cells_at(self.level or 0)}
        rows: list[dict[str, Any]] = []
        held_out = quoted_level(self.hold_out, study.unknown_groups)
        for texture in study.textures:
            answer = self.texture_answers.get(texture)
            ends = (answer["low"], answer["high"]) if answer else (None, None)
            recall = self.confusion.get(texture, {}).get(texture)
            for combination in study.combinations:
                there = (study.texture == texture) & (study.combination == combination)
                cell = cells.get((texture, combination))
                if there.any():
                    rows.append(
                        {
                            **parts_of(combination),
                            "texture": texture,
                            "prints": len(set(study.run[there].tolist())) if study.has("print") else None,
                            "presses": int(there.sum()),
                            **{name: getattr(cell, name, None) for name in _OF_CELL},
                            **({"prints": cell.prints, "presses": cell.presses} if cell else {}),
                            "hold_out": held_out if recall is not None else None,
                            "recall": recall,
                            "recall_low": None if ends[0] is None else ends[0] / 100.0,
                            "recall_high": None if ends[1] is None else ends[1] / 100.0,
                        }
                    )
        return frame_of(rows, COLUMNS)

    @property
    def shown_textures(self) -> Shown:
        """The main table as the page shows it, without empty columns."""
        study, table = self.collection, self.textures
        known = {name for name in table if table[name].notna().any()}
        again = table["texture"].duplicated()  # values of a texture are shown in its first row only

        def ends(low: str, high: str, factor: float = 1.0) -> pd.Series[str]:
            pairs = zip(table[low], table[high], strict=True)
            texts = ["" if pd.isna(a) else interval(factor * a, factor * b) for a, b in pairs]
            return pd.Series(texts, index=table.index)

        columns: dict[str, Any] = {"texture": table["texture"].mask(again, "")}
        if len(study.combinations) > 1:
            columns["printer, filament"] = (table["printer"] + "_" + table["filament"]).map(name_of)
        if "prints" in known:
            columns["prints"] = table["prints"]
        columns[press_words(study)[1]] = table["presses"]
        title = "each texture"
        if self.variance and self.level is not None and "variance" in known:
            columns[f"variance ({self.variance.unit})"] = table["variance"].map(short, na_action="ignore")
            columns["95 % interval"] = ends("low", "high").replace("", "none")
            if "noise_alone" in known:
                columns["noise alone"] = table["noise_alone"].map(short, na_action="ignore")
            title += f"; variance: {study.pressing.level_name(self.level)}, ddof {self.variance.settings.ddof}"
        if "recall" in known:
            recall = table["recall"].map(percent).mask(again, "")
            columns[f"predicted correctly, {self.shown_hold_out} (%)"] = recall
            if self.hold_out == UNSEEN:
                texts = ends("recall_low", "recall_high", 100.0).replace("", TOO_FEW)
                columns["its 95 % interval"] = texts.where(recall != "", "")
        return Shown(title, pd.DataFrame(columns))
