"""CadQuery: the block in a chain of calls, cut, and its dimensions."""

from __future__ import annotations

from collections.abc import Iterator

import cadquery as cq
import pytest
from helpers.solid_reference import block_area_mm2, hole_mm3, kernel_volume_mm3

from tacbench_cad import cq as plugin
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

BLOCK = Block.of(2, key_mm=3.0)
VOLUME = BLOCK.volume_mm3(BLOCK.solid_datum_mm)


@pytest.fixture
def registered() -> Iterator[None]:
    plugin.register()
    yield
    del cq.Workplane.textureBlock
    del cq.Workplane.texture


def test_the_solid_has_its_dimensions_and_volume() -> None:
    block = Block.of(1)
    solid = plugin.solid(block)
    assert solid.isValid()
    assert solid.ShapeType() == "Solid"
    assert solid.Volume() == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=1e-5)
    assert solid.Area() == pytest.approx(block_area_mm2(block), rel=1e-4)
    box = solid.BoundingBox()
    sides = (box.xmin, box.xmax, box.ymin, box.ymax, box.zmin, box.zmax)
    assert sides == pytest.approx((0, 23.3, 0, 30, 0, 7), abs=1e-3)


def test_eachpoint_adds_a_block_at_every_point() -> None:
    chain = cq.Workplane().rarray(40, 50, 2, 2).eachpoint(plugin.texture_block(BLOCK))
    assert len(chain.vals()) == 4
    corners = sorted((round(s.BoundingBox().xmin), round(s.BoundingBox().ymin)) for s in chain.vals())
    assert corners == [(-20, -25), (-20, 25), (20, -25), (20, 25)]
    assert sum(s.Volume() for s in chain.vals()) == pytest.approx(4 * VOLUME, rel=1e-5)


def test_invoke_adds_a_block_at_every_point_in_the_axes_of_the_workplane() -> None:
    chain = cq.Workplane("XZ", origin=(0, 10, 0)).pushPoints([(0, 0), (30, 0)]).invoke(plugin.texture_block(BLOCK))
    assert len(chain.vals()) == 2
    box = chain.vals()[1].BoundingBox()
    assert (box.xmin, box.ymin, box.ymax, box.zmin, box.zmax) == pytest.approx((30, 3, 10, 0, 30), abs=1e-3)


@pytest.mark.usefixtures("registered")
def test_registered_method_combines_like_box() -> None:
    plate = (
        cq.Workplane().box(80, 60, 4, centered=(True, True, False)).faces(">Z").workplane(centerOption="CenterOfMass")
    )
    combined = plate.rarray(35, 1, 2, 1).textureBlock(BLOCK)
    assert combined.solids().size() == 1
    assert combined.val().isValid()
    assert combined.val().Volume() == pytest.approx(80 * 60 * 4 + 2 * VOLUME, rel=1e-5)
    separate = cq.Workplane().rarray(35, 1, 2, 1).textureBlock(BLOCK, combine=False)
    assert len(separate.vals()) == 2


@pytest.mark.parametrize("number", [2, pytest.param(4, marks=pytest.mark.long)])
def test_a_hole_through_a_texture(number: int) -> None:
    block = Block.of(number)
    solid = plugin.solid(block)
    drilled = cq.Workplane(solid).pushPoints([(11.0, 15.0)]).circle(3.0).cutThruAll()
    assert drilled.val().isValid()
    removed = hole_mm3(block, (11.0, 15.0), 3.0)
    volume = kernel_volume_mm3(drilled.val().wrapped)
    assert volume == pytest.approx(block.volume_mm3(block.solid_datum_mm) - removed, rel=1e-4)


def test_texture_face() -> None:
    face = plugin.texture_face(Block.of(2))
    assert isinstance(face, cq.Face)
    assert face.isValid()
    assert face.Area() == pytest.approx(872.517, rel=1e-4)


def test_label_name_and_colour() -> None:
    assert plugin.solid(BLOCK).label == BLOCK.name
    assembly = plugin.assembly(BLOCK)
    outer = cq.Assembly().add(assembly, loc=cq.Location((1, 2, 3)))
    assert assembly.name == BLOCK.name
    assert assembly.color is not None
    assert assembly.color.toTuple()[:3] == pytest.approx((0xE3 / 255, 0xB7 / 255, 0x78 / 255), abs=1e-6)
    assert outer.toCompound().BoundingBox().xmin == pytest.approx(1.0, abs=1e-3)


def test_a_texture_on_a_face_by_selector_and_by_face() -> None:
    plate = cq.Workplane().box(20, 20, 5)
    by_name = plugin.textured(plate, ">Z", 2, depth_mm=0.8)
    by_face = plugin.textured(plate.val(), plate.faces(">Z").val(), "texture-2", depth_mm=0.8)
    assert by_name.val().isValid() and by_name.solids().size() == 1
    assert by_name.val().Volume() == pytest.approx(by_face.val().Volume())
    assert by_name.val().BoundingBox().zmax == pytest.approx(3.5, abs=1e-3)
    with pytest.raises(InputError, match="select at least one"):
        plugin.textured(plate, plate.edges(">Z"), 2)


@pytest.mark.usefixtures("registered")
def test_the_registered_method_puts_a_texture_on_every_selected_face() -> None:
    part = cq.Workplane().box(20, 20, 5).faces(">Z or <Z").texture(2, sunk=True, depth_mm=0.5)
    assert part.val().isValid()
    assert (part.val().BoundingBox().zmin, part.val().BoundingBox().zmax) == pytest.approx((-2.5, 2.5))
    assert part.val().Volume() == pytest.approx(2000.0 - 2.0 * 18.0**2 * (0.2 + 0.25), rel=0.02)
    holed = part.faces(">Z").workplane().hole(4)
    assert holed.val().isValid() and holed.val().Volume() < part.val().Volume()
