"""One page on a study: what was pressed on what, how good the data are, every table and figure, methods, citations.

The page is drawn from files: the analyses write their tables and figures into a folder beside it (``report.html`` and
``report_files``), or they are copied there from the folders of ``tacbench variance`` and ``tacbench classify``; then
the page is made of what stands in that folder. So a figure of the page, its PNG, its PDF and its CSV never disagree.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.lab.analysis.classification.classify import MODULES, Progress
from tacbench_cad.lab.analysis.classification.classify import SETTINGS_FILE as CLASSIFY_SETTINGS
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.report import classification, methods, sections
from tacbench_cad.lab.analysis.report.pieces import Piece, Section, Study, page
from tacbench_cad.lab.analysis.tables import read_settings
from tacbench_cad.lab.analysis.variance.view import SETTINGS_FILE as VARIANCE_SETTINGS
from tacbench_cad.lab.analysis.variance.view import VarianceView
from tacbench_cad.lab.runs.checking import RunReport, check_run
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import locked, refusing, replacing
from tacbench_cad.util.packages import require
from tacbench_cad.util.text import counted

#: Kinds of files that an analysis writes and a report copies.
SUFFIXES = (".csv", ".png", ".pdf", ".json")


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a report is made of.

    Args:
        variance: A folder of ``tacbench variance`` for these runs; None: computed.
        classifications: Folders of ``tacbench classify`` for these runs; none: computed with the leak-free
            protocol, unless ``classify`` is false.
        classify: Whether there is a section on classification.
        jobs: Processes of this machine.
        dask: Address of a Dask scheduler.
    """

    variance: Path | None = None
    classifications: tuple[Path, ...] = ()
    classify: bool = True
    jobs: int = 1
    dask: str | None = None


def write_report(
    runs: Sequence[Path], out: Path, options: Options | None = None, progress: Progress = lambda *_: None
) -> list[Path]:
    """Write a study's report.

    Args:
        runs: Run folders, or folders that hold some.
        out: The page, ``.html``. Its tables and figures go to a folder beside it.
        options: What it is made of.
        progress: Receives what is done, how much of it and of how much.

    Returns:
        The page, then the files beside it.

    Raises:
        InputError: ``out`` is no HTML file or cannot be written, the runs cannot be read or mixed, or a folder of an
            analysis is not of these runs.
        MissingToolError: What it needs is not installed; nothing is written then.
    """
    chosen = options or Options()
    if out.suffix.lower() not in (".html", ".htm"):
        raise InputError("out", str(out), "must end in .html")
    classified_here = chosen.classify and not chosen.classifications
    require("the report", "jinja2", *(name for name in MODULES if classified_here or name != "sklearn"))
    collection = Collection.open(runs)
    # Folders that are not of these runs are refused before anything is computed.
    if chosen.variance is not None:
        _require_same("variance", chosen.variance / VARIANCE_SETTINGS, collection)
    for folder in chosen.classifications:
        _require_same("classify", folder / CLASSIFY_SETTINGS, collection)
    files = out.with_name(f"{out.stem}_files")
    study = Study(collection=collection, files=files)
    with locked(files):
        reports = list(_checked(collection, progress))
        parts = [
            _section("design", "What was pressed on what", sections.design_section(study)),
            _section("prints", "The prints, and what is missing in their records", sections.records_section(study)),
            _section("quality", "Data quality", sections.quality_section(study, reports)),
            *_analyses(study, chosen, progress),
        ]
        progress("writing the page", 0, 0)
        title = f"{counted(len(collection), 'press')} on {counted(len(collection.runs), 'print')}"
        subtitle = f"{', '.join(collection.combinations)}; {', '.join(collection.textures)}."
        text = page(title, subtitle, collection.simulated, parts)
        with replacing(out) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    return [out, *(path for folder in (files, *sorted(files.iterdir())) for path in _results(folder))]


def _checked(collection: Collection, progress: Progress) -> Iterator[RunReport]:
    for i, run in enumerate(collection.runs):
        progress("examining the runs", i, len(collection.runs))
        yield check_run(run.folder)


def _require_same(option: str, path: Path, collection: Collection) -> None:
    """Refuse the folder of an analysis that is not of these presses.

    Raises:
        InputError: It is of others, or its files are damaged.
    """
    if read_settings(path).get("data") != collection.data_key:
        raise InputError(
            option, str(path.parent), "is not of these runs, all of their presses; run the analysis on them"
        )


def _analyses(study: Study, options: Options, progress: Progress) -> Iterator[Section]:
    """Variance, maps, classification, methods."""
    paragraphs = [methods.design_text(study.collection)]
    colour, ddof = False, 0
    refusal = _variance(study, options, progress)
    if refusal is None:
        view = VarianceView.read(study.files / "variance", study.collection)
        colour, ddof = view.settings.colour, view.settings.ddof
        paragraphs.append(methods.variance_text(view))
        yield _section("variance", "How well it printed", sections.variance_section(study, view))
        yield _section("maps", "Which pixels, positions and textures vary", sections.maps_section(study))
    else:
        yield _section("variance", "How well it printed", _refused("variance table", refusal))
    if options.classify:
        classified, reason = _classifications(study, options, progress)
        body = classification.section(study, classified) if classified else _refused("classification", reason)
        yield _section("classification", "What the sensor can tell apart", body)
        paragraphs += [classification.methods_text(done) for done in classified]
    points = methods.open_points(study.collection, colour, ddof)
    yield _section("methods", "Methods and citations", sections.methods_section(study, paragraphs, points))


def _variance(study: Study, options: Options, progress: Progress) -> str | None:
    """Have the files of the variance table.

    Returns:
        None, or why these data have no variance table.
    """
    folder = study.files / "variance"
    if options.variance is not None:
        copy_files(options.variance, folder)
        return None
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.lab.analysis.variance.view import write_all

    def show(done: int, total: int) -> None:
        progress("variance", done, total)

    try:
        result = variance_table(study.collection, jobs=options.jobs, dask=options.dask, progress=show)
    except InputError as error:
        if error.field in ("dask", "jobs"):
            raise
        return str(error)
    write_all(result, folder)
    return None


def _classifications(
    study: Study, options: Options, progress: Progress
) -> tuple[list[classification.Classification], str]:
    """Have the files of classifications; none, and the reason, where these data have none."""
    classified = []
    for i, source in enumerate(options.classifications, start=1):
        name = "classification" if len(options.classifications) == 1 else f"classification_{i}"
        copy_files(source, study.files / name)
        settings = read_settings(study.files / name / CLASSIFY_SETTINGS)
        classified.append(classification.Classification(folder=study.files / name, settings=settings))
    if classified:
        return classified, ""
    clear(study.files / "classification")
    try:
        return [classification.computed(study, options.jobs, options.dask, progress)], ""
    except (InputError, CheckFailedError) as error:
        return [], classification.refusal_of(error)


def copy_files(source: Path, folder: Path) -> None:
    """Copy tables and figures of an analysis, each whole or not at all.

    Raises:
        InputError: A file cannot be read or written.
    """
    if source.resolve() == folder.resolve():
        return
    clear(folder)
    for path in _results(source):
        with replacing(folder / path.name) as temporary:
            shutil.copyfile(path, temporary)


def clear(folder: Path) -> None:
    """Have a folder without the tables and figures of an earlier report; what lies in folders within it stays.

    Raises:
        InputError: It cannot be written.
    """
    with refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for path in _results(folder):
            path.unlink()


def _results(folder: Path) -> list[Path]:
    """Tables, figures and settings in a folder."""
    return sorted(path for path in folder.glob("[!.]*") if path.suffix in SUFFIXES and path.is_file())


def _refused(what: str, reason: str) -> Iterator[Piece]:
    yield Piece("paragraph", f"These data have no {what}: {reason}.")


def _section(anchor: str, title: str, pieces: Iterator[Piece]) -> Section:
    return Section(anchor=anchor, title=title, pieces=tuple(pieces))
