"""The sections of a report: what each says and shows, from the runs and from the files of the analyses."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.lab.analysis.classification.settings import data_key
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.csvfile import write_csv
from tacbench_cad.lab.analysis.report import html, methods
from tacbench_cad.lab.analysis.report.cite import citations
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.spec.printrecord import FIELDS, PrintRecord
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

#: Findings of a run that the page shows; all of them stand in the CSV file.
MOST_FINDINGS = 5


@dataclass(frozen=True, kw_only=True)
class Study:
    """What every section reads.

    Args:
        collection: The presses.
        files: Folder of the report's tables and figures.
    """

    collection: Collection
    files: Path

    @property
    def simulated(self) -> bool:
        """Whether anything of it was simulated."""
        return bool(self.collection.simulated)

    def file(self, name: str) -> str:
        """What a table's or a figure's caption says of its files."""
        return f"{self.files.name}/{name}"


def read_rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """The rows of a table that an analysis wrote.

    Raises:
        InputError: The file is missing, or lacks a column.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            reader = csv.DictReader(stream, restval="")
            rows = list(reader)
    except OSError as error:
        raise InputError("table", str(path), f"cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError("table", str(path), f"is no CSV file in UTF-8: {error}") from None
    lacking = [one for one in columns if one not in (reader.fieldnames or ())]
    if lacking:
        raise InputError("table", str(path), f"has no column {lacking[0]}; have it written again")
    return rows


def value(text: str) -> Any:
    """A cell as a number if it is one, None if it is empty, else its text."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text or None


def design_section(study: Study) -> Iterator[str]:
    """What was pressed on what."""
    collection = study.collection
    rows = methods.counts_rows(collection)
    columns = list(rows[0])
    write_csv(study.files / "design.csv", columns, rows)
    yield html.paragraph(methods.design_text(collection))
    heads = ["printer", "filament", "texture", "prints", *(f"presses, level {n}" for n in collection.levels)]
    cells = [[row[name] for name in columns] for row in rows]
    yield html.table("Prints and presses", heads, cells, study.simulated, study.file("design.csv"))


def records_section(study: Study) -> Iterator[str]:
    """The print records and what is missing in them."""
    records: list[tuple[str, PrintRecord]] = []
    damaged: list[str] = []
    for run in study.collection.runs:
        try:
            records.append((run.info.printed.name, run.print_record))
        except InputError as error:
            damaged.append(str(error))
    columns = ("run", *FIELDS)
    rows = [{"run": name, **{field: _plain(one.values.get(field)) for field in FIELDS}} for name, one in records]
    write_csv(study.files / "print_records.csv", columns, rows)
    empty = Counter(field for _, one in records for field in one.empty)
    total = len(records)
    if empty:
        yield html.paragraph(
            f"Of {total} print records these fields are empty in some; what nobody wrote down cannot explain a "
            "difference between prints later."
        )
        yield html.table(
            "Empty fields of the print records",
            ("field", "what belongs there", "empty in", "of records"),
            [(field, FIELDS[field], count, total) for field, count in empty.items()],
            study.simulated,
            study.file("print_records.csv"),
        )
    elif total:
        yield html.paragraph(f"All fields of all {total} print records are filled in.")
    filled = [field for field in FIELDS if any(one.values.get(field) for _, one in records)]
    if filled and total:
        yield html.table(
            "What the print records say, alike prints together",
            (*filled, "prints"),
            _alike(records, filled),
            study.simulated,
            study.file("print_records.csv"),
        )
    if damaged:
        yield html.paragraph("Records that cannot be read:")
        yield html.bullets(damaged)


def _alike(records: Sequence[tuple[str, PrintRecord]], fields: Sequence[str]) -> list[list[Any]]:
    counts = Counter(tuple(_plain(one.values.get(field)) for field in fields) for _, one in records)
    return [[*values, count] for values, count in counts.items()]


def _plain(entry: Any) -> Any:
    return "; ".join(map(str, entry)) if isinstance(entry, list) else entry


def quality_section(study: Study, reports: Sequence[RunReport]) -> Iterator[str]:
    """Data quality: every run examined as `tacbench runs check` does."""
    columns = ("run", "planned", "presses", "out_of_band", "references", "stationary", "findings")
    rows: list[dict[str, Any]] = []
    for one in reports:
        row = {name: getattr(one, name) for name in ("planned", "presses", "out_of_band", "references", "stationary")}
        rows.append({"run": one.name, **row, "findings": len(one.findings)})
    write_csv(study.files / "data_quality.csv", columns, rows)
    found = [{"run": one.name, **finding.as_dict()} for one in reports for finding in one.findings]
    write_csv(study.files / "findings.csv", ("run", "kind", "where", "text"), found)
    planned, there = sum(one.planned for one in reports), sum(one.presses for one in reports)
    outside = sum(one.out_of_band for one in reports)
    faulty = [one for one in reports if one.findings]
    yield html.paragraph(
        f"{there:,} of {planned:,} planned presses are there; in {outside:,} of them the force lay outside of its band "
        f"(they say so and are kept). Every reading was compared with its checksum and judged for darkness, blur and "
        f"being stuck: {len(reports) - len(faulty)} of {len(reports)} runs have no finding, "
        f"{counted(len(found), 'finding')} in all."
    )
    if faulty:
        shown = [
            (one.name, finding.kind, finding.where, finding.text)
            for one in faulty
            for finding in one.findings[:MOST_FINDINGS]
        ]
        caption = f"Findings, at most {MOST_FINDINGS} of a run"
        yield html.table(caption, ("run", "kind", "where", "what"), shown, study.simulated, study.file("findings.csv"))
    yield html.paragraph(f"All runs: {study.file('data_quality.csv')}", "files")


def read_settings(path: Path) -> dict[str, Any]:
    """What an analysis was asked for, from the file that it left beside its tables.

    Raises:
        InputError: The file is missing or damaged.
    """
    try:
        found = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError("settings", str(path), f"cannot be read: {error.strerror}; run the analysis again") from None
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError("settings", str(path), "is no JSON object; run the analysis again")
    return found


def require_same(option: str, path: Path, collection: Collection) -> Mapping[str, Any]:
    """What an analysis was asked for, if its folder is of these presses.

    Raises:
        InputError: It is of others, or its files are damaged.
    """
    settings = read_settings(path)
    if settings.get("data") != data_key(collection):
        raise InputError(
            option, str(path.parent), "is not of these runs, all of their presses; run the analysis on them"
        )
    return settings


def figure(study: Study, folder: Path, stem: str, caption: str, table: str = "") -> str:
    """A figure of an analysis with its caption, and links to its files and to the table that it was drawn from."""
    sub = folder.name
    files = [study.file(f"{sub}/{stem}.png"), study.file(f"{sub}/{stem}.pdf"), *([study.file(table)] if table else [])]
    return html.figure(folder / f"{stem}.png", caption, ", ".join(files))


def methods_section(study: Study, paragraphs: Sequence[str], points: Sequence[methods.Reading]) -> Iterator[str]:
    """Methods with every parameter, the open points of the paper, and the citations."""
    yield html.paragraph("To be pasted into a paper:")
    for text in (*paragraphs, methods.software_text(study.collection)):
        yield html.paragraph(text)
    for text in methods.references_text():
        yield html.paragraph(text)
    yield html.heading(3, "Where the paper's text leaves something open")
    yield html.table(
        "How it was read here",
        ("what is open", "taken here", "the other reading"),
        [(one.point, one.taken, one.option) for one in points],
        study.simulated,
    )
    yield html.heading(3, "Citations")
    yield html.verbatim(citations("bibtex"))
