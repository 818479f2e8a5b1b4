"""The results that a report shows: the runs and their checks, the variance tables and the classifications."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from tacbench_cad.lab.analysis.classification.accuracy import is_whole
from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.splits import UNITS, quoted_level, shown_level
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.conclusions import WHICH_TEXTURES
from tacbench_cad.lab.analysis.report.classification import Classification
from tacbench_cad.lab.analysis.report.facts import press_words, record_tables
from tacbench_cad.lab.analysis.report.parts import ReportSection, text_part
from tacbench_cad.lab.analysis.tables import Column, Row, Table, percent
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
    *(Column("texture"), Column("printer"), Column("filament")),
    *(Column("prints", int), Column("presses", int)),
    *(Column(_OF_CELL[0]), *(Column(name, float) for name in _OF_CELL[1:])),
    *(Column("hold_out"), Column("recall", float), Column("recall_low", float), Column("recall_high", float)),
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
        levels = {row["hold_out"] for row in self.leak_free.scores.rows} if self.leak_free else set()
        return next((level for level in (UNSEEN, "session", *UNITS) if level in levels), "")

    @property
    def shown_hold_out(self) -> str:
        """The words for the level to quote: ``on unseen prints``, ``held out: press`` or ``random split, may leak``."""
        quoted = quoted_level(self.hold_out, self.collection.unknown_groups)
        if self.hold_out == UNSEEN:
            return quoted.replace(UNSEEN, "on unseen prints", 1)
        may_leak = shown_level(self.hold_out, self.collection.unknown_groups) != self.hold_out
        return quoted if may_leak else f"held out: {quoted}"

    def score(self, hold_out: str) -> Row | None:
        """Return the accuracy of the first estimator at a hold-out level, over all held-out groups; None if missing."""
        first = self.leak_free.record.estimators[0] if self.leak_free else ""
        rows = self.leak_free.scores.rows if self.leak_free else ()
        whole = (row for row in rows if row["estimator"] == first and is_whole(row["tested_on"], row["train_on"]))
        return next((row for row in whole if row["hold_out"] == hold_out), None)

    @cached_property
    def confusion(self) -> Mapping[str, Mapping[str, float]]:
        """For each texture, the fraction of its presses by predicted texture: first estimator, quoted level."""
        fractions: dict[str, dict[str, float]] = {}
        if self.leak_free:
            for row in self.leak_free.confusion.rows:
                quoted = (row["estimator"], row["hold_out"]) == (self.leak_free.record.estimators[0], self.hold_out)
                if quoted and is_whole(row["tested_on"], row["train_on"]) and row["fraction"] is not None:
                    fractions.setdefault(row["texture"], {})[row["predicted"]] = row["fraction"]
        return fractions

    @cached_property
    def texture_answers(self) -> Mapping[str, Row]:
        """The answer for each texture on unseen prints. If nothing is known, the only key is "", with the reason."""
        rows = self.leak_free.answers.rows if self.leak_free else ()
        return {row["about"] or "": row for row in rows if row["question"] == WHICH_TEXTURES}

    @cached_property
    def textures(self) -> Table:
        """The main table, with a row for each texture and printer-filament."""
        study = self.collection
        cells = {(cell.texture, cell.combination): cell for cell in self.cells_at(self.level or 0)}
        rows: list[Row] = []
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
        return Table(columns=COLUMNS, rows=tuple(rows))

    @property
    def shown_textures(self) -> Table:
        """The main table as the page shows it, without empty columns."""
        study = self.collection
        rows = self.textures.rows
        firsts = {row["texture"]: row for row in reversed(rows)}
        known = {name for row in rows for name, value in row.items() if value is not None}

        def once(name: str, text: Callable[[Row], str]) -> Callable[[Row], str]:
            """Show a value that belongs to the texture, not to the printer, only in the first row of the texture."""
            return lambda row: text(row) if row[name] is not None and firsts[row["texture"]] is row else ""

        def printer(row: Row) -> str:
            return name_of(f"{row['printer']}_{row['filament']}")

        def ends(low: str, high: str, times: float = 1.0) -> Callable[[Row], str]:
            return lambda row: interval(*(None if row[end] is None else times * row[end] for end in (low, high)))

        def recall_ends(row: Row) -> str:
            return TOO_FEW if row["recall_low"] is None else ends("recall_low", "recall_high", 100.0)(row)

        columns = [Column("texture", derived=once("texture", lambda row: str(row["texture"])))]
        if len(study.combinations) > 1:
            columns.append(Column("name", head="printer, filament", derived=printer))
        columns += [Column("prints")] if "prints" in known else []
        columns.append(Column("presses", head=press_words(study)[1]))
        title = "each texture"
        if self.variance and self.level is not None and "variance" in known:
            columns.append(Column("variance", head=f"variance ({self.variance.unit})", text=short))
            columns.append(Column("ends", head="95 % interval", derived=ends("low", "high"), right=True))
            columns += [Column("noise_alone", text=short)] if "noise_alone" in known else []
            title += f"; variance: {study.pressing.level_name(self.level)}, ddof {self.variance.settings.ddof}"
        if "recall" in known:
            recall = once("recall", lambda row: percent(row["recall"]))
            head = f"predicted correctly, {self.shown_hold_out} (%)"
            columns.append(Column("right", head=head, derived=recall, right=True))
            if self.hold_out == UNSEEN:
                both = once("recall", recall_ends)
                columns.append(Column("recall_ends", head="95 % interval", derived=both, right=True))
        return replace(self.textures, columns=tuple(columns), title=title)
