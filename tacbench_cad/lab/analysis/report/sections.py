"""The sections of a report: what each says and shows, from the runs and from the files of the analyses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from tacbench_cad.lab.analysis.report import methods
from tacbench_cad.lab.analysis.report.cite import citations
from tacbench_cad.lab.analysis.report.pieces import Piece, Study
from tacbench_cad.lab.analysis.tables import Column, Table
from tacbench_cad.lab.analysis.variance.grade import grade
from tacbench_cad.lab.analysis.variance.grade_limits import Context
from tacbench_cad.lab.analysis.variance.view import VarianceView
from tacbench_cad.lab.runs.checking import RunReport
from tacbench_cad.spec.printrecord import FIELDS, PrintRecord
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted

#: Findings of a run that the page shows; all of them stand in the CSV file.
MAX_FINDINGS = 5


def design_section(study: Study) -> Iterator[Piece]:
    """What was pressed on what."""
    collection = study.collection
    levels = [Column(f"presses_level_{n}", head=f"presses, level {n}") for n in collection.levels]
    columns = (*(Column(name) for name in ("printer", "filament", "texture", "prints")), *levels)
    yield Piece("paragraph", methods.design_text(collection))
    table = Table.of(columns, methods.counts_rows(collection), "Prints and presses")
    table.write(study.files / "design.csv")
    yield study.table(table, "design.csv")


def records_section(study: Study) -> Iterator[Piece]:
    """The print records and what is missing in them."""
    records: list[tuple[str, PrintRecord]] = []
    damaged: list[str] = []
    for run in study.collection.runs:
        try:
            records.append((run.info.printed.name, run.print_record))
        except InputError as error:
            damaged.append(str(error))
    rows = [{"run": name, **{field: _plain(record.values.get(field)) for field in FIELDS}} for name, record in records]
    file = "print_records.csv"
    Table.of(_columns("run", *FIELDS), rows).write(study.files / file)
    empty = Counter(field for _, record in records for field in record.empty)
    total = len(records)
    if empty:
        yield Piece(
            "paragraph",
            f"Of {total} print records these fields are empty in some; what nobody wrote down cannot explain a "
            "difference between prints later.",
        )
        heads = ("field", "what belongs there", "empty in", "of records")
        counts = [(field, FIELDS[field], count, total) for field, count in empty.items()]
        yield study.table(_table("Empty fields of the print records", heads, counts), file)
    elif total:
        yield Piece("paragraph", f"All fields of all {total} print records are filled in.")
    filled = [field for field in FIELDS if any(record.values.get(field) for _, record in records)]
    if filled and total:
        alike = Counter(tuple(row[field] for field in filled) for row in rows)
        counts = [(*values, count) for values, count in alike.items()]
        yield study.table(
            _table("What the print records say, alike prints together", (*filled, "prints"), counts), file
        )
    if damaged:
        yield Piece("paragraph", "Records that cannot be read:")
        yield Piece("list", items=damaged)


def quality_section(study: Study, reports: Sequence[RunReport]) -> Iterator[Piece]:
    """Data quality: every run examined as `tacbench runs check` does."""
    counts = ("planned", "presses", "out_of_band", "references", "stationary")
    columns = [Column("run", source="name"), *_columns(*counts)]
    columns.append(Column("findings", source=lambda report: len(report.findings)))
    Table.of(columns, reports).write(study.files / "data_quality.csv")
    findings = [{"run": report.name, **to_plain(finding)} for report in reports for finding in report.findings]
    table = Table.of(_columns("run", "kind", "where", "text"), findings)
    table.write(study.files / "findings.csv")
    planned, there, outside = (sum(getattr(report, name) for report in reports) for name in counts[:3])
    whole = sum(not report.findings for report in reports)
    yield Piece(
        "paragraph",
        f"{there:,} of {planned:,} planned presses are there; in {outside:,} of them the force lay outside of its band "
        f"(they say so and are kept). Every reading was compared with its checksum and judged for darkness, blur and "
        f"being stuck: {whole} of {len(reports)} runs have no finding, {counted(len(findings), 'finding')} in all. "
        f"All runs: {study.file('data_quality.csv')}",
    )
    if findings:
        seen: Counter[str] = Counter()
        shown = []
        for row in table.rows:
            seen[row["run"]] += 1
            if seen[row["run"]] <= MAX_FINDINGS:
                shown.append(row)
        caption = f"Findings, at most {MAX_FINDINGS} of a run"
        yield study.table(Table(columns=table.columns, rows=tuple(shown), title=caption), "findings.csv")


def variance_section(study: Study, view: VarianceView) -> Iterator[Piece]:
    """The variance table beside the paper's, with noise floor, intervals, components, tests and grades."""
    if view.warnings:
        yield Piece("heading", "To know before reading it")
        yield Piece("list", items=view.warnings)
    previous = ""
    for name, table in [*view.shown(), ("", None)]:
        if previous == "variance" != name:
            caption = f"Variance in {view.unit} by texture, with 95 % intervals over prints."
            yield study.figure("variance/variance", caption, "variance/floor_removed.csv")
        if table is not None:
            yield study.table(table, f"variance/{name}.csv")
        if name == "components":
            yield study.figure("variance/components", "Where the variance comes from.")
        previous = name
    for text in view.notes:
        yield Piece("paragraph", text)
    collection = study.collection
    try:
        grades = grade(view.cells, Context.of(collection, view.cells))
    except InputError:
        return  # none of the paper's textures: there is nothing to stand beside
    for graded in grades:
        yield Piece("heading", f"{graded.printer} {graded.filament} beside the published table")
        yield Piece("list", items=[verdict.text for verdict in graded.verdicts])
        yield Piece("paragraph", "What limits this:")
        yield Piece("list", items=graded.limits or ("nothing more than what is said above",))


def maps_section(study: Study) -> Iterator[Piece]:
    """Heat maps and matrices between textures."""
    yield study.figure("variance/variance_pixels", "Which pixels vary: mean over positions and forces.")
    caption = "Which positions vary: mean over forces."
    yield study.figure("variance/variance_positions", caption, "variance/positions.csv")
    yield study.figure(
        "variance/between_textures",
        "Variance of each pixel over both textures' readings at the same position, mean over pixels and positions; on "
        "the diagonal the table's own. A pair far above both of its diagonal figures can be told apart.",
        "variance/between_textures.csv",
    )


def methods_section(study: Study, paragraphs: Sequence[str], points: Sequence[methods.OpenPoint]) -> Iterator[Piece]:
    """Methods with every parameter, the open points of the paper, and the citations."""
    yield Piece("paragraph", "To be pasted into a paper:")
    for text in (*paragraphs, methods.software_text(study.collection), *methods.references_text()):
        yield Piece("paragraph", text)
    yield Piece("heading", "Where the paper's text leaves something open")
    columns = (
        Column("point", head="what is open"),
        Column("taken", head="taken here"),
        Column("option", head="the other reading"),
    )
    yield study.table(Table.of(columns, points, "How it was read here"))
    yield Piece("heading", "Citations")
    yield Piece("verbatim", citations("bibtex"))


def _columns(*names: str) -> tuple[Column, ...]:
    return tuple(Column(name) for name in names)


def _table(title: str, heads: Sequence[str], rows: Sequence[Sequence[Any]]) -> Table:
    records: list[Mapping[str, Any]] = [dict(zip(heads, row, strict=True)) for row in rows]
    return Table(columns=_columns(*heads), rows=tuple(records), title=title)


def _plain(entry: Any) -> Any:
    return "; ".join(map(str, entry)) if isinstance(entry, list) else entry
