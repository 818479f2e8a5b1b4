"""Test the ground under the simulated sensor: block, gap, rim, and nothing beyond."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tacbench_cad.lab.simulate.heights import (
    CELL_MM,
    MAX_CELLS,
    PLATE_MM,
    HeightMap,
    cell_of,
    centres,
    flat_plate,
    held,
    on_block,
)
from tacbench_cad.lab.study.spec import HolderRim
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

HOLDER = HolderRim(rim_mm=1.18, gap_mm=0.3)


def _ground(block: Block, holder: HolderRim = HOLDER) -> HeightMap:
    x, y = centres(block)
    return held(block, on_block(block, np.zeros((y.size, x.size))), holder)


def _at(ground: HeightMap, x_mm: float, y_mm: float) -> float:
    row, column = np.argmin(np.abs(ground.y_mm - y_mm)), np.argmin(np.abs(ground.x_mm - x_mm))
    return float(ground.z_mm[row, column])


def test_cells_cover_the_block_with_x_along_the_columns() -> None:
    block = Block.of(1)
    x, y = centres(block)
    assert (x.size, y.size) == (233, 300)
    assert x[0] == pytest.approx(CELL_MM / 2) and x[-1] == pytest.approx(23.3 - CELL_MM / 2)
    assert y[-1] == pytest.approx(30.0 - CELL_MM / 2)


def test_a_large_block_keeps_the_map_small() -> None:
    block = Block.of(1, scale=20.0)
    assert cell_of(block) == pytest.approx(600.0 / MAX_CELLS)
    assert max(axis.size for axis in centres(block)) == MAX_CELLS


@pytest.mark.parametrize("x_mm", [-0.05, -0.25, 23.35, 23.55])
def test_the_gap_is_open(x_mm: float) -> None:
    assert _at(_ground(Block.of(1)), x_mm, 15.0) == -math.inf


@pytest.mark.parametrize(
    "place", [(-0.35, 15.0), (23.65, 15.0), (11.0, -0.35), (11.0, 30.35), (-PLATE_MM, 15.0), (-0.35, -0.35)]
)
def test_the_rim_begins_beyond_the_gap(place: tuple[float, float]) -> None:
    assert _at(_ground(Block.of(1)), *place) == -1.18


def test_nothing_lies_beyond_the_plate() -> None:
    ground = _ground(Block.of(1))
    wide = PLATE_MM + HOLDER.gap_mm
    assert ground.x_mm[0] <= -wide + CELL_MM and ground.x_mm[-1] >= 23.3 + wide - CELL_MM
    assert np.all(np.isfinite(ground.z_mm[ground.y_mm < -HOLDER.gap_mm - CELL_MM][2:, 2:-2]))


def test_the_block_has_its_own_height() -> None:
    ground = _ground(Block.of(1))
    rows, columns = (ground.y_mm > 0) & (ground.y_mm < 30.0), (ground.x_mm > 0) & (ground.x_mm < 23.3)
    assert np.all(ground.z_mm[np.ix_(rows, columns)] == 0.0)
    assert ground.top_mm == 0.0


def test_a_key_cuts_the_corner_and_the_rim_follows_it() -> None:
    ground = _ground(Block.of(1, key_mm=3.0))
    # The cut of the key runs from (20.3, 0) to (23.3, 3).
    assert _at(ground, 21.5, 1.45) == 0.0
    assert _at(ground, 21.95, 1.45) == -math.inf
    assert _at(ground, 23.0, 0.3) == -1.18


def test_the_rim_follows_a_disc() -> None:
    ground = _ground(Block.of(1, outline="disc:20"))
    corner = 10.0 + math.sqrt(0.5) * np.array([9.9, 10.15, 10.45])
    assert [_at(ground, at, at) for at in corner] == [0.0, -math.inf, -1.18]


def test_the_hole_of_a_ring_has_no_surface() -> None:
    ground = _ground(Block.of(1, outline="ring:20,8"))
    assert [_at(ground, at, 10.05) for at in (0.15, 5.9, 6.15, 10.05, 14.15)] == [0.0, 0.0, *[-math.inf] * 2, 0.0]
    assert _at(ground, -0.45, 10.05) == -1.18


def test_a_rim_above_the_block_is_the_highest() -> None:
    assert _ground(Block.of(1), HolderRim(rim_mm=-0.5)).top_mm == 0.5


def test_near_contains_only_cells_within_the_radius() -> None:
    ground = flat_plate(10.0)
    rows, columns = ground.near(100.0, 0.0, 5.0)
    assert ground.z_mm[rows, columns].size == 0
    rows, columns = ground.near(1.0, -2.0, 1.5)
    assert ground.x_mm[columns].min() >= -0.5 and ground.x_mm[columns].max() <= 2.5
    assert ground.x_mm[columns].size == 30 and ground.y_mm[rows].size == 30


@pytest.mark.parametrize(
    ("z", "cell"),
    [(np.zeros((0, 3)), 0.1), (np.zeros(4), 0.1), (np.full((2, 2), np.nan), 0.1), (np.zeros((2, 2)), 0.0)],
)
def test_invalid_maps_are_refused(z: np.ndarray, cell: float) -> None:
    with pytest.raises(InputError):
        HeightMap(z_mm=z, x0_mm=0.0, y0_mm=0.0, cell_mm=cell)
