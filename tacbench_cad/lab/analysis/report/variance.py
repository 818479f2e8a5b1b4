"""The sections of a report on how well it printed, from the files of ``tacbench variance``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.analysis.published import ROW_NAMES, VARIANCE
from tacbench_cad.lab.analysis.report import html, methods
from tacbench_cad.lab.analysis.report.sections import Study, figure, read_rows, read_settings, value
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, Cell
from tacbench_cad.lab.analysis.variance.files import SETTINGS_FILE
from tacbench_cad.util.errors import InputError


def variance_section(study: Study, folder: Path) -> Iterator[str]:
    """The variance table beside the paper's, with floor, intervals, components and tests.

    Args:
        study: The study.
        folder: Folder of the table's files, within the report's.
    """
    from tacbench_cad.lab.analysis.variance.notes import variance_warnings

    collection = study.collection
    cells = read_cells(folder)
    origin = floor_origins(folder, cells)
    left_out = [str(one) for one in read_settings(folder / SETTINGS_FILE).get("left_out", ())]
    warnings = variance_warnings(collection, cells, origin, left_out)
    unit = f"{collection.units}²" if collection.units.isalnum() else f"({collection.units})²"
    if warnings:
        yield html.heading(3, "To know before reading it")
        yield html.bullets(warnings)
    noise = _noise_alone(folder, cells, int(read_settings(folder / SETTINGS_FILE).get("ddof", 0)))
    single = list(dict.fromkeys(one.force_level for one in cells if one.force_level != ALL_LEVELS))
    for level in single if len(single) == 1 else [ALL_LEVELS, *single]:
        yield _variance_table(study, [one for one in cells if one.force_level == level], noise, level, unit)
    yield figure(study, folder, "variance", f"Variance in {unit} by texture, with 95 % intervals over prints.")
    yield from _removed(study, folder, unit)
    yield from _components(study, folder, unit)
    yield from _tests(study, folder)
    yield from _grades(study, cells, origin)


def methods_text(study: Study, folder: Path) -> tuple[str, Preprocess, int]:
    """How the table in a folder was computed: a paragraph, what was done to a reading, and ddof.

    Raises:
        InputError: The folder does not say, or its files are damaged.
    """
    settings = read_settings(folder / SETTINGS_FILE)
    cells = read_cells(folder)
    words = sorted({text for text in floor_origins(folder, cells).values() if text})
    try:
        preprocess = Preprocess(colour=bool(settings["colour"]), resolution=float(settings["resolution"]))
        ddof, seed = int(settings["ddof"]), int(settings["seed"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError("settings", str(folder / SETTINGS_FILE), f"holds a wrong or missing value: {error}") from None
    text = methods.variance_text(study.collection, preprocess, ddof, seed, " and ".join(words) or "nowhere")
    return text, preprocess, ddof


def read_cells(folder: Path) -> tuple[Cell, ...]:
    """The variance table in a folder that `tacbench variance` wrote.

    Raises:
        InputError: It cannot be read.
    """
    path = folder / "variance.csv"
    columns = ("printer", "filament", "texture", "force_level", "variance", "floor", "low", "high", "prints", "presses")
    cells = []
    for row in read_rows(path, columns):
        try:
            level = row["force_level"]
            cells.append(
                Cell(
                    printer=row["printer"],
                    filament=row["filament"],
                    texture=row["texture"],
                    force_level=level if level == ALL_LEVELS else int(level),
                    variance=float(row["variance"]),
                    floor=_float(row["floor"]),
                    low=_float(row["low"]),
                    high=_float(row["high"]),
                    prints=int(row["prints"]),
                    presses=int(row["presses"]),
                )
            )
        except ValueError as error:
            raise InputError("table", str(path), f"holds what is no number: {error}") from None
    return tuple(cells)


def _float(text: str) -> float | None:
    """A cell's number, None where it is empty."""
    return float(text) if text else None


def floor_origins(folder: Path, cells: Sequence[Cell]) -> dict[Cell, str]:
    """Where each cell's floor comes from, in the words of ``floor_removed.csv``; empty for none."""
    path = folder / "floor_removed.csv"
    keys = ("printer", "filament", "texture", "force_level")
    rows = {tuple(row[key] for key in keys): row["floor_from"] for row in read_rows(path, (*keys, "floor_from"))}
    return {one: rows.get(tuple(str(getattr(one, key)) for key in keys), "") for one in cells}


def _noise_alone(folder: Path, cells: Sequence[Cell], ddof: int) -> dict[Cell, float]:
    """What each figure would be if its readings differed by noise only.

    With n presses at a place that is (1 - 1/n) of the floor for ddof 0, and the floor itself for ddof 1.
    """
    keys = ("printer", "filament", "texture", "force_level")
    places = Counter(tuple(row[key] for key in keys) for row in read_rows(folder / "positions.csv", keys))
    found = {}
    for one in cells:
        *cell, level = (str(getattr(one, key)) for key in keys)
        count = sum(n for key, n in places.items() if list(key[:3]) == cell and level in (key[3], ALL_LEVELS))
        if one.floor is not None and count:
            found[one] = one.floor * (1.0 - (1 - ddof) * count / one.presses)
    return found


def _variance_table(
    study: Study, cells: Sequence[Cell], noise: Mapping[Cell, float], level: int | str, unit: str
) -> str:
    textures = study.collection.textures
    protocol = study.collection.info.protocol
    force = protocol.contact == "force"
    rows: list[list[Any]] = []
    combinations = dict.fromkeys((one.printer, one.filament) for one in cells)
    by_key = {((one.printer, one.filament), one.texture): one for one in cells}
    for both in combinations:
        name = ROW_NAMES.get(both, " ".join(both))
        of_row = [by_key.get((both, texture)) for texture in textures]
        rows.append([name, *("–" if one is None else f"{one.variance:.2f} {_ends(one)}" for one in of_row)])
        rows.append(["  noise alone gives", *(None if one is None else noise.get(one) for one in of_row)])
        if both in VARIANCE and study.collection.units == "counts":
            published = {f"texture-{i + 1}": figure for i, figure in enumerate(VARIANCE[both])}
            rows.append(["  the paper's table", *(published.get(texture) for texture in textures)])
    if level == ALL_LEVELS:
        what = "mean of the forces" if force else "mean of the depths"
    else:
        values = protocol.forces_n if force else protocol.depths_mm
        what = f"{'force' if force else 'depth'} level {level}, {values[int(level) - 1]:.4g} {'N' if force else 'mm'}"
    caption = f"Variance in {unit}, {what}: figure and 95 % interval over prints"
    file = study.file("variance/variance.csv")
    return html.table(caption, ("printer, filament", *textures), rows, study.simulated, file)


def _ends(cell: Cell) -> str:
    return "(no interval)" if cell.low is None or cell.high is None else f"({cell.low:.3g} to {_end(cell.high)})"


def _end(number: float) -> str:
    return f"{number:.3g}" if number < 1000.0 else f"{number:,.0f}"


def _removed(study: Study, folder: Path, unit: str) -> Iterator[str]:
    heads = ("printer", "filament", "texture", "variance", "floor", "floor_from", "floor_removed", "low", "high")
    rows = [row for row in read_rows(folder / "floor_removed.csv", heads) if row["force_level"] == ALL_LEVELS]
    yield html.table(
        f"With the noise floor removed (ddof 1, mean of the forces, {unit}); below 0 means less than the floor",
        [one.replace("_", " ") for one in heads],
        [[value(row[name]) for name in heads] for row in rows],
        study.simulated,
        study.file("variance/floor_removed.csv"),
    )


def _components(study: Study, folder: Path, unit: str) -> Iterator[str]:
    heads = ("component", "variance", "low", "high", "degrees_of_freedom", "includes", "note")
    rows = [row for row in read_rows(folder / "components.csv", heads) if row["force_level"] == ALL_LEVELS]
    yield html.table(
        f"Variance components, mean of the forces ({unit}): ISO 5725 repeatability and reproducibility among them",
        [one.replace("_", " ") for one in heads],
        [[value(row[name]) for name in heads] for row in rows],
        study.simulated,
        study.file("variance/components.csv"),
    )
    yield figure(study, folder, "components", "Where the variance comes from.")


def _tests(study: Study, folder: Path) -> Iterator[str]:
    heads = ("force_level", "first", "second", "prints_first", "prints_second", "ratio", "p", "p_holm", "least_p")
    rows = read_rows(folder / "permutation.csv", heads)
    if rows:
        yield html.table(
            "Do two printers vary alike from print to print? Permutation test; p Holm is adjusted for all pairs of a "
            "level, least p is the smallest that so few prints can give",
            [one.replace("_", " ") for one in heads],
            [[value(row[name]) for name in heads] for row in rows],
            study.simulated,
            study.file("variance/permutation.csv"),
        )


def _grades(study: Study, cells: Sequence[Cell], origin: Mapping[Cell, str]) -> Iterator[str]:
    from tacbench_cad.lab.analysis.variance.grade import grade
    from tacbench_cad.lab.analysis.variance.grade_limits import Context

    collection = study.collection
    context = Context.of(collection.info, floor_from=origin.values(), simulated=collection.simulated, left_out=())
    try:
        grades = grade(cells, context)
    except InputError:
        return  # none of the paper's textures: there is nothing to stand beside
    for one in grades:
        yield html.heading(3, f"{one.printer} {one.filament} beside the published table")
        yield html.paragraph("What the data support:")
        yield html.bullets(one.supports or ("nothing",))
        yield html.paragraph("What they cannot:")
        yield html.bullets(one.limits or ("nothing more than what is said above",))


def maps_section(study: Study, folder: Path) -> Iterator[str]:
    """Heat maps and matrices between textures."""
    yield figure(study, folder, "variance_pixels", "Which pixels vary: mean over positions and forces.")
    positions = "Which positions vary: mean over forces."
    yield figure(study, folder, "variance_positions", positions, "variance/positions.csv")
    yield figure(
        study,
        folder,
        "between_textures",
        "Variance of each pixel over both textures' readings at the same position, mean over pixels and positions; on "
        "the diagonal the table's own. A pair far above both of its diagonal figures can be told apart.",
        "variance/between_textures.csv",
    )
