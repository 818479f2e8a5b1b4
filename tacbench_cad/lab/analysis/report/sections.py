"""The sections of a report below its main table: all results, with the names of the files that contain them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from tacbench_cad import __version__
from tacbench_cad.lab.analysis import conclusions
from tacbench_cad.lab.analysis.classification.result import recall_table, shown_scores
from tacbench_cad.lab.analysis.classification.settings import shown_protocol
from tacbench_cad.lab.analysis.report import facts
from tacbench_cad.lab.analysis.report.cite import citations
from tacbench_cad.lab.analysis.report.classification import Classification
from tacbench_cad.lab.analysis.report.parts import (
    Part,
    figure_part,
    list_part,
    long_part,
    table_part,
    text_part,
    wide_parts,
)
from tacbench_cad.lab.analysis.report.report_html import macro
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.report.summary import next_steps
from tacbench_cad.lab.analysis.tables import Shown
from tacbench_cad.util.text import counted

#: The largest number of findings of a run on the page; the CSV file contains all of them.
MAX_FINDINGS = 5
#: The figures of a classification, by their files' names.
_CLASSIFICATION_FIGURES = {
    "hold_out_levels": "Accuracy at the hold-out levels, from easy to hard: presses, positions, forces, copies, "
    "printers.",
    "paper_table": "Accuracy on training rows, on split-off rows (inflated) and on other printers and filaments.",
    "published_table": "Accuracy computed as in the authors' notebooks, beside the paper's classification table.",
    "confusion": "How often each texture (rows) was predicted as each texture (columns).",
    "sweep": "Accuracy for the values of one setting.",
}


def sections(results: Results, folder: Path) -> list[dict[str, Any]]:
    """Return all sections that are not empty. Sections that few people read are last.

    Args:
        results: The results.
        folder: The folder of the page's files. All files of the analyses must already be in it.
    """
    contents = {
        "steps": ("What to do next", _steps(results)),
        "design": ("What was pressed on what", _design(results)),
        "quality": ("Data quality", _quality(results)),
        "variance": ("How repeatable the prints are", _variance(results)),
        "published": ("Comparison with the paper's figures", _published(results)),
        "maps": ("Which pixels, positions and textures vary", _maps(results)),
        "classification": ("What the sensor can tell apart", _classification(results, folder)),
        **{name: (section.title, section.parts) for name, section in results.added.items()},
        "methods": ("Methods and citations", _methods(results)),
        "prints": ("The prints' records", _records(results)),
    }
    written = [(anchor, title, list(parts)) for anchor, (title, parts) in contents.items()]
    return [{"anchor": anchor, "title": title, "parts": parts} for anchor, title, parts in written if parts]


def _steps(results: Results) -> Iterator[Part]:
    steps = next_steps(results)
    if len(steps) > 1:
        yield list_part(steps)


def _design(results: Results) -> Iterator[Part]:
    yield text_part(macro("methods.j2", "design")(results.collection))
    yield table_part(Shown("Prints and presses", _readable(facts.design_table(results.collection))), "design.csv")


def _quality(results: Results) -> Iterator[Part]:
    reports = results.reports
    findings = sum(len(report.findings) for report in reports)
    without = sum(report.ok for report in reports)
    if results.collection.info.protocol is not None:
        present, planned, outside = (
            sum(getattr(report, name) for report in reports) for name in ("presses", "planned", "out_of_band")
        )
        yield text_part(
            f"{present:,} of {planned:,} planned presses are present. In {outside:,} of them the force was outside its "
            "band; these presses are marked and kept."
        )
    yield text_part(
        "The checksum of every frame was verified, and every frame was compared with the others of its run "
        "(brightness, focus, noise, colours, orientation, place) and with earlier frames, to find identical ones. "
        f"Of {counted(len(reports), 'run')}, {without} {'has' if without == 1 else 'have'} no "
        f"finding; there {'is' if findings == 1 else 'are'} {counted(findings, 'finding')} in total."
    )
    if findings:
        title = f"Findings, at most {MAX_FINDINGS} for each run"
        yield long_part(Shown(title, facts.findings_table(reports, MAX_FINDINGS)), "findings.csv")
    incomplete = facts.quality_table([r for r in reports if r.findings or r.out_of_band or r.presses < r.planned])
    if len(incomplete):
        title = "Runs with findings, missing presses or forces outside their band"
        yield long_part(Shown(title, _readable(incomplete)), "data_quality.csv")


def _readable(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with readable headings, without columns that have no value."""
    heads = {name: str(name).replace("_level_", ", level ").replace("_", " ") for name in table}
    return table.dropna(axis="columns", how="all").rename(columns=heads)


def _variance(results: Results) -> Iterator[Part]:
    view = results.variance
    if view is None:
        yield text_part(f"These data have no variance table: {results.no_variance}.")
        return
    if view.warnings:
        yield text_part("Limits of this table", "heading")
        yield list_part(view.warnings)
    shown = list(view.shown())
    for number, (name, table) in enumerate(shown):
        yield from wide_parts(table, f"variance/{name}.csv")
        if name == "variance" and name not in (later for later, _ in shown[number + 1 :]):
            caption = f"Variance in {view.unit} by texture, with 95 % intervals over prints."
            yield figure_part("variance/variance", caption, "variance/floor_removed.csv")
        elif name == "components":
            yield figure_part("variance/components", "Where the variance comes from.")
    yield from map(text_part, view.notes)
    distances = view.tables.get("print_distances")
    if distances is not None and len(distances):
        first = _readable(distances.sort_values("from_others", ascending=False, kind="stable"))
        title = f"How far each print is from the other prints of its texture (mean square, {view.unit}), largest first"
        yield long_part(Shown(title, first), "variance/print_distances.csv")


def _published(results: Results) -> Iterator[Part]:
    view = results.published
    if view is None:
        if results.variance is not None:
            yield text_part(f"These data cannot be compared with the paper's figures: {results.no_published}.")
        return
    for name, table in view.shown():
        yield from wide_parts(table, f"variance_as_published/{name}.csv")
    caption = (
        f"The quantity of the paper's table, the variance of the repeats on one print in {view.unit}, with 95 % "
        "intervals over prints."
    )
    tables = [f"variance_as_published/{name}.csv" for name in ("floor_removed", "positions")]
    yield figure_part("variance_as_published/variance", caption, *tables)
    yield from map(text_part, view.notes)
    limits = [grade.limits for grade in results.grades]
    common = [limit for limit in (limits[0] if limits else ()) if all(limit in others for others in limits)]
    for grade in results.grades:
        yield text_part(f"{grade.printer} {grade.filament} compared with the published table", "heading")
        yield list_part(verdict.text for verdict in grade.verdicts)
        own = [limit for limit in grade.limits if limit not in common]
        if own:
            yield text_part("Limits of this comparison:")
            yield list_part(own)
    if common:
        yield text_part(f"Limits of {'these comparisons' if len(results.grades) > 1 else 'this comparison'}", "heading")
        yield list_part(common)


def _maps(results: Results) -> Iterator[Part]:
    if results.variance is None:
        return
    settings = results.variance.settings
    if settings.roi:
        contact = " without contact" if results.collection.runs[0].references else ""
        where = f"The region of interest, {settings.roi}, in a frame{contact}. Only its pixels are analysed."
        yield figure_part("variance/region", where)
    if settings.series:
        caption = "Variance of each frame of the series, along the motion of the sensor: mean over positions."
        yield figure_part("variance/variance_motion", caption, "variance/motion.csv")
    if settings.exhibit:
        yield figure_part(f"variance/{settings.exhibit}", settings.caption, f"variance/{settings.exhibit}.csv")
    what = f"Variance of the {settings.words.one}s: mean over positions and forces."
    yield figure_part("variance/variance_pixels", what)
    caption = "Variance at the positions: mean over forces."
    yield figure_part("variance/variance_positions", caption, "variance/positions.csv")
    caption = (
        "Variance of each pixel over the frames of two textures at the same position, mean over pixels and positions. "
        "The diagonal shows the variance of one texture, as in the table. Two textures can be told apart if their "
        "variance is far above both of their diagonal values."
    )
    yield figure_part("variance/between_textures", caption, "variance/between_textures.csv")


def _classification(results: Results, folder: Path) -> Iterator[Part]:
    if results.no_classification:
        yield text_part(f"These data have no classification: {results.no_classification}.")
    for classification in results.classifications:
        if len(results.classifications) > 1:
            record = classification.record
            yield text_part(f"Protocol {shown_protocol(record.protocol, record.unknown_groups)}", "heading")
        yield from _one_classification(classification, folder)


def _one_classification(classification: Classification, folder: Path) -> Iterator[Part]:
    name, record = classification.folder.name, classification.record
    if record.notes:
        yield list_part(record.notes)
    if len(classification.answers):
        yield table_part(conclusions.shown_answers(classification.answers), f"{name}/texture_answers.csv")
    chance = f"chance is {100.0 * classification.chance:.1f} %"
    title = f"Accuracy (%), protocol {shown_protocol(record.protocol, record.unknown_groups)}; {chance}"
    scores = shown_scores(classification.scores, record.unknown_groups, title)
    yield table_part(scores, f"{name}/classification.csv")
    yield from wide_parts(recall_table(classification.confusion, record.unknown_groups), f"{name}/confusion.csv")
    for stem, caption in _CLASSIFICATION_FIGURES.items():
        for path in sorted((folder / name).glob(f"{stem}*.png")):
            yield figure_part(f"{name}/{path.stem}", caption)


def _methods(results: Results) -> Iterator[Part]:
    yield text_part("You can copy these paragraphs into a paper:")
    yield text_part(macro("methods.j2", "design")(results.collection))
    if results.variance is not None:
        yield text_part(macro("methods.j2", "variance")(results.variance))
    for classification in results.classifications:
        yield text_part(classification.methods)
    simulated = results.collection.simulated
    origin = f"These are simulated data ({'; '.join(simulated)}). " if simulated else ""
    yield text_part(f"{origin}Everything was computed with tacbench-cad {__version__} [2].")
    yield from (text_part(f"[{n}] {work}") for n, work in enumerate(citations("text").splitlines(), start=1))
    settings = results.variance.settings if results.variance else None
    colour, ddof = (settings.colour, settings.ddof) if settings else (False, 0)
    points = facts.open_points(results.collection, colour, ddof)
    if len(points.frame):
        yield text_part("Points that the paper's text leaves open", "heading")
        yield table_part(points)
    yield text_part("Citations", "heading")
    yield text_part(citations("bibtex"), "code")


def _records(results: Results) -> Iterator[Part]:
    records = results.records
    if records["damaged"]:
        yield text_part("Print records that cannot be read:")
        yield list_part(records["damaged"])
    if len(records["alike"].frame):
        yield table_part(records["alike"], "print_records.csv")
    if len(records["empty"].frame):
        yield text_part(
            f"Some of {counted(records['total'], 'print record')} have empty fields. A fact that was not written down "
            "cannot explain a difference between prints later."
        )
        yield table_part(records["empty"], "print_records.csv")
    elif records["total"]:
        yield text_part(f"All fields of all {counted(records['total'], 'print record')} are filled in.")
