"""trimesh reads the OBJ file as a closed body with the heights of the formula.

trimesh does not simulate contact. PyBullet drops the ball on the triangles that trimesh reads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import NEAR_MM, Exported, places_mm, valley_mm
from helpers.triangles import heights_mm, rest_on_triangles

from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec.block import Block

trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: pip install trimesh")
pytestmark = pytest.mark.real


def body_of(number: str, exported: Exported) -> Any:
    return trimesh.load(exported(number, "obj") / f"texture-{number}.obj", force="mesh", process=False)


@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_heights(number: str, exported: Exported) -> None:
    block, body = Block.of(number), body_of(number, exported)
    assert body.is_watertight and body.is_winding_consistent
    np.testing.assert_allclose(body.bounds, [[0, 0, 0], [*block.size_mm, block.height_mm]], atol=2e-6)
    places = places_mm(block)
    top = heights_mm(body.vertices, body.faces, places)
    assert np.abs(top - block.height_at(*places.T)).max() <= SimulatorAsset(block).mesh_certificate.vertical_mm + 1e-4


@pytest.mark.parametrize("number", mostly_long("24", "2"))
def test_contact_of_a_ball(number: str, exported: Exported) -> None:
    block, body = Block.of(number), body_of(number, exported)
    x, y, z = valley_mm(block)
    position = rest_on_triangles(body.vertices, body.faces, (x + 0.05, y + 0.03, z + 0.3))
    assert position[2] == pytest.approx(z, abs=NEAR_MM)
