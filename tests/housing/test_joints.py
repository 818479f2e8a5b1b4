"""build123d parts of holder, block and jig: labels, colours, and joints."""

from __future__ import annotations

import build123d as bd
import numpy as np
import pytest
from helpers.cases import mostly_long

from housing.bd import HolderPart, JigPart, assembled
from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.bd import TextureBlock
from tacbench_cad.geometry.part import COLOURS
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

BLOCK = Block.of(1, key_mm=3.0)
#: Two slots, with blocks turned by a quarter turn.
TRAY = Holder(block=BLOCK, slots=2, quarter_turns=1)
JIG = Jig(holder=TRAY)
MIDDLE = (bd.Align.CENTER, bd.Align.CENTER, bd.Align.MIN)


def box(shape: bd.Shape) -> tuple[float, ...]:
    bounds = shape.bounding_box()
    return (*bounds.min, *bounds.max)


def box_of_slot(holder: Holder, slot: int) -> tuple[float, ...]:
    """Return the bounding box of a block by its placement."""
    place = holder.block_placements()[slot]
    (x, y), (_, _, z) = holder.block.size_mm, place.origin_mm
    corners = place.to_holder(np.array([[0.0, 0.0], [x, y]]))
    return (*corners.min(axis=0), z, *corners.max(axis=0), z + holder.block.height_mm)


@pytest.mark.parametrize(
    ("align", "rotation"),
    mostly_long([(a, r) for a in (None, MIDDLE) for r in ((0, 0, 0), (20, 30, 40))], (MIDDLE, (20, 30, 40))),
)
def test_a_block_is_moved_into_its_slot_from_any_placement(align: object, rotation: tuple[float, ...]) -> None:
    holder = HolderPart(TRAY)
    for slot in (0, 1):
        block = bd.Pos(100, 50, -7) * TextureBlock(BLOCK, rotation=rotation, align=align)
        holder.joints[f"slot {slot + 1}"].connect_to(block.joints["underside"])
        assert box(block) == pytest.approx(box_of_slot(TRAY, slot), abs=1e-3)
        # The corner with the key is at the filled corner of the pocket.
        corner = TRAY.block_placements()[slot].to_holder([[23.3 - 1.0, 1.0]])[0]
        assert not block.is_inside(bd.Vector(*corner, 3.0))


@pytest.mark.parametrize(
    ("align", "rotation"),
    mostly_long([(None, (0, 0, 0)), (MIDDLE, (0, 0, 0)), (MIDDLE, (0, 10, 90))], (MIDDLE, (0, 10, 90))),
)
def test_the_jig_follows_a_moved_holder(align: object, rotation: tuple[float, ...]) -> None:
    holder = bd.Pos(5, 6, 7) * HolderPart(TRAY, rotation=rotation, align=align)
    seated = JigPart(JIG, rotation=(180, 0, 0), align=bd.Align.MAX)
    holder.joints["jig"].connect_to(seated.joints["holder"])
    # Back in the holder frame, it is in the place that the jig states.
    back = holder.joints["jig"].location.inverse() * seated
    assert box(back) == pytest.approx(box(bd.Solid(JIG.solid_in_use)), abs=1e-5)
    assert box(holder.joints["jig"].location.inverse() * holder) == pytest.approx((0, 0, 0, *TRAY.size_mm), abs=1e-5)


def test_an_assembly_of_holder_blocks_and_jig() -> None:
    blocks = [BLOCK, Block.of(2, key_mm=3.0)]
    assembly = assembled(TRAY, blocks, JIG)
    assert assembly.label == f"assembly_{TRAY.stem}"
    names = [TRAY.name, *(block.name for block in blocks), JIG.name]
    assert [child.label for child in assembly.children] == names
    for child, kind in zip(assembly.children, ("holder", "block", "block", "jig"), strict=True):
        assert child.color is not None
        assert tuple(child.color)[:3] == pytest.approx(tuple(bd.Color(COLOURS[kind]))[:3])
        assert child.is_valid
    assert box(assembly.children[2]) == pytest.approx(box_of_slot(TRAY, 1), abs=1e-3)
    assert box(assembly)[2::3] == pytest.approx((0.0, JIG.seat.roof_mm[1]), abs=1e-4)
    common = assembly.children[0] & assembly.children[1]
    assert common is None or sum(solid.volume for solid in common.solids()) < 1e-6


def test_parts_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(InputError, match="2 slots"):
        assembled(TRAY, [BLOCK] * 3)
    with pytest.raises(InputError, match="does not fit into"):
        assembled(TRAY, [Block.of(1)])
    with pytest.raises(InputError, match="does not fit onto"):
        assembled(TRAY, [], Jig(holder=Holder(block=BLOCK)))
