"""Holders and jigs for blocks whose outlines are not rectangles."""

import math

import numpy as np
import pytest

from housing.holder import Holder
from housing.jig import Jig
from housing.seat import RECESS_MM
from tacbench_cad import Block, Disc, Polygon, RegularPolygon, Ring
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import FORMATS
from tacbench_cad.spec.outlines import Circle
from tacbench_cad.util.errors import InputError

CORNER = Polygon(points_mm=((0, 0), (32, 0), (32, 16), (16, 16), (16, 32), (0, 32)))


@pytest.mark.parametrize(
    ("outline", "turns", "slots"),
    [(Disc(diameter_mm=30), 0, 1), (Ring(outer_mm=40, inner_mm=12), 0, 2), (CORNER, 1, 1)],
    ids=["disc", "ring", "polygon"],
)
def test_files_of_holders_have_the_volume_in_closed_form(tmp_path, outline, turns: int, slots: int) -> None:
    holder = Holder(block=Block.of(2, outline=outline), quarter_turns=turns, slots=slots, nozzle_mm=0.4)
    path = tmp_path / "holder.stl"
    FORMATS["stl"].write(holder.part(), path)
    report = verify(holder.part(), path)
    assert report.ok, str(report)


def test_the_jig_over_a_disc_has_a_round_recess_with_the_stated_clearance(tmp_path) -> None:
    jig = Jig(holder=Holder(block=Block.of(2, outline="disc:30"), fit=0.2))
    ((bore, depth),) = jig.recessed
    assert bore.diameter_mm == pytest.approx(30.0 + 2.0 * (0.2 + RECESS_MM))
    assert depth == jig.seat.recess_depth_mm
    path = tmp_path / "jig.step"
    FORMATS["step"].write(jig.part(), path)
    assert verify(jig.part(), path).ok


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("outline", ["disc:30", "hexagon:36", "triangle:60", CORNER], ids=str)
def test_the_pocket_surrounds_the_block_at_the_clearance(outline, turns: int) -> None:
    holder = Holder(block=Block.of(2, outline=outline), fit=0.3, quarter_turns=turns)
    loop, block = holder.pocket_loop, holder.block
    assert loop is not None and block.outline is not None
    own = block.outline.chords(1e-4).loops[0].array
    assert loop.distance(*own.T).max() == pytest.approx(-0.3, abs=1e-3)
    (place,) = holder.block_placements()
    placed = place.to_holder(holder.pocket_outline())
    (pocket,) = holder.pockets
    assert placed.min(axis=0) == pytest.approx(pocket.low, abs=1e-3)
    assert placed.max(axis=0) == pytest.approx(pocket.high, abs=1e-3)
    if isinstance(loop, Circle):
        assert loop.radius == pytest.approx(15.3)


def test_orientations_follow_from_the_outline() -> None:
    def admitted(outline) -> tuple[int, ...]:
        return Holder(block=Block.of(2, outline=outline)).admits_deg

    assert admitted(Disc(diameter_mm=30)) == ()
    assert admitted(RegularPolygon(sides=6, diameter_mm=36)) == (0, 60, 120, 180, 240, 300)
    assert admitted(CORNER) == (0,)


def test_the_push_out_hole_is_below_the_material_of_a_ring() -> None:
    block = Block.of(2, outline="ring:40,12")
    push_out = Holder(block=block).push_out
    assert push_out is not None and block.outline is not None
    turns = np.linspace(0.0, 2.0 * math.pi, 60)
    x, y = push_out.bore.at_mm
    radius = push_out.bore.diameter_mm / 2.0
    assert block.outline.distance(x + radius * np.cos(turns), y + radius * np.sin(turns)).max() <= -1.6


def test_a_narrow_ring_and_a_jig_outside_of_the_outline_are_refused() -> None:
    with pytest.raises(InputError, match="ledge round the push-out hole"):
        Holder(block=Block.of(2, outline="ring:30,22"))
    with pytest.raises(InputError, match="1 of the 25 press positions"):
        Jig(holder=Holder(block=Block.of(2, outline="hexagon:36")))
    with pytest.raises(InputError, match="the authors' holder"):
        Holder(block=Block.of(2, outline="disc:30"), preset="released")
