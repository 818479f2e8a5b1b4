"""trimesh reads the OBJ file as a closed body with the heights of the formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import Exported, places_mm
from helpers.triangles import heights_mm

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
