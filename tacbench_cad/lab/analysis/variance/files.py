"""The files of a variance table: what stands in each, and writing all of them into a folder."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.lab.analysis.classification.settings import data_key
from tacbench_cad.lab.analysis.csvfile import write_csv
from tacbench_cad.lab.analysis.variance import between, components
from tacbench_cad.lab.analysis.variance.registration import COLUMNS as SEATING_COLUMNS
from tacbench_cad.lab.analysis.variance.registration import Seating
from tacbench_cad.lab.analysis.variance.table import COLUMNS, VarianceResult
from tacbench_cad.util.files import locked, replacing

#: What was asked for, beside the tables.
SETTINGS_FILE = "variance_settings.json"
#: Heads of ``floor_removed.csv``: everything in it is for ddof 1.
REMOVED_COLUMNS = (
    "printer",
    "filament",
    "texture",
    "force_level",
    "variance",
    "floor",
    "floor_from",
    "floor_removed",
    "low",
    "high",
)
#: Heads of ``positions.csv``.
POSITION_COLUMNS = ("printer", "filament", "texture", "force_level", "position", "x_mm", "y_mm", "variance")
#: Heads of ``permutation.csv``.
TEST_COLUMNS = (
    "force_level",
    "first",
    "second",
    "textures",
    "prints_first",
    "prints_second",
    "ratio",
    "statistic",
    "p",
    "p_holm",
    "least_p",
)


def cell_rows(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Rows of ``variance.csv``."""
    for one in result.cells:
        yield {name: getattr(one, name) for name in COLUMNS}


def removed_rows(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Rows of ``floor_removed.csv``."""
    for one in result.removed:
        cell = one.cell
        yield {
            **{name: getattr(cell, name) for name in ("printer", "filament", "texture", "force_level", "floor")},
            "variance": one.variance,
            "floor_from": one.floor_from,
            "floor_removed": one.removed,
            "low": one.low,
            "high": one.high,
        }


def matrix_rows(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Rows of ``between_textures.csv``."""
    for one in result.matrices:
        printer, filament = one.combination.split("_", 1)
        yield from one.rows(printer, filament)


def position_rows(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Rows of ``positions.csv``."""
    places = result.collection.info.protocol.grid.positions_mm
    for (level, (combination, texture)), values in result.positions.items():
        printer, filament = combination.split("_", 1)
        for number in np.flatnonzero(np.isfinite(values)).tolist():
            yield {
                "printer": printer,
                "filament": filament,
                "texture": texture,
                "force_level": level,
                "position": number + 1,
                "x_mm": float(places[number, 0]),
                "y_mm": float(places[number, 1]),
                "variance": float(values[number]),
            }


def test_rows(result: VarianceResult) -> Iterator[dict[str, Any]]:
    """Rows of ``permutation.csv``."""
    for one in result.tests:
        outcome = one.outcome
        yield {
            "force_level": one.force_level,
            "first": one.first,
            "second": one.second,
            "textures": outcome.textures,
            "prints_first": outcome.prints[0],
            "prints_second": outcome.prints[1],
            "ratio": outcome.ratio,
            "statistic": outcome.statistic,
            "p": outcome.p,
            "p_holm": one.p_holm,
            "least_p": outcome.least_p,
        }


def settings(result: VarianceResult, registered: bool) -> dict[str, Any]:
    """What was asked for, for ``variance_settings.json``: a report's methods paragraph names it."""
    return {
        "analysis": "variance",
        "version": __version__,
        "colour": result.preprocess.colour,
        "resolution": result.preprocess.resolution,
        "ddof": result.ddof,
        "seed": result.seed,
        "registered": registered,
        "left_out": list(result.left_out),
        "data": data_key(result.collection),
    }


def write_all(result: VarianceResult, folder: Path, seatings: tuple[Seating, ...] = ()) -> list[Path]:
    """Write every table as CSV and every figure as PNG and PDF.

    Args:
        result: The variance table.
        folder: The folder; it is made if it is not there.
        seatings: What registration found, if it was asked for.

    Returns:
        The files.

    Raises:
        InputError: The folder cannot be written, or another process is writing to it.
        MissingToolError: matplotlib is not installed; the tables are written all the same.
    """
    from tacbench_cad.lab.analysis.variance.figures import draw_all

    with locked(folder):
        written = [
            write_csv(folder / "variance.csv", COLUMNS, cell_rows(result)),
            write_csv(folder / "floor_removed.csv", REMOVED_COLUMNS, removed_rows(result)),
            write_csv(folder / "components.csv", components.COLUMNS, result.components),
            write_csv(folder / "between_textures.csv", between.COLUMNS, matrix_rows(result)),
            write_csv(folder / "positions.csv", POSITION_COLUMNS, position_rows(result)),
            write_csv(folder / "permutation.csv", TEST_COLUMNS, test_rows(result)),
        ]
        if seatings:
            rows = (row for one in seatings for row in one.rows())
            written.append(write_csv(folder / "registration.csv", SEATING_COLUMNS, rows))
        written.append(folder / SETTINGS_FILE)
        with replacing(folder / SETTINGS_FILE) as temporary:
            temporary.write_text(json.dumps(settings(result, bool(seatings)), indent=1) + "\n", encoding="utf-8")
        return written + draw_all(result, folder)
