"""The printed top computed from beads, and the position of the block on the bed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from helpers.gcode_writer import write_gcode

from tacbench_cad.extensions.slicing.gcode import Beads, Sliced, read_gcode
from tacbench_cad.extensions.slicing.printed_surface import BedPlace, frames_of, printed_heights, staircase
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

SMALL = Block.of(2, scale=0.5)


def of_beads(rows: list[tuple[float, ...]], tops: list[float], floor: float = 0.0) -> Sliced:
    """Return a sliced print from rows of x0, y0, x1, y1, top, height and area."""
    table = np.array(rows)
    beads = Beads(
        start_mm=table[:, 0:2],
        end_mm=table[:, 2:4],
        top_mm=table[:, 4],
        height_mm=table[:, 5],
        area_mm2=table[:, 6],
        wall=np.ones(len(rows), dtype=bool),
    )
    return Sliced(
        path=Path("made.gcode"),
        dialect="PrusaSlicer",
        beads=beads,
        layer_tops_mm=np.array(tops),
        floor_mm=floor,
        filament_mm=1.75,
        filament_assumed=False,
        left_out={},
        unknown=(),
    )


def test_the_profile_of_one_bead() -> None:
    """A bead of 0.6 mm x 0.2 mm is flat over a width of 0.4 mm and has round shoulders and round ends."""
    area = 0.4 * 0.2 + math.pi / 4.0 * 0.2**2
    sliced = of_beads([(2.0, 3.0, 9.0, 3.0, 0.7, 0.2, area)], [0.7], floor=0.1)
    x, y = np.linspace(0.0, 11.0, 221), np.linspace(2.5, 3.5, 101)
    heights = printed_heights(sliced, SMALL, BedPlace(x_mm=0.0, y_mm=0.0), x, y)
    along, across = np.clip(x, 2.0, 9.0) - x, y - 3.0
    distance = np.hypot(along[:, None], across[None, :])
    shoulder = 0.1 - np.sqrt(np.maximum(0.0, 0.1**2 - np.maximum(0.0, distance - 0.2) ** 2))
    clear = np.abs(distance - 0.3) > 1e-6
    assert heights[clear] == pytest.approx(np.where(distance < 0.3, 0.6 - shoulder, 0.0)[clear], abs=1e-9)


@pytest.mark.parametrize("quarters", range(4))
def test_the_frame_is_found_in_every_orientation(tmp_path: Path, quarters: int) -> None:
    path = write_gcode(tmp_path / "a.gcode", SMALL, corner_mm=(41.3, 77.7), quarters=quarters, highest_mm=1.2)
    frames = frames_of(read_gcode(path), SMALL)
    assert [frame.quarters for frame in frames] == [quarters % 2, quarters % 2 + 2]
    for frame in frames:
        assert (frame.x_mm, frame.y_mm) == pytest.approx((41.3, 77.7), abs=0.01)
        assert frame.outline_mm is not None and frame.source == "outer walls"


@pytest.mark.parametrize("quarters", range(4))
def test_a_frame_converts_to_block_coordinates(quarters: int) -> None:
    points = np.array([(0.0, 0.0), (11.65, 0.0), (3.0, 2.0), (11.65, 15.0)])
    turned = [((x, y), (15.0 - y, x), (11.65 - x, 15.0 - y), (y, 11.65 - x))[quarters] for x, y in points.tolist()]
    frame = BedPlace(x_mm=-4.0, y_mm=9.0, quarters=quarters)
    assert frame.to_block(np.add(turned, (-4.0, 9.0)), (11.65, 15.0)) == pytest.approx(points)


def test_the_outline_of_another_part_is_refused(tmp_path: Path) -> None:
    path = write_gcode(tmp_path / "a.gcode", SMALL, highest_mm=1.2)
    with pytest.raises(InputError, match=r"another part.*12\.0\d x 15\.\d+ mm.*23\.3 x 30|another part.*23\.3 x 30"):
        frames_of(read_gcode(path), Block.of(2))


def test_no_outer_wall_in_the_low_layers_is_refused() -> None:
    sliced = of_beads([(0.0, 0.0, 5.0, 0.0, 0.2, 0.2, 0.08)], [0.2])
    inner = Beads(**{**vars(sliced.beads), "wall": np.array([False])})
    with pytest.raises(InputError, match="--frame"):
        frames_of(Sliced(**{**vars(sliced), "beads": inner}), SMALL)


def test_the_ideal_staircase() -> None:
    """Layers end at 0.3, 0.5, 0.7 mm and so on. A layer is printed where the formula reaches its middle."""
    sliced = of_beads([(0.0, 0.0, 5.0, 0.0, 0.3, 0.3, 0.08)], [0.3, 0.5, 0.7])
    heights = np.array([0.0, 0.14, 0.16, 0.39, 0.41, 0.61, 0.79, 0.81, 1.32])
    assert staircase(sliced, heights) == pytest.approx([0.0, 0.0, 0.3, 0.3, 0.5, 0.7, 0.7, 0.9, 1.3])
    raised = Sliced(**{**vars(sliced), "floor_mm": 0.1})
    assert staircase(raised, np.array([0.09, 0.11, 0.29, 0.31])) == pytest.approx([0.0, 0.2, 0.2, 0.4])
