"""Meshes and solids of blocks whose outlines are not rectangles."""

import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad import Block
from tacbench_cad.checks import solidcheck
from tacbench_cad.checks.meshcheck import edges, solidity
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.brep import solid_block, texture_face
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.outlines import Polygon
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import Texture

WEAVE = Texture(name="weave", surface=plane_waves((0.6, 1.0, 0.5), (0.6, 1.0, -0.5)))
CORNER = Polygon(points_mm=((0, 0), (14, 0), (14, 6), (6, 6), (6, 14), (0, 14)))


@pytest.mark.parametrize("outline", ["disc:14", "hexagon:14", "ring:14,6", CORNER], ids=str)
@pytest.mark.parametrize("texture", [2, WEAVE], ids=["separable", "oblique"])
def test_meshes_are_closed_and_exactly_as_high_as_the_block(outline: str, texture: int | Texture) -> None:
    block = Block.of(texture, outline=outline, sampling=Tolerance(mm=0.03))
    part = block_part(block)
    mesh, expected = part.mesh
    assert edges(mesh).ok
    assert solidity(mesh) == ("NoError", part.genus)
    assert mesh.bounds_mm[1][2] == np.float32(block.height_mm)
    assert mesh.volume_mm3 == pytest.approx(expected.volume_mm3, abs=expected.volume_slack_mm3)
    assert expected.volume_mm3 == pytest.approx(block.volume_mm3(block.datum_mm), rel=0.01)
    assert block.outline is not None and expected.certificate is not None
    assert expected.certificate.distance_mm <= 0.03
    far = np.abs(block.outline.distance(*mesh.vertices[:, :2].T)[mesh.vertices[:, 2] == 0.0])
    assert far.max() < 1e-5


def test_a_file_of_a_disc_with_a_label_passes_its_checks(tmp_path) -> None:
    part = block_part(Block.of(2, outline="disc:24", label=True, sampling=Tolerance(mm=0.03)))
    for name in ("stl", "3mf"):
        path = tmp_path / f"block{FORMATS[name].suffix}"
        FORMATS[name].write(part, path)
        report = verify(part, path)
        assert report.ok, str(report)


@pytest.mark.parametrize("outline", mostly_long(["disc:14", "ring:14,6", CORNER], "ring:14,6"), ids=str)
def test_solids_have_the_volume_of_the_formula(outline: str) -> None:
    block = Block.of(2, outline=outline)
    solid, certificate = solid_block(block)
    measured = solidcheck.measure(solid)
    assert measured.volume_mm3 == pytest.approx(block.volume_mm3(block.solid_datum_mm), rel=2e-6)
    assert measured.high_mm[2] == pytest.approx(block.height_mm, abs=1e-3)
    assert certificate.vertical_mm <= 1e-3
    points = solidcheck.points_on(solidcheck.curved(solid)[0])
    heights = block.solid_datum_mm + block.surface(*points[:, :2].T)
    assert np.abs(points[:, 2] - heights).max() < 1e-3


def test_the_surface_alone_ends_at_the_outline() -> None:
    block = Block.of(2, outline="disc:14")
    low, high = kernel.box_mm(texture_face(block))
    assert (high - low)[:2] == pytest.approx([14.0, 14.0], abs=1e-3)
