"""The page of a report: five sentences, a figure and the table to quote, then all other results in folded sections.

The tables and figures of the analyses are written into a folder beside the page (``report.html`` and ``report_files``).
All numbers are also in one document of plain values, ``report.json`` in this folder.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pandas as pd

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.classification.classify import Progress, classify
from tacbench_cad.lab.analysis.feature import Feature
from tacbench_cad.lab.analysis.published import texture_number
from tacbench_cad.lab.analysis.report import facts
from tacbench_cad.lab.analysis.report.cite import citations
from tacbench_cad.lab.analysis.report.report_figures import FRAMES, SUMMARY, draw_frames, draw_summary
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.report.summary import next_steps, summary
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.tables import Shown, records, write_csv
from tacbench_cad.lab.analysis.variance.grading import grade
from tacbench_cad.lab.analysis.variance.table import variance
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked, refusing, replacing, write_json
from tacbench_cad.util.packages import require
from tacbench_cad.util.text import counted

#: The name of the document, in the folder beside the page.
DOCUMENT_FILE = "report.json"
#: The types of files that an analysis writes.
SUFFIXES = (".csv", ".png", ".pdf", ".json")
#: Screen pixels per pixel of a figure: figures have 150 pixels per inch, and an HTML page has 96.
_SCALE = 96.0 / 150.0
#: The number of columns of numbers that fit on a sheet of paper.
_MAX_COLUMNS = 8
#: The fields of errors that are not about the data.
_OWN_FIELDS = ("dask", "jobs", "output folder", "output file")

T = TypeVar("T")


def report(
    presses: pd.DataFrame,
    path: str | Path,
    feature: Feature | None = None,
    *,
    classifications: Sequence[Classification] | None = None,
    jobs: int = 1,
    dask: str | None = None,
    progress: Progress = lambda what, done, total: None,
) -> list[Path]:
    """Write a report of a study as one web page.

    Args:
        presses: The table of presses, see :func:`tacbench_cad.lab.read`.
        path: The HTML file of the page. Its tables and figures are written into a folder beside it.
        feature: The feature of the variance table and of the classification; None for pixels.
        classifications: The classifications that the page shows. None computes one with the leak-free protocol, whose
            finished trials are stored beside the page; an empty sequence leaves out the section.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler.
        progress: Receives progress updates: the name of the step, the steps done and their total number.

    Returns:
        The path of the page, then the path of its document, then the paths of the other files beside it.

    Raises:
        InputError: The name does not end in .html, the file cannot be written, or the presses cannot be analysed
            together.
        MissingToolError: A package that the report needs is not installed. Nothing is written then.
    """
    out = Path(path)
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError("out", str(out), "must end in .html")
    require("the report", "jinja2", "matplotlib", "cv2")
    design, files = Design.of(presses), out.with_name(f"{out.stem}_files")
    how: dict[str, Any] = {"jobs": jobs, "dask": dask}
    with locked(files):
        reports = []
        for number, run in enumerate(design.runs):
            progress("checking the runs", number, len(design.runs))
            reports.append(check_run(run.folder))
        table, no_table = _tried(
            lambda: variance(presses, feature, **how, progress=lambda *counts: progress("variance", *counts))
        )
        grades, no_grades = None, "they are not images of the paper's textures"
        if design.in_counts and any(map(texture_number, design.textures)):
            grades, no_grades = _tried(lambda: grade(presses, **how))
        no_classification = ""
        if classifications is None:
            result, no_classification = _tried(
                lambda: classify(
                    presses,
                    feature,
                    folder=files / "classification",
                    **how,
                    progress=lambda what, *counts: progress(f"classification: {what}", *counts),
                )
            )
            classifications = [] if result is None else [result]
        results = Results(
            design=design,
            reports=tuple(reports),
            variance=table,
            no_variance=no_table,
            grades=grades,
            no_grades=no_grades,
            classifications=tuple(classifications),
            no_classification=no_classification,
        )
        progress("writing the page", 0, 0)
        page = write_files(results, files)
        with replacing(out) as temporary:
            temporary.write_text(page, encoding="utf-8", newline="\n")
    written = [file for folder in (files, *sorted(files.iterdir())) for file in _results(folder)]
    return [out, files / DOCUMENT_FILE, *(file for file in written if file != files / DOCUMENT_FILE)]


def _tried(analysis: Callable[[], T]) -> tuple[T | None, str]:
    """Run an analysis; return its result, or None and the reason why these data have none, as the end of a sentence.

    Raises:
        InputError: The data are not the cause of the error.
    """
    try:
        return analysis(), ""
    except InputError as error:
        if error.field in _OWN_FIELDS:
            raise
        return None, f"{error.field} {error.allowed}" if error.value is None else str(error)
    except CheckFailedError as error:
        return None, str(error)


def _results(folder: Path) -> list[Path]:
    """Return the files of tables, figures and settings in a folder."""
    return sorted(path for path in folder.glob("[!.]*") if path.suffix in SUFFIXES and path.is_file())


def write_files(results: Results, files: Path) -> str:
    """Write all tables and figures of a report, and its document; return the page.

    Args:
        results: The results.
        files: The folder beside the page. Tables and figures of an earlier report are removed from it.

    Raises:
        InputError: A file cannot be written.
    """
    design = results.design
    names = [f"classification_{number}" for number in range(1, len(results.classifications) + 1)]
    names = ["classification"] if len(names) == 1 else names
    classifications = dict(zip(names, results.classifications, strict=True))
    published = results.grades.variance if results.grades else None
    analyses = {"variance": results.variance, "variance_as_published": published, **classifications}
    for folder in (files, *map(files.joinpath, analyses)):
        with refusing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for path in _results(folder):
                path.unlink()
    stems = {
        name: [path.stem for path in analysis.save(files / name) if path.suffix == ".png"]
        for name, analysis in analyses.items()
        if analysis is not None
    }
    tables = {
        "design.csv": facts.design_table(design),
        "print_records.csv": results.records[0],
        "data_quality.csv": facts.quality_table(results.reports),
        "findings.csv": facts.findings_table(results.reports),
        "textures.csv": results.textures,
    }
    added = {name: table for section in results.added.values() for name, table in section.tables.items()}
    for name, table in (tables | added).items():
        write_csv(files / name, table, design.simulated)
    captions = {SUMMARY: draw_summary(results, files), FRAMES: draw_frames(results, files)}
    document = {
        "version": __version__,
        "folder": files.name,
        "title": facts.title(design),
        "simulated": list(design.simulated),
        "notice": facts.simulated_in_words(design.simulated),
        "summary": summary(results),
        "steps": next_steps(results),
        "figures": {stem: caption for stem, caption in captions.items() if caption},
        **{name.removesuffix(".csv"): records(table) for name, table in tables.items()},
        "variance": results.variance.document() if results.variance else None,
        "classifications": [result.document() for result in results.classifications],
    }
    write_json(files / DOCUMENT_FILE, document)
    values = {"document": document, "results": results, "tables": tables, "stems": stems}
    return rendered("report.html.j2", files, values | {"classifications": classifications})


def rendered(template: str, files: Path, values: Mapping[str, Any]) -> str:
    """Return the text of a template of this folder.

    The page is a single file: it has no scripts, no fonts and no web addresses, and its pictures are embedded as
    base64. Sections are folded on a screen and open when printed. On a narrow screen, wide tables and figures scroll in
    their own boxes, so that their text keeps its size. On paper they are scaled to the page.

    Args:
        template: The name of the template.
        files: The folder of the figures.
        values: The values that the template shows.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from PIL import Image

    def image(name: str) -> dict[str, Any]:
        """Return a figure in base64, with its width and height in screen pixels."""
        with Image.open(files / name) as picture:
            width, height = (round(side * _SCALE) for side in picture.size)
        return {"data": base64.b64encode((files / name).read_bytes()).decode(), "width": width, "height": height}

    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.loader = FileSystemLoader(Path(__file__).parent)
    words = (facts.prints_in_words, facts.forces_in_words, facts.devices_in_words, facts.unknown_names)
    functions = (*words, facts.record_fields, counted, citations, image, narrow, readable)
    environment.globals.update({function.__name__: function for function in functions})
    return environment.get_template(template).render(values)


def readable(title: str, table: pd.DataFrame) -> Shown:
    """Return a table with readable headings, without columns that have no value."""
    heads = {name: str(name).replace("_level_", ", level ").replace("_", " ") for name in table}
    return Shown(title, table.dropna(axis="columns", how="all").rename(columns=heads))


def narrow(table: Shown) -> Iterator[Shown]:
    """Split a table with a column for each texture into several tables that are narrow enough for a sheet of paper."""
    first, frame = [*table.right, True].index(True), table.frame
    for start in range(first, max(len(frame.columns), first + 1), _MAX_COLUMNS):
        columns = [*range(first), *range(start, min(start + _MAX_COLUMNS, len(frame.columns)))]
        yield Shown(table.title, frame.iloc[:, columns])
