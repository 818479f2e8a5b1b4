"""glTF: pygltflib and trimesh read the heights of the formula from the file, in metres with y up.

Neither library simulates contact. PyBullet drops the ball on the triangles that pygltflib reads.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import Exported, places_mm
from helpers.triangles import heights_mm

from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec.block import Block

pygltflib = pytest.importorskip("pygltflib", reason="pygltflib is not installed: pip install pygltflib")
pytestmark = pytest.mark.real


def mesh_of(number: str, exported: Exported) -> tuple[np.ndarray, np.ndarray]:
    """Return the points in mm with z up, and the triangles, read by the accessors of the file."""
    document = pygltflib.GLTF2().load(str(exported(number, "glb") / f"texture-{number}.glb"))
    (mesh,) = document.meshes
    (primitive,) = mesh.primitives
    assert primitive.mode in (None, pygltflib.TRIANGLES)
    arrays = []
    for index, kind, width in ((primitive.attributes.POSITION, "<f4", 3), (primitive.indices, "<u4", 1)):
        accessor = document.accessors[index]
        view = document.bufferViews[accessor.bufferView]
        data = np.frombuffer(document.binary_blob(), dtype=kind, count=accessor.count * width, offset=view.byteOffset)
        assert view.byteLength == data.nbytes
        arrays.append(data.reshape(-1, 3))
    points, triangles = arrays
    low, high = (document.accessors[primitive.attributes.POSITION].min, document.accessors[0].max)
    np.testing.assert_array_equal(points.min(axis=0), np.float32(low))
    np.testing.assert_array_equal(points.max(axis=0), np.float32(high))
    x, y, z = 1e3 * points.astype(np.float64).T
    return np.column_stack([x, -z, y]), triangles.astype(np.int64)


@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_heights(number: str, exported: Exported) -> None:
    block = Block.of(number)
    places = places_mm(block)
    top = heights_mm(*mesh_of(number, exported), places)
    assert np.abs(top - block.height_at(*places.T)).max() <= SimulatorAsset(block).mesh_certificate.vertical_mm + 1e-4


def test_trimesh_reads_the_same_closed_body(exported: Exported) -> None:
    trimesh = pytest.importorskip("trimesh", reason="trimesh is not installed: pip install trimesh")
    block = Block.of("4")
    body = trimesh.load(exported("4", "glb") / "texture-4.glb", force="mesh")
    assert body.is_watertight and body.is_winding_consistent
    x, y = block.size_mm
    np.testing.assert_allclose(body.extents, [x / 1e3, block.height_mm / 1e3, y / 1e3], rtol=1e-6)
    assert body.volume * 1e9 == pytest.approx(block.volume_mm3(block.datum_mm), rel=1e-3)
