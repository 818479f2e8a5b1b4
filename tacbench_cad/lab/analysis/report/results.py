"""The results that a report shows: the runs and their checks, the variance tables and the classifications."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pandas as pd

from tacbench_cad.lab.analysis.classification.accuracy_intervals import TOO_FEW
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.classification.hold_out import UNITS, quoted_level, shown_level
from tacbench_cad.lab.analysis.conclusions import WHICH_TEXTURES
from tacbench_cad.lab.analysis.report.facts import press_words, print_records, prints_by_group
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.tables import Shown, frame_of, percent, records
from tacbench_cad.lab.analysis.variance.cells import Level, name_of, parts_of, shown_levels, squared
from tacbench_cad.lab.analysis.variance.grading import Grades
from tacbench_cad.lab.analysis.variance.result import Variance
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


@dataclass(frozen=True, kw_only=True)
class ReportSection:
    """A section of a page. A section without parts is left out.

    Args:
        title: The title.
        parts: The parts, in the order of the page: a text is a paragraph, a list of texts is a list, and
            :class:`~tacbench_cad.lab.analysis.tables.Shown` is a table.
        tables: The tables of the section with all digits, by the names of their CSV files.
    """

    title: str
    parts: Sequence[str | Sequence[str] | Shown] = ()
    tables: Mapping[str, pd.DataFrame] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, eq=False)
class Results:
    """The results that a report shows.

    Args:
        design: The design of the study, with its table of presses and its runs.
        reports: The results of the check of each run.
        variance: The variance table; None if there is none.
        no_variance: The reason why there is no variance table.
        grades: The comparison of each printer with the paper's printers; None if there is none.
        no_grades: The reason why there is no comparison.
        classifications: The classifications.
        no_classification: The reason why there is no classification.
    """

    design: Design
    reports: tuple[RunReport, ...] = ()
    variance: Variance | None = None
    no_variance: str = ""
    grades: Grades | None = None
    no_grades: str = ""
    classifications: tuple[Classification, ...] = ()
    no_classification: str = ""

    @property
    def leak_free(self) -> Classification | None:
        """The first classification with the leak-free protocol; None if there is none."""
        return next((result for result in self.classifications if result.settings.protocol == "leak-free"), None)

    @cached_property
    def records(self) -> tuple[pd.DataFrame, list[str]]:
        """The print records, and the errors of unreadable records."""
        return print_records(self.design)

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
                sections[name] = ReportSection(title=name, parts=[f"This section is missing: {error}."])
        return sections

    @cached_property
    def level(self) -> Level | None:
        """The force level to quote: the level with the most intervals, preferably the mean of all forces."""
        if self.variance is None:
            return None
        table = self.variance.table
        return max(
            reversed(shown_levels(table)), key=lambda level: table.loc[table["force_level"] == level, "low"].count()
        )

    @cached_property
    def cells(self) -> pd.DataFrame:
        """The rows of the variance table at the quoted force level; none without a variance table."""
        if self.variance is None:
            return pd.DataFrame(columns=["printer", "filament", "texture", *_OF_CELL])
        return self.variance.table[self.variance.table["force_level"] == self.level]

    @cached_property
    def unit(self) -> str:
        """The unit of a variance: ``counts^2``; empty without a variance table."""
        return squared(self.variance.units) if self.variance else ""

    @cached_property
    def floor_sources(self) -> set[str]:
        """The sources of the noise floors."""
        return set(self.variance.table["floor_from"]) - {""} if self.variance else set()

    @cached_property
    def hold_out(self) -> str:
        """The hold-out level to quote: unseen prints, or else unseen sessions, or else the easiest computed level."""
        levels = set(self.leak_free.table["hold_out"]) if self.leak_free else set()
        return next((level for level in (UNSEEN, "session", *UNITS) if level in levels), "")

    @property
    def may_leak(self) -> bool:
        """Whether similar samples may be on both sides of the quoted split."""
        return shown_level(self.hold_out, self.design.unknown_groups) != self.hold_out

    @property
    def shown_hold_out(self) -> str:
        """The words for the level to quote: ``on unseen prints``, ``held out: press`` or ``random split, may leak``."""
        quoted = quoted_level(self.hold_out, self.design.unknown_groups)
        if self.hold_out == UNSEEN:
            return quoted.replace(UNSEEN, "on unseen prints", 1)
        return quoted if self.may_leak else f"held out: {quoted}"

    @property
    def score(self) -> Mapping[str, Any] | None:
        """The accuracy of the first estimator at the quoted level, over all held-out groups; None if missing."""
        rows = records(self._quoted(self.leak_free.whole)) if self.leak_free else []
        return next(iter(rows), None)

    def _quoted(self, table: pd.DataFrame) -> pd.DataFrame:
        """Return the rows of the first estimator at the quoted hold-out level."""
        first = self.leak_free.settings.estimators[0] if self.leak_free else ""
        return table[(table["estimator"] == first) & (table["hold_out"] == self.hold_out)]

    @cached_property
    def confusion(self) -> Mapping[str, Mapping[str, float]]:
        """For each texture, the fraction of its presses by predicted texture: first estimator, quoted level."""
        fractions: dict[str, dict[str, float]] = {}
        for row in records(self._quoted(self.leak_free.confusion).dropna(subset="fraction")) if self.leak_free else ():
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
        by = ["texture", "printer", "filament"]
        cells = {tuple(row[name] for name in by): row for row in records(self.cells)}
        rows: list[dict[str, Any]] = []
        for (texture, combination), there in prints_by_group(self.design, "texture", "combination"):
            row = dict.fromkeys(COLUMNS) | {"texture": texture, **parts_of(combination), "presses": len(there)}
            row["prints"] = there["run"].nunique() if self.design.has("print") else None
            row |= cells.get(tuple(row[name] for name in by), {})
            row["recall"] = self.confusion.get(texture, {}).get(texture)
            if row["recall"] is not None:
                row["hold_out"] = quoted_level(self.hold_out, self.design.unknown_groups)
            answer = self.texture_answers.get(texture, {})
            row |= {f"recall_{end}": answer[end] / 100.0 for end in ("low", "high") if answer.get(end) is not None}
            rows.append(row)
        return frame_of(rows, COLUMNS)

    @property
    def shown_textures(self) -> Shown:
        """The main table as the page shows it, without empty columns."""
        table = self.textures
        known = table.notna().any()
        again = table["texture"].duplicated()  # values of a texture are shown in its first row only

        def ends(low: str, high: str, factor: float = 1.0) -> list[str]:
            pairs = zip(table[low], table[high], strict=True)
            return ["" if pd.isna(a) else interval(factor * a, factor * b) for a, b in pairs]

        columns: dict[str, Any] = {"texture": table["texture"].mask(again, "")}
        if len(self.design.combinations) > 1:
            columns["printer, filament"] = (table["printer"] + "_" + table["filament"]).map(name_of)
        if known["prints"]:
            columns["prints"] = table["prints"]
        columns[press_words(self.design)[1]] = table["presses"]
        title = "each texture"
        if self.variance and self.level is not None and known["variance"]:
            columns[f"variance ({self.unit})"] = table["variance"].map(short, na_action="ignore")
            columns["95 % interval"] = [text or "none" for text in ends("low", "high")]
            if known["noise_alone"]:
                columns["noise alone"] = table["noise_alone"].map(short, na_action="ignore")
            title += f"; variance: {self.design.level_name(self.level)}, ddof {self.variance.ddof}"
        if known["recall"]:
            recall = table["recall"].map(percent).mask(again, "")
            columns[f"predicted correctly, {self.shown_hold_out} (%)"] = recall
            if self.hold_out == UNSEEN:
                texts = pd.Series(ends("recall_low", "recall_high", 100.0), table.index).replace("", TOO_FEW)
                columns["its 95 % interval"] = texts.where(recall != "", "")
        return Shown(title, pd.DataFrame(columns))
