"""The fit coupon: its pockets have the clearances that its numerals state."""

from __future__ import annotations

import itertools
import json

import manifold3d
import numpy as np
import pytest
from helpers.fixture_measure import manifold, overhang_heights, require_sound

from housing.coupon import CLEARANCES_MM, DEPTH_OF_POCKET_MM, STUB_MM, Coupon
from housing.lettering import word
from housing.marks import merged
from tacbench_cad.util.errors import InputError

COUPON = Coupon()


def test_mesh_and_solid_are_what_is_stated() -> None:
    part = COUPON.part()
    require_sound(part)
    assert part.name == part.kind == "coupon"
    assert part.genus == 0
    json.dumps(part.spec, allow_nan=False)
    # Only the tab is an overhang: it bridges 2 mm.
    assert overhang_heights(part.mesh[0]) == {round(COUPON.tab_height_mm[0], 3)}


@pytest.mark.parametrize("index", range(5))
def test_the_stub_fits_with_the_stated_clearance(index: int) -> None:
    solid = manifold(COUPON.part().mesh[0])
    pocket, clearance = COUPON.pockets[index], CLEARANCES_MM[index]
    x, y, z = STUB_MM
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        for shift, goes_in in ((clearance, True), (clearance + 0.01, False)):
            low = (pocket.low[0] + clearance + dx * shift, pocket.low[1] + clearance + dy * shift)
            stub = manifold3d.Manifold.cube((x, y, z)).translate((*low, 1.6))
            assert ((stub ^ solid).volume() < 1e-3) == goes_in


def test_the_stub_is_connected_to_the_plate_above_the_depth_of_the_pockets() -> None:
    solid = manifold(COUPON.part().mesh[0])
    assert len(solid.decompose()) == 1
    # Just above the tab's underside, plate and stub are connected, and there are no numerals yet.
    for height, pieces in ((DEPTH_OF_POCKET_MM, 2), (COUPON.tab_height_mm[0] + 0.1, 1)):
        assert len(solid.slice(height).decompose()) == pieces
    # The place where the tab breaks off does not go into a pocket.
    assert COUPON.tab_height_mm[0] > DEPTH_OF_POCKET_MM


def test_each_pocket_is_marked_with_its_clearance_in_hundredths() -> None:
    section = manifold(COUPON.part().mesh[0]).slice(COUPON.plate_mm[2] - 0.1)
    for pocket, letters in zip(COUPON.pockets, ("05", "10", "15", "20", "30"), strict=True):
        strip = manifold3d.CrossSection([pocket.corners - (0.0, 4.1)], manifold3d.FillRule.NonZero)
        strip = strip ^ manifold3d.CrossSection.square((200.0, 4.1)).translate((0.0, 0.3))
        engraved = (strip - section).area()
        assert engraved == pytest.approx(sum(polygon.area for polygon in merged(word(letters, (0.0, 0.0)))), rel=1e-3)


def test_walls_are_stated_and_checked() -> None:
    assert COUPON.min_wall_mm == min(COUPON.walls_mm.values()) == pytest.approx(0.7)
    pockets = COUPON.pockets
    between = [b.low[0] - a.high[0] for a, b in itertools.pairwise(pockets)]
    assert np.array(between) == pytest.approx(2.4)
    with pytest.raises(InputError) as error:
        Coupon(nozzle_mm=0.9)
    for word_ in ("nozzle", "0.9", "0.7 mm"):
        assert word_ in str(error.value)
    with pytest.raises(InputError):
        Coupon(nozzle_mm=-1.0)
