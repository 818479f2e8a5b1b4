"""Taxim: if the file is read line by line, as Taxim does, the height map has the heights of the formula.

Taxim has no package, and its calibration is not part of this project. This module therefore repeats how Taxim loads a
file and fills its height map (480 x 640 pixels of 0.0295 mm; points below 0.2 mm are left out), without its code.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import Exported

from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real

ROWS, COLUMNS, PIXEL_MM, MIN_MM = 480, 640, 0.0295, 0.2


def points_of(path: Path) -> np.ndarray:
    """Return the points (n, 3) in mm: their number is at the end of line 4, and they start in line 11."""
    lines = path.read_text(encoding="ascii").splitlines()
    count = int(lines[3].split(" ")[-1])
    assert lines[0] == "ply" and lines[9] == "end_header" and len(lines) == 10 + count
    return np.loadtxt(lines[10 : 10 + count])


def map_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the height map in mm with rows along y, and the lower corner (x, y) of its first pixel in mm."""
    centre = points[:, :2].mean(axis=0)
    columns = ((points[:, 0] - centre[0]) / PIXEL_MM + COLUMNS // 2).astype(int)
    rows = ((points[:, 1] - centre[1]) / PIXEL_MM + ROWS // 2).astype(int)
    on = (columns > 0) & (columns < COLUMNS) & (rows > 0) & (rows < ROWS) & (points[:, 2] > MIN_MM)
    heights = np.zeros((ROWS, COLUMNS))
    heights[rows[on], columns[on]] = points[on, 2]
    return heights, centre - PIXEL_MM * np.array([COLUMNS // 2, ROWS // 2])


@pytest.mark.parametrize("number", mostly_long("24", "2"))
def test_heights(number: str, exported: Exported) -> None:
    block = Block.of(number)
    points = points_of(exported(number, "taxim") / f"texture-{number}.ply")
    x, y, z = points.T
    steepest = block.surface.bound(1, 0) + block.surface.bound(0, 1)
    assert np.abs(z - block.height_at(x, y)).max() <= 5e-6 * (1.0 + steepest) + 1e-12
    for values, side in ((x, block.size_mm[0]), (y, block.size_mm[1])):
        lines = np.unique(values)
        assert (lines[0], lines[-1]) == pytest.approx((0.0, side)) and np.diff(lines).max() <= PIXEL_MM
    heights, corner = map_of(points)
    assert heights[1:, 1:].min() > MIN_MM, "the height map has a hole"
    mid = [corner[k] + PIXEL_MM * (np.arange(1, count) + 0.5) for k, count in enumerate((COLUMNS, ROWS))]
    above = block.datum_mm + block.surface.grid(*mid).T
    assert np.abs(heights[1:, 1:] - above).max() <= steepest * PIXEL_MM
    assert np.abs(heights[1:, 1:] - above).mean() < 0.1 * block.relief_mm
