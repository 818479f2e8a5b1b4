"""Solids: comparison with the formula, checks by the kernel, and errors."""

from __future__ import annotations

import cadquery as cq
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.solid_reference import block_area_mm2, faces, points_of_top, random_block, top_area_mm2
from OCP.Bnd import Bnd_Box
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepGProp import BRepGProp
from OCP.BRepMesh import BRepMesh_IncrementalMesh
from OCP.GProp import GProp_GProps
from OCP.TopAbs import TopAbs_ShapeEnum
from OCP.TopExp import TopExp
from OCP.TopoDS import TopoDS_Shape
from OCP.TopTools import TopTools_IndexedDataMapOfShapeListOfShape

from tacbench_cad.geometry.brep import solid_block, solid_refusal, texture_face
from tacbench_cad.geometry.splines.patches import MAX_POLES, patches
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

OBLIQUE = Texture(
    name="oblique",
    equation="two oblique waves and one along y",
    surface=WaveSum(
        (
            Wave(amplitude=0.5, f=3.0, g=2.0),
            Wave(amplitude=0.6, f=-1.0, g=4.0, phase=1.0),
            Wave(amplitude=0.2, f=0.0, g=6.0, phase=0.4),
        )
    ),
)
BLOCKS = {
    **{f"{k}-paper": Block.of(k) for k in range(1, 7)},
    **{f"{k}-released": Block.of(k, "released") for k in (1, 2, 3, 5)},
    "4-half": Block.of(4, scale=0.5),
    "4-small": Block.of(4, size_mm=(9.0, 11.0)),
    "6-triple": Block.of(6, scale=3.0),
    "2-other-domain": Block.of(2, size_mm=(41.0, 17.0), mm_per_unit=(1.1, 0.6, 0.9)),
    "oblique": Block.of(OBLIQUE),
}
#: The blocks of the quick run. The kernel needs 1 to 8 s to integrate over some of the others.
QUICK = ("1-paper", "2-released", "4-small", "2-other-domain", "oblique")
FEATURES = {
    "2-key": Block.of(2, key_mm=3.0),
    "5-key": Block.of(5, key_mm=2.5),
    "4-key-label": Block.of(4, key_mm=3.0, label=True),
    "1-label": Block.of(1, copy=12),
    "oblique-key-label": Block.of(OBLIQUE, key_mm=3.0, label=True, height_mm=8.0),
    "2-key-large": Block.of(2, size_mm=(20.0, 60.0), key_mm=6.6),
}


def volume_mm3(shape: TopoDS_Shape) -> float:
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    return float(properties.Mass())


def area_mm2(shape: TopoDS_Shape) -> float:
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(shape, properties)
    return float(properties.Mass())


def box_mm(shape: TopoDS_Shape) -> np.ndarray:
    box = Bnd_Box()
    BRepBndLib.AddOptimal_s(shape, box)
    return np.array(box.Get())


def require_closed(shape: TopoDS_Shape) -> None:
    """Check that a solid is valid and not inside out, and that each edge belongs to two faces, in both directions."""
    assert BRepCheck_Analyzer(shape).IsValid()
    owners = TopTools_IndexedDataMapOfShapeListOfShape()
    TopExp.MapShapesAndAncestors_s(shape, TopAbs_ShapeEnum.TopAbs_EDGE, TopAbs_ShapeEnum.TopAbs_FACE, owners)
    assert {owners.FindFromIndex(i).Size() for i in range(1, owners.Extent() + 1)} == {2}


@pytest.mark.parametrize("name", mostly_long(BLOCKS, *QUICK))
def test_solid_follows_the_formula_and_has_its_volume_area_and_box(name: str) -> None:
    block = BLOCKS[name]
    solid, certificate = solid_block(block)
    require_closed(solid)
    x, y, z = points_of_top(solid, 9).T
    off = np.abs(z - block.solid_datum_mm - block.surface(x, y)).max()
    assert 0.0 < off <= certificate.vertical_mm <= 0.001
    assert certificate.distance_mm <= certificate.vertical_mm
    assert (x.min(), x.max(), y.min(), y.max()) == pytest.approx((0, block.size_mm[0], 0, block.size_mm[1]), abs=1e-12)
    assert volume_mm3(solid) == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=1e-5)
    # The ripple within the tolerance makes the area of the smallest block 6e-5 larger. The rest is the kernel's error.
    assert area_mm2(solid) == pytest.approx(block_area_mm2(block), rel=1.2e-4)
    top = block.height_mm + block.solid_datum_mm - block.formula_datum_mm
    assert box_mm(solid) == pytest.approx([0, 0, 0, *block.size_mm, top], abs=1e-3)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.long if name in ("4-key-label", "5-key") else ()) for name in FEATURES],
)
def test_key_and_label(name: str) -> None:
    block = FEATURES[name]
    solid, certificate = solid_block(block)
    require_closed(solid)
    volume = volume_mm3(solid)
    assert volume == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=1e-5)
    assert box_mm(solid) == pytest.approx([0, 0, 0, *block.size_mm, block.height_mm], abs=1e-3)
    x, y, z = points_of_top(solid, 5).T
    assert np.abs(z - block.solid_datum_mm - block.surface(x, y)).max() <= certificate.vertical_mm
    plain = solid_block(Block.of(block.texture, size_mm=block.size_mm, height_mm=block.height_mm))[0]
    assert volume_mm3(plain) - volume > 1.0, "nothing was taken off"


def test_the_key_is_where_it_should_be() -> None:
    block = Block.of(2, key_mm=3.0)
    solid = cq.Solid(solid_block(block)[0])
    x, _ = block.size_mm
    assert not solid.isInside(cq.Vector(x - 1.4, 1.4, 2.0))
    assert solid.isInside(cq.Vector(x - 1.6, 1.6, 2.0))
    for corner in ((0.1, 0.1), (0.1, 29.9), (x - 0.1, 29.9)):
        assert solid.isInside(cq.Vector(*corner, 2.0))


def test_the_label_is_cut_from_below() -> None:
    block = Block.of(2, label=True)
    assert block.engraving is not None
    solid = cq.Solid(solid_block(block)[0])
    depths = sorted({round(face.Center().z, 6) for face in solid.Faces() if abs(face.normalAt().z + 1.0) < 1e-9})
    assert depths == pytest.approx([0.0, 0.4], abs=1e-9)
    ceilings = [face.Area() for face in solid.Faces() if abs(face.Center().z - 0.4) < 1e-9 and face.normalAt().z < -0.9]
    assert sum(ceilings) == pytest.approx(block.engraving.area_mm2, rel=1e-9)


def test_neighbouring_patches_join_smoothly() -> None:
    block = Block.of(4)
    relief = patches(block, 0.001)
    x = np.repeat(relief.x.lines[1:-1], 50)
    y = np.tile(np.linspace(0.01, block.size_mm[1] - 0.01, 50), len(relief.x.lines) - 2)
    step = 1e-7
    middle = relief(x, y)
    left, right = (middle - relief(x - step, y)) / step, (relief(x + step, y) - middle) / step
    assert np.abs(left - right).max() < 1e-3


@pytest.mark.parametrize("name", mostly_long(["1-paper", "4-small", "4-paper", "oblique"], "1-paper"))
def test_texture_face_is_the_top(name: str) -> None:
    block = BLOCKS[name]
    face = texture_face(block)
    assert BRepCheck_Analyzer(face).IsValid()
    assert len(list(faces(face))) == 1
    x, y, z = points_of_top(face, 70).T
    assert np.abs(z - block.solid_datum_mm - block.surface(x, y)).max() <= 0.001
    low, high = block.extremes.low + block.solid_datum_mm, block.extremes.high + block.solid_datum_mm
    assert box_mm(face) == pytest.approx([0, 0, low, *block.size_mm, high], abs=1e-3)
    properties = GProp_GProps()
    BRepGProp.SurfaceProperties_s(face, properties, 1e-3)
    assert properties.Mass() == pytest.approx(top_area_mm2(block, 400), rel=2e-4)


@pytest.mark.parametrize("count", [4, pytest.param(60, marks=pytest.mark.long)])
def test_solids_of_random_textures(count: int) -> None:
    rng = np.random.default_rng(5)
    for number in range(count):
        block = random_block(rng, oblique=number % 2 == 0)
        solid, certificate = solid_block(block)
        require_closed(solid)
        x, y, z = points_of_top(solid, 4).T
        assert np.abs(z - block.solid_datum_mm - block.surface(x, y)).max() <= certificate.vertical_mm
        assert volume_mm3(solid) == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=1e-4), f"texture {number}"


def test_moving_does_not_change_the_next_solid() -> None:
    block = Block.of(1)
    first = cq.Solid(solid_block(block)[0])
    first.move(cq.Location((100.0, 0.0, 0.0)))
    second = cq.Solid(solid_block(block)[0])
    assert second.BoundingBox().xmin == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("number", [4, 6])
def test_released_square_textures_have_no_solid(number: int) -> None:
    block = Block.of(number, "released")
    reason = solid_refusal(block)
    assert reason is not None
    assert f"texture-{number}_released_x1" in reason
    for make in (solid_block, texture_face):
        with pytest.raises(InputError, match="millions of poles"):
            make(block)


def test_released_6_has_a_solid_within_a_tolerance() -> None:
    block = Block.of(6, "released", sampling=Tolerance())
    assert solid_refusal(block) is None
    assert patches(block, 0.001).pole_count < 50_000


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 1e-7, float("nan"), float("inf")])
def test_tolerances_that_are_refused(tolerance: float) -> None:
    with pytest.raises(InputError, match=r"step.tolerance"):
        solid_block(Block.of(1, step_tolerance_mm=tolerance))


def test_too_many_poles_names_a_sufficient_tolerance() -> None:
    block = Block.of(4, size_mm=(150.0, 150.0))
    with pytest.raises(InputError, match=r"4 million is the maximum; use --step-tolerance \S+") as refusal:
        patches(block, 0.0005)
    proposed = float(refusal.value.allowed.split("--step-tolerance ")[1].split()[0])
    assert patches(block, proposed).pole_count <= MAX_POLES


@pytest.mark.parametrize("name", ["2-paper", pytest.param("4-paper", marks=pytest.mark.long)])
def test_the_kernels_mesher_gets_through(name: str) -> None:
    """The nodes of the kernel's mesh lie on the top. Texture 4 needs 20 to 40 s and less than 1 GB."""
    solid, _ = solid_block(BLOCKS[name])
    mesher = BRepMesh_IncrementalMesh(solid, 0.01, False, 0.5, False)
    assert mesher.IsDone()
    assert mesher.GetStatusFlags() == 0
