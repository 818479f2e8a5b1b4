"""The drawings of holder, jig and coupon: the numbers agree with the mesh, and the texts do not overlap."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest
from helpers.cases import mostly_long

pytest.importorskip("matplotlib", reason="drawings need the extra plot")
pytest.importorskip("build123d", reason="fixtures need the extra cad")

from helpers.drawing_measure import clashes, faults

from housing.coupon import Coupon
from housing.fixture import CHORD_MM
from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.extensions.drawings import Drawing
from tacbench_cad.extensions.drawings.fixtures import coupon_drawing, holder_drawing, jig_drawing
from tacbench_cad.spec.block import Block

_PAPER = Block.of(4)
_KEYED = Block.of(4, key_mm=3.0)
_JIG = Jig(holder=Holder(block=_PAPER))
_RELEASED = Holder(block=Block.of(1, "released"), preset="released")

DRAWINGS: dict[str, Callable[[], Drawing]] = {
    "holder": lambda: holder_drawing(Holder(block=_PAPER)),
    "holder, keyed": lambda: holder_drawing(Holder(block=_KEYED, fit="loose")),
    "holder, scaled": lambda: holder_drawing(Holder(block=Block.of(2, scale=2.0, key_mm=5.0), fit=0.0, rim_mm=0.0)),
    "holder, turned": lambda: holder_drawing(Holder(block=_KEYED, quarter_turns=1, rim_mm=5.0)),
    "holder, released": lambda: holder_drawing(_RELEASED),
    "tray": lambda: holder_drawing(Holder(block=_KEYED, slots=6)),
    "jig": lambda: jig_drawing(_JIG),
    "jig, turned, all holes": lambda: jig_drawing(Jig(holder=Holder(block=_KEYED, quarter_turns=3), marks="all")),
    "jig, released": lambda: jig_drawing(Jig(holder=_RELEASED)),
    "coupon": lambda: coupon_drawing(Coupon()),
}


@cache
def drawing_of(name: str) -> Drawing:
    return DRAWINGS[name]()


@pytest.mark.parametrize("name", mostly_long(DRAWINGS, "holder, keyed", "jig, turned, all holes"))
def test_every_number_is_the_distance_on_the_mesh(name: str) -> None:
    """Circles are approximated by chords; everything else is flat and as exact as a float32."""
    drawing = drawing_of(name)
    assert faults(drawing, CHORD_MM + 1e-4) == []
    assert clashes(drawing) == []


def test_the_numbers_of_a_holder_agree_with_its_specification() -> None:
    holder = Holder(block=_KEYED, slots=6)
    drawing = drawing_of("tray")
    numbers = {dimension.name: round(dimension.value_mm, 9) for dimension in drawing.dimensions}
    assert (numbers["plate x"], numbers["plate y"], numbers["plate height"]) == pytest.approx(holder.size_mm)
    assert (numbers["pocket x"], numbers["pocket y"], numbers["pocket depth"]) == pytest.approx(holder.pocket_size_mm)
    assert numbers["clearance"] == 0.15 and numbers["rim"] == 1.18
    assert numbers["pocket pitch x"] == pytest.approx(holder.pocket_size_mm[0] + holder.web_mm)
    assert "clearance" not in {dimension.name for dimension in drawing_of("holder, scaled").dimensions}
    assert {callout.text.split("\n")[0] for callout in drawing.plan.callouts} == {
        "4 x ⌀4 through",
        "6 x ⌀6 push-out",
        "corner filled,",
    }


def test_all_four_screw_holes_of_the_authors_are_placed() -> None:
    """The authors' screw holes are not symmetrical: rows and columns that differ have their own dimensions."""
    places = {(axis, round(bore.at_mm[axis], 6)) for bore in _RELEASED.screws for axis in (0, 1)}
    numbers = drawing_of("holder, released").plan.dimensions
    distances = [dimension for dimension in numbers if dimension.name.startswith("screw to screw")]
    assert {(line.axis, round(end[line.axis], 6)) for line in distances for end in (line.start, line.end)} == places
