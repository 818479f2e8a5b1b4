"""The page of a report: five sentences, a figure and the table to quote, then all other results in folded sections.

The analyses write their tables and figures into a folder beside the page (``report.html`` and ``report_files``).
Results that ``tacbench variance`` or ``tacbench classify`` computed earlier are copied into that folder instead. The
files of that folder are collected in one document of plain values, ``report.json``, and the page shows that document.
The page, the JSON document, the figures and the CSV files therefore always agree.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.lab.analysis.classification.classify import MODULES, Progress
from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import texture_number
from tacbench_cad.lab.analysis.report.classification import Classification, classify_into
from tacbench_cad.lab.analysis.report.document import DOCUMENT_FILE, write_document
from tacbench_cad.lab.analysis.report.report_html import render_page
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.variance.grade import grade
from tacbench_cad.lab.analysis.variance.view import SETTINGS_FILE, Settings, VarianceView
from tacbench_cad.lab.runs.checking import RunReport, check_run
from tacbench_cad.util.convert import read_json
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked, refusing, replacing
from tacbench_cad.util.packages import require
from tacbench_cad.util.untrusted import open_input

#: The types of files that an analysis writes and that a report copies.
SUFFIXES = (".csv", ".png", ".pdf", ".json")
_OTHER_PROTOCOL = "must be computed with --protocol paper; the report itself adds the table of the other protocol"


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """The options of a report.

    Args:
        variance: The output folder of ``tacbench variance`` for these runs; if None, the table is computed.
        classifications: Output folders of ``tacbench classify`` for these runs. If empty, a classification with the
            leak-free protocol is computed, unless ``classify`` is false.
        classify: Whether the report has a section on classification.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler.
    """

    variance: Path | None = None
    classifications: tuple[Path, ...] = ()
    classify: bool = True
    jobs: int = 1
    dask: str | None = None


def write_report(
    runs: Sequence[Path], out: Path, options: ReportOptions | None = None, progress: Progress = lambda *_: None
) -> list[Path]:
    """Write the report of a study.

    Args:
        runs: Run folders, or folders that contain run folders.
        out: The HTML file of the page. Its tables and figures are written into a folder beside it.
        options: The options of the report; None for the defaults.
        progress: Receives progress updates: the name of the step, the steps done and their total number.

    Returns:
        The path of the page, then the path of its document, then the paths of the other files beside it.

    Raises:
        InputError: The name ``out`` does not end in .html, the file cannot be written, the runs cannot be read or
            cannot be analysed together, or the folder of an analysis belongs to other runs.
        MissingToolError: A package that the report needs is not installed. Nothing is written then.
    """
    chosen = options or ReportOptions()
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError("out", str(out), "must end in .html")
    classified_here = chosen.classify and not chosen.classifications
    require("the report", "jinja2", *(name for name in MODULES if classified_here or name != "sklearn"))
    collection = Collection.open(runs)
    # Folders that belong to other runs are refused before anything is computed.
    if chosen.variance is not None:
        settings = read_json(chosen.variance / SETTINGS_FILE, Settings, "settings")
        if settings.protocol != "paper":
            raise InputError("variance", str(chosen.variance), _OTHER_PROTOCOL)
        _require_same("variance", chosen.variance, settings, collection)
    for folder in chosen.classifications:
        _require_same("classify", folder, ClassificationRecord.read(folder), collection)
    files = out.with_name(f"{out.stem}_files")
    with locked(files):
        reports = tuple(_checked(collection, progress))
        results = Results(
            collection=collection,
            reports=reports,
            **_variance(collection, files / "variance", chosen, progress),
            **_classifications(collection, files, chosen, progress),
        )
        progress("writing the page", 0, 0)
        document = write_document(results, files)
        with replacing(out) as temporary:
            temporary.write_text(render_page(document, files.parent), encoding="utf-8", newline="\n")
    written = [path for folder in (files, *sorted(files.iterdir())) for path in _results(folder)]
    return [out, files / DOCUMENT_FILE, *(path for path in written if path != files / DOCUMENT_FILE)]


def _checked(collection: Collection, progress: Progress) -> Iterator[RunReport]:
    for i, run in enumerate(collection.runs):
        progress("checking the runs", i, len(collection.runs))
        yield check_run(run.folder)


def _require_same(option: str, folder: Path, settings: Settings | ClassificationRecord, collection: Collection) -> None:
    """Check that an analysis used the presses of this study: all presses, or all presses at one force level.

    Raises:
        InputError: The analysis used other presses.
    """
    viewed = collection.viewed(settings.series)
    parts = (viewed, *(viewed.at_level(level) for level in viewed.levels))
    if all(settings.data != part.data_key for part in parts):
        raise InputError(option, str(folder), "must be an analysis of all presses of these runs; repeat the analysis")


def _variance(collection: Collection, folder: Path, options: ReportOptions, progress: Progress) -> dict[str, Any]:
    """Write or copy the files of the variance table; return the fields of :class:`Results` about it."""
    from tacbench_cad.lab.analysis.feature import fitted
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.lab.analysis.variance.view import write_all

    if options.variance is not None:
        copy_files(options.variance, folder)
    else:
        try:
            result = variance_table(
                collection,
                fitted(collection),
                jobs=options.jobs,
                dask=options.dask,
                progress=lambda done, total: progress("variance", done, total),
            )
        except InputError as error:
            return {"no_variance": _refusal_of(error)}
        write_all(result, folder)
    beside = _beside_the_paper(collection, folder.with_name("variance_as_published"), options, progress)
    return {"variance": VarianceView.read(folder, collection), **beside}


def _beside_the_paper(
    collection: Collection, folder: Path, options: ReportOptions, progress: Progress
) -> dict[str, Any]:
    """Write the table of the paper's own quantity; return the fields of :class:`Results` about it."""
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.lab.analysis.variance.view import write_all

    clear(folder)
    if not collection.in_counts or not any(map(texture_number, collection.textures)):
        return {"no_published": "they are not images of the paper's textures"}
    try:
        result = variance_table(
            collection,
            protocol="as-published",
            jobs=options.jobs,
            dask=options.dask,
            progress=lambda done, total: progress("variance as published", done, total),
        )
        grades = grade(result.cells, result.collection, result.left_out)
    except InputError as error:
        return {"no_published": _refusal_of(error)}
    write_all(result, folder)
    return {"published": VarianceView.of(result), "grades": grades}


def _classifications(collection: Collection, files: Path, options: ReportOptions, progress: Progress) -> dict[str, Any]:
    """Write or copy the files of the classifications; return the fields of :class:`Results` about them."""
    refusal, folders = "", []
    if options.classifications:
        for i, source in enumerate(options.classifications, start=1):
            name = "classification" if len(options.classifications) == 1 else f"classification_{i}"
            copy_files(source, files / name)
            folders.append(files / name)
    elif options.classify:
        folder = files / "classification"
        clear(folder)
        try:
            classify_into(collection, folder, None, options.jobs, options.dask, progress)
            folders.append(folder)
        except (InputError, CheckFailedError) as error:
            refusal = _refusal_of(error)
    return {"classifications": tuple(map(Classification.read, folders)), "no_classification": refusal}


def _refusal_of(error: InputError | CheckFailedError) -> str:
    """Return the reason why these data have no such result, as the end of a sentence.

    Raises:
        InputError: The data are not the cause of the error.
    """
    if isinstance(error, InputError) and error.field in ("dask", "jobs", "output folder", "output file"):
        raise error
    if isinstance(error, InputError) and error.value is None:
        return f"{error.field} {error.allowed}"
    return str(error)


def copy_files(source: Path, folder: Path) -> None:
    """Copy the tables and figures of an analysis, each file completely or not at all.

    Raises:
        InputError: A file cannot be read or written.
    """
    if source.resolve() == folder.resolve():
        return
    clear(folder)
    for path in _results(source):
        with (
            open_input(path, "file of an analysis", within=source) as original,
            replacing(folder / path.name) as temporary,
            temporary.open("wb") as copy,
        ):
            shutil.copyfileobj(original, copy)


def clear(folder: Path) -> None:
    """Create a folder, or remove the tables and figures of an earlier report from it, but not from its subfolders.

    Raises:
        InputError: The folder cannot be written.
    """
    with refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for path in _results(folder):
            path.unlink()


def _results(folder: Path) -> list[Path]:
    """Return the files of tables, figures and settings in a folder."""
    return sorted(path for path in folder.glob("[!.]*") if path.suffix in SUFFIXES and path.is_file())
