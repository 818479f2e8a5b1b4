"""The press grid of the paper."""

from __future__ import annotations

import pytest

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError


def test_the_grid_of_the_paper() -> None:
    grid = PressGrid.paper()
    assert grid.x_mm == (4.0, 5.25, 6.5, 7.75, 9.0)
    assert grid.y_mm == (18.0, 19.25, 20.5, 21.75, 23.0)
    assert PressGrid.paper(spacing="1mm").y_mm == (18.0, 19.0, 20.0, 21.0, 22.0)
    assert grid.positions_mm.shape == (25, 2)
    assert tuple(grid.positions_mm[1]) == (5.25, 18.0)


def test_the_grid_scales_with_the_block() -> None:
    half = PressGrid.paper(0.5)
    assert half.x_mm[-1] == 4.5
    assert half.spacing_mm == (0.625, 0.625)


def test_a_block_smaller_than_the_grid_is_refused_with_the_numbers() -> None:
    PressGrid.paper().require_on(Block.of(4))
    with pytest.raises(InputError, match=r"20 x 20 mm.*9 x 23 mm"):
        PressGrid.paper().require_on(Block.of(4, size_mm=(20.0, 20.0)))
    with pytest.raises(InputError, match="spacing"):
        PressGrid.paper(spacing="2mm")  # type: ignore[arg-type]
