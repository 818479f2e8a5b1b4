"""build123d: TextureBlock in a builder, in algebra mode, aligned, rotated, cut."""

from __future__ import annotations

import build123d as bd
import pytest
from helpers.solid_reference import block_area_mm2, hole_mm3, kernel_volume_mm3

from tacbench_cad import bd as b3d
from tacbench_cad.bd import TextureBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

BLOCK = Block.of(2, key_mm=3.0)
VOLUME = BLOCK.volume_mm3(BLOCK.solid_datum_mm)


def box(shape: bd.Shape) -> tuple[float, ...]:
    bounds = shape.bounding_box()
    return (*bounds.min, *bounds.max)


def test_the_block_has_its_dimensions_and_volume() -> None:
    block = Block.of(1)
    part = TextureBlock(1, align=None)
    assert part.is_valid
    assert part.block == block
    assert part.label == "texture-1_paper_x1"
    assert part.volume == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=1e-5)
    assert part.area == pytest.approx(block_area_mm2(block), rel=1e-4)
    assert box(part) == pytest.approx((0, 0, 0, 23.3, 30, 7), abs=1e-3)


def test_build_part_with_grid_locations_and_a_hole() -> None:
    with bd.BuildPart() as builder:
        with bd.GridLocations(40, 40, 2, 2):
            TextureBlock(BLOCK)
        with bd.Locations((20, 20, 0)):
            bd.Cylinder(3, 30, mode=bd.Mode.SUBTRACT)
    x, y = BLOCK.size_mm
    assert len(builder.part.solids()) == 4
    assert builder.part.is_valid
    removed = hole_mm3(BLOCK, (x / 2, y / 2), 3.0)
    assert builder.part.volume == pytest.approx(4 * VOLUME - removed, rel=1e-5)


def test_algebra_mode() -> None:
    part = bd.Pos(0, 0, 1) * TextureBlock(BLOCK) + bd.Box(60, 60, 2)
    assert isinstance(part, bd.Part)
    assert part.is_valid
    assert part.volume == pytest.approx(60 * 60 * 2 + VOLUME, rel=1e-5)
    placed = [location * TextureBlock(BLOCK) for location in bd.GridLocations(40, 40, 2, 1)]
    assert [round(block.bounding_box().min.X, 3) for block in placed] == [-31.65, 8.35]


@pytest.mark.parametrize("number", [1, pytest.param(4, marks=pytest.mark.long)])
def test_a_hole_through_the_texture(number: int) -> None:
    part = TextureBlock(number)
    drilled = part - bd.Pos(1, 2, 0) * bd.Cylinder(3, 30)
    assert drilled.is_valid
    removed = hole_mm3(part.block, (23.3 / 2 + 1, 17.0), 3.0)
    volume = kernel_volume_mm3(drilled.wrapped)
    assert volume == pytest.approx(part.block.volume_mm3(part.block.solid_datum_mm) - removed, rel=1e-4)


@pytest.mark.parametrize(
    ("align", "expected"),
    [
        (None, (0, 0, 0, 23.3, 30, 7)),
        (bd.Align.CENTER, (-11.65, -15, -3.5, 11.65, 15, 3.5)),
        ((bd.Align.MAX, bd.Align.MIN, bd.Align.MAX), (-23.3, 0, -7, 0, 30, 0)),
    ],
)
def test_align(align: object, expected: tuple[float, ...]) -> None:
    assert box(TextureBlock(BLOCK, align=align)) == pytest.approx(expected, abs=1e-3)


def test_the_rotation_is_applied_after_the_alignment() -> None:
    assert box(TextureBlock(BLOCK, rotation=(0, 0, 90))) == pytest.approx((-15, -11.65, 0, 15, 11.65, 7), abs=1e-3)


def test_private_mode_does_not_change_the_builder() -> None:
    with bd.BuildPart() as builder:
        bd.Box(1, 1, 1)
        TextureBlock(BLOCK, mode=bd.Mode.PRIVATE)
    assert builder.part.volume == pytest.approx(1.0)


def test_bad_arguments_are_refused() -> None:
    with pytest.raises(InputError, match="is a block"):
        TextureBlock(BLOCK, scale=2.0)
    with pytest.raises(InputError, match="millions of poles"):
        TextureBlock(4, "released")


def test_texture_face() -> None:
    face = b3d.texture_face(Block.of(2))
    assert isinstance(face, bd.Face)
    assert face.is_valid
    assert face.area == pytest.approx(872.517, rel=1e-4)


def test_a_texture_on_a_face_in_algebra_mode() -> None:
    plain = bd.Box(20, 20, 5)
    part = b3d.textured(plain, plain.faces().sort_by(bd.Axis.Z)[-1], 2, depth_mm=0.8)
    assert isinstance(part, bd.Part) and part.is_valid and len(part.solids()) == 1
    assert box(part)[5] == pytest.approx(3.5, abs=1e-3)
    with pytest.raises(InputError, match="select at least one"):
        b3d.textured(plain, [], 2)
    with pytest.raises(InputError, match="is missing"):
        b3d.textured(None, plain.faces()[0], 2)


def test_a_texture_on_a_face_in_a_builder() -> None:
    with bd.BuildPart() as builder:
        bd.Box(20, 20, 5)
        top = builder.faces().sort_by(bd.Axis.Z)[-1]
        alone = b3d.textured(None, top, 2, mode=bd.Mode.PRIVATE)
        assert builder.part.volume == pytest.approx(2000.0)
        b3d.textured(None, top, 2)
        assert builder.part.volume == pytest.approx(alone.volume)
        bd.Cylinder(3, 20, mode=bd.Mode.SUBTRACT)
    assert builder.part.is_valid and builder.part.volume < alone.volume
