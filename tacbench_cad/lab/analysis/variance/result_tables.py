"""The tables of a variance result, with all digits, as they are written to CSV files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis import conclusions
from tacbench_cad.lab.analysis.tables import frame_of
from tacbench_cad.lab.analysis.variance.cells import CellKey, parts_of
from tacbench_cad.lab.analysis.variance.registration import Seating
from tacbench_cad.lab.analysis.variance.result import VarianceResult

#: The columns that name a cell of the table.
CELL = ("printer", "filament", "texture", "force_level")
#: The columns of ``variance.csv``.
VARIANCE = (*CELL, "variance", "floor", "low", "high", "prints", "presses", "noise_alone", "quantity", "published")
#: The columns of ``floor_removed.csv``, whose values are for ddof 1, with the fields of a cell that have the values.
REMOVED = {
    **dict.fromkeys(CELL, ""),
    "variance": "unbiased",
    "floor": "",
    "floor_from": "",
    "floor_removed": "",
    "low": "floor_removed_low",
    "high": "floor_removed_high",
}
#: The files that the protocol ``as-published`` writes; the other files exist only for the protocol ``paper``.
AS_PUBLISHED_FILES = ("variance", "floor_removed", "positions")
_TESTS = ("force_level", "first", "second", "textures", "prints_first", "prints_second", "ratio", "statistic", "p")
_SEATING = (*CELL, "copy", "x_mm", "y_mm", "variance", "seating", "variance_without_seating")


def tables_of(result: VarianceResult, seatings: Sequence[Seating] = ()) -> dict[str, pd.DataFrame]:
    """Return the tables of a result by the names of their files, without suffix.

    Args:
        result: The result.
        seatings: The offsets of the prints, if registration was computed.
    """
    removed = frame_of(result.cells, [field or name for name, field in REMOVED.items()])
    tables = {
        "variance": frame_of(result.cells, VARIANCE),
        "floor_removed": removed.set_axis(list(REMOVED), axis=1),
        "positions": frame_of(_positions(result), (*CELL, "position", "x_mm", "y_mm", "variance")),
    }
    if result.protocol == "paper":
        components = pd.DataFrame([dict(row) for row in result.components])
        tables = {
            "printer_answers": conclusions.answer_table(conclusions.print_answers(result)),
            **tables,
            "components": components.astype({"degrees_of_freedom": "Int64"}),
            "between_textures": frame_of(
                _pairs(result), (*CELL[:2], "force_level", "texture", "other_texture", "variance", "presses")
            ),
            "print_distances": frame_of(_print_distances(result), (*CELL, "copy", "from_others")),
            "motion": frame_of(_motion(result), (*CELL, "frame", "time_s", "distance_mm", "variance")),
            "permutation": frame_of(_tests(result), (*_TESTS, "p_holm", "least_p")),
            "registration": frame_of((row for seating in seatings for row in seating.rows()), _SEATING),
        }
    exhibit = result.feature.exhibit
    if exhibit is not None:
        means = [exhibit.table(mean).assign(**_place(level, key)) for (level, key), mean in result.means.items()]
        table = pd.concat(means)
        tables[exhibit.name] = table[[*CELL, *table.columns.drop(list(CELL))]]
    return tables


def _place(level: int | str, key: CellKey) -> dict[str, Any]:
    """Return the values of :data:`CELL`."""
    return {**parts_of(key[0]), "texture": key[1], "force_level": level}


def _tests(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``permutation.csv``."""
    for test in result.tests:
        first, second = test.outcome.prints
        yield {**vars(test), **vars(test.outcome), "prints_first": first, "prints_second": second}


def _pairs(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``between_textures.csv``: each pair once, and each texture with itself."""
    for matrix in result.matrices:
        for i, j in zip(*np.triu_indices(len(matrix.textures)), strict=True):
            if matrix.presses[i, j]:
                yield {
                    **_place(matrix.force_level, (matrix.combination, matrix.textures[i])),
                    "other_texture": matrix.textures[j],
                    "variance": float(matrix.variance[i, j]),
                    "presses": int(matrix.presses[i, j]),
                }


def _print_distances(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``print_distances.csv``."""
    for key, of_levels in result.sums.items():
        for level, cell in of_levels.items():
            for copy, square in cell.from_others().items():
                yield {**_place(level, key), "copy": copy, "from_others": square}


def _motion(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``motion.csv``; the times and distances are means over the presses of a cell."""
    collection = result.collection
    for (level, key), values in result.steps.items():
        here = (collection.level == level) & (collection.combination == key[0]) & (collection.texture == key[1])
        course = {
            name: getattr(collection.courses, name)[here].mean(axis=0).tolist() for name in ("time_s", "distance_mm")
        }
        for index, value in enumerate(values.tolist()):
            means = {name: of_frames[index] for name, of_frames in course.items()}
            yield {**_place(level, key), "frame": index + 1, **means, "variance": value}


def _positions(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Yield the rows of ``positions.csv``."""
    places = result.collection.pressing.positions_mm
    for (level, key), values in result.positions.items():
        for number in np.flatnonzero(np.isfinite(values)).tolist():
            x_mm, y_mm = places[number].tolist()
            place = {**_place(level, key), "position": number + 1, "x_mm": x_mm, "y_mm": y_mm}
            yield {**place, "variance": float(values[number])}
