"""CadQuery: holder, jig and coupon as solids, on workplanes, and in assemblies."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

cq = pytest.importorskip("cadquery")
pytest.importorskip("build123d")

from helpers.fixtures import PAIR as HOLDER
from helpers.fixtures import PAIR_JIG as JIG

from housing import Coupon, Fixture, Holder
from housing import cq as plugin
from housing.bd import assembled as joined
from tacbench_cad import Block, InputError


def box(shape: cq.Shape) -> tuple[float, ...]:
    bounds = shape.BoundingBox()
    return (bounds.xmin, bounds.ymin, bounds.zmin, bounds.xmax, bounds.ymax, bounds.zmax)


@pytest.mark.parametrize("fixture", [HOLDER, JIG, Coupon()], ids=lambda fixture: fixture.kind)
def test_a_solid_has_the_volume_and_the_name_of_the_part(fixture: Fixture) -> None:
    solid = plugin.solid(fixture)
    assert solid.isValid() and solid.label == fixture.name
    assert solid.Volume() == pytest.approx(fixture.volume_mm3, rel=1e-8)
    printed = plugin.workplane(fixture, as_printed=True).val()
    assert box(printed) == pytest.approx((0.0, 0.0, 0.0, *fixture.size_mm), abs=1e-5)


def test_the_assembly_agrees_with_the_joints_of_build123d() -> None:
    by_plugin, by_joints = plugin.assembled(HOLDER, jig=JIG), joined(HOLDER, jig=JIG)
    assert by_plugin.name == by_joints.label and len(by_plugin.children) == len(by_joints.children) == 4
    for child, other in zip(by_plugin.children, by_joints.children, strict=True):
        located, expected = child.obj.located(child.loc), other.bounding_box()
        assert box(located) == pytest.approx((*expected.min, *expected.max), abs=2e-3)
        assert child.name.partition(" ")[0] == other.label
        assert child.color.toTuple()[:3] == pytest.approx(tuple(other.color)[:3], abs=1e-6)


def test_parts_that_do_not_fit_together_are_refused() -> None:
    with pytest.raises(InputError, match="does not fit into"):
        plugin.assembled(HOLDER, [Block.of(1)])
    with pytest.raises(InputError, match="2 slots"):
        plugin.assembled(HOLDER, [HOLDER.block] * 3)
    with pytest.raises(InputError, match="does not fit onto"):
        plugin.assembled(Holder(block=HOLDER.block), jig=JIG)


@pytest.fixture
def registered() -> Iterator[None]:
    plugin.register()
    yield
    del cq.Workplane.fixture


@pytest.mark.usefixtures("registered")
def test_the_registered_method_combines() -> None:
    coupon = Coupon()
    both = cq.Workplane().pushPoints([(0.0, 0.0), (0.0, 60.0)]).fixture(coupon)
    assert both.solids().size() == 2
    assert sum(solid.Volume() for solid in both.solids().vals()) == pytest.approx(2 * coupon.volume_mm3, rel=1e-8)
