"""The document of a report: everything that the page shows, as plain values, with the names of its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.report import facts
from tacbench_cad.lab.analysis.report.parts import figure_part, table_part
from tacbench_cad.lab.analysis.report.report_figures import FRAMES, SUMMARY, draw_frames, draw_summary
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.report.sections import sections
from tacbench_cad.lab.analysis.report.summary import next_steps, summary
from tacbench_cad.lab.analysis.tables import records, write_csv
from tacbench_cad.util.files import write_json

#: The file names of the document and of the table to quote, in the folder beside the page.
DOCUMENT_FILE, TABLE_FILE = "report.json", "textures.csv"


def write_document(results: Results, files: Path) -> dict[str, Any]:
    """Write the report's own tables and figures, and the document with everything that the page shows.

    Args:
        results: The results.
        files: The folder beside the page. It already contains the files of the analyses.

    Returns:
        The document.

    Raises:
        InputError: A file cannot be written.
    """
    study = results.collection
    tables = {
        "design.csv": facts.design_table(study),
        "print_records.csv": results.records["all"],
        "data_quality.csv": facts.quality_table(results.reports),
        "findings.csv": facts.findings_table(results.reports),
        TABLE_FILE: results.textures,
        **{name: table for section in results.added.values() for name, table in section.tables.items()},
    }
    for name, table in tables.items():
        write_csv(files / name, table, study.simulated)
    for path in (files / f"{stem}{suffix}" for stem in (SUMMARY, FRAMES) for suffix in (".png", ".pdf")):
        path.unlink(missing_ok=True)
    captions = {SUMMARY: draw_summary(results, files), FRAMES: draw_frames(results, files)}
    answers = records(results.variance.tables["printer_answers"]) if results.variance else []
    document = {
        "version": __version__,
        "folder": files.name,
        "title": facts.title(study),
        "simulated": list(study.simulated),
        "notice": facts.simulated_in_words(study.simulated),
        "summary": [{"topic": topic, "text": text} for topic, text in summary(results).items()],
        "steps": next_steps(results),
        "figures": [figure_part(stem, caption, TABLE_FILE) for stem, caption in captions.items() if caption],
        "table": {**table_part(results.shown_textures, TABLE_FILE), "records": records(results.textures)},
        "printer_answers": answers,
        "texture_answers": records(results.leak_free.answers) if results.leak_free else [],
        "sections": sections(results, files),
    }
    write_json(files / DOCUMENT_FILE, document)
    return document
