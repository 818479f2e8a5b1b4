"""The tables of a variance result, with all digits, as they are written to CSV files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tacbench_cad.lab.analysis import conclusions
from tacbench_cad.lab.analysis.tables import Column, Row, Table
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, Level, parts_of
from tacbench_cad.lab.analysis.variance.registration import Seating
from tacbench_cad.lab.analysis.variance.result import VarianceResult
from tacbench_cad.util.text import short


def _level(text: str) -> Level:
    return text if text == ALL_LEVELS else int(text)


_PRINTER = (Column("printer"), Column("filament"))
#: The columns that name a cell of the table.
CELL = (*_PRINTER, Column("texture"), Column("force_level", _level))
#: The columns of ``floor_removed.csv`` whose fields in a cell have other names.
REMOVED = {"variance": "unbiased", "low": "floor_removed_low", "high": "floor_removed_high"}
#: The columns of each CSV file, by its name without suffix.
COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "printer_answers": conclusions.COLUMNS,
    "variance": (
        *CELL,
        *(Column(name, float) for name in ("variance", "floor", "low", "high")),
        *(Column(name, int) for name in ("prints", "presses")),
        Column("noise_alone", float),
        Column("quantity"),
        Column("published", float),
    ),
    # All values of this file are for ddof 1.
    "floor_removed": (
        *CELL,
        Column("variance", float, source=REMOVED["variance"]),
        Column("floor", float),
        Column("floor_from"),
        Column("floor_removed", float),
        *(Column(name, float, source=REMOVED[name]) for name in ("low", "high")),
    ),
    "components": (
        Column("force_level", _level),
        Column("component"),
        *(Column(name, float) for name in ("variance", "truncated", "low", "high")),
        Column("degrees_of_freedom", int),
        Column("includes"),
        Column("note"),
    ),
    "between_textures": (
        *_PRINTER,
        Column("force_level", _level),
        Column("texture"),
        Column("other_texture"),
        Column("variance", float),
        Column("presses", int),
    ),
    "positions": (
        *CELL,
        Column("position", int),
        *(Column(name, float) for name in ("x_mm", "y_mm", "variance")),
    ),
    "print_distances": (
        *CELL,
        Column("copy", int),
        Column("from_others", float, text=short),
    ),
    "motion": (
        *CELL,
        Column("frame", int),
        *(Column(name, float) for name in ("time_s", "distance_mm", "rotation_deg", "variance")),
    ),
    "permutation": (
        Column("force_level", _level),
        Column("first"),
        Column("second"),
        Column("textures", int, source="outcome.textures"),
        Column("prints_first", int, source=lambda test: test.outcome.prints[0]),
        Column("prints_second", int, source=lambda test: test.outcome.prints[1]),
        *(Column(name, float, source=f"outcome.{name}", text=short) for name in ("ratio", "statistic", "p")),
        Column("p_holm", float, "p for all pairs", text=short),
        Column("least_p", float, "smallest possible p", source="outcome.least_p", text=short),
    ),
    "registration": (
        *CELL,
        Column("copy", int),
        *(Column(name, float) for name in ("x_mm", "y_mm")),
        *(Column(name, float, text=short) for name in ("variance", "seating")),
        Column("variance_without_seating", float, "without seating", text=short),
    ),
}
#: The files that the protocol ``as-published`` writes; the other files exist only for the protocol ``paper``.
AS_PUBLISHED_FILES = ("variance", "floor_removed", "positions")


def tables_of(result: VarianceResult, seatings: Sequence[Seating] = ()) -> dict[str, Table]:
    """Return the tables of a result by the names of their files, without suffix.

    Args:
        result: The result.
        seatings: The offsets of the prints, if registration was computed.
    """
    items: dict[str, Sequence[object]] = {
        "printer_answers": list(conclusions.print_answers(result)) if result.protocol == "paper" else (),
        "variance": result.cells,
        "floor_removed": result.cells,
        "components": result.components,
        "between_textures": list(_pairs(result)),
        "positions": list(_positions(result)),
        "print_distances": list(_print_distances(result)),
        "motion": list(_motion(result)),
        "permutation": result.tests,
        "registration": [row for seating in seatings for row in seating.rows()],
    }
    exhibit = result.feature.exhibit
    tables = {
        name: Table.of(COLUMNS[name], rows)
        for name, rows in items.items()
        if result.protocol == "paper" or name in AS_PUBLISHED_FILES
    }
    if exhibit is not None:
        means = [
            {**parts_of(combination), "texture": texture, "force_level": level, **row}
            for (level, (combination, texture)), mean in result.means.items()
            for row in exhibit.rows(mean)
        ]
        tables[exhibit.name] = Table.of((*CELL, *exhibit.columns), means)
    return tables


def _pairs(result: VarianceResult) -> Iterator[Row]:
    """Yield the rows of ``between_textures.csv``: each pair once, and each texture with itself."""
    for matrix in result.matrices:
        for i, j in zip(*np.triu_indices(len(matrix.textures)), strict=True):
            if matrix.presses[i, j]:
                yield {
                    **parts_of(matrix.combination),
                    "force_level": matrix.force_level,
                    "texture": matrix.textures[i],
                    "other_texture": matrix.textures[j],
                    "variance": float(matrix.variance[i, j]),
                    "presses": int(matrix.presses[i, j]),
                }


def _print_distances(result: VarianceResult) -> Iterator[Row]:
    """Yield the rows of ``print_distances.csv``."""
    for (combination, texture), of_levels in result.sums.items():
        for level, cell in of_levels.items():
            for copy, square in cell.from_others().items():
                place = {**parts_of(combination), "texture": texture, "force_level": level}
                yield {**place, "copy": copy, "from_others": square}


def _motion(result: VarianceResult) -> Iterator[Row]:
    """Yield the rows of ``motion.csv``; the times and poses are means over the presses of a cell."""
    collection = result.collection
    for (level, (combination, texture)), values in result.steps.items():
        here = (collection.level == level) & (collection.combination == combination) & (collection.texture == texture)
        course = {
            name: getattr(collection.courses, name)[here].mean(axis=0).tolist()
            for name in ("time_s", "distance_mm", "rotation_deg")
        }
        for index, value in enumerate(values.tolist()):
            yield {
                **parts_of(combination),
                "texture": texture,
                "force_level": level,
                "frame": index + 1,
                **{name: of_frames[index] for name, of_frames in course.items()},
                "variance": value,
            }


def _positions(result: VarianceResult) -> Iterator[Row]:
    """Yield the rows of ``positions.csv``."""
    places = result.collection.pressing.positions_mm
    for (level, (combination, texture)), values in result.positions.items():
        for number in np.flatnonzero(np.isfinite(values)).tolist():
            yield {
                **parts_of(combination),
                "texture": texture,
                "force_level": level,
                "position": number + 1,
                "x_mm": float(places[number, 0]),
                "y_mm": float(places[number, 1]),
                "variance": float(values[number]),
            }
