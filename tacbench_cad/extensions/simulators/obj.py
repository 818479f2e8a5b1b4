"""Wavefront OBJ: the closed mesh for printing, in mm, with z up. An OBJ file names no unit."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.util.text import at_most


def write_obj(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.obj``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    file = write_mesh(asset, folder)
    note = f"""\
- `{file}`: the closed mesh for printing, with {len(asset.mesh.faces):,} triangles. The corners of each triangle are in
  counter-clockwise order seen from outside. The file has no normals.
- Units and axes: millimetres, z up. An OBJ file names no unit: if your program uses metres, set the scale to 0.001.
- {mesh_error(asset)}
- Contact: by default, most engines replace a mesh by its convex hull, which has no relief, and show no message. Set
  your engine to use the triangles for collisions.
- Tested with trimesh 5.2: the mesh is closed, and the heights of the triangles agree with the formula. The triangles
  that trimesh reads were also tested in PyBullet: a steel ball of 0.5 mm radius, dropped into a valley, comes to rest
  within 0.05 mm of the height that the formula predicts (textures 2 and 4, scale 1).
"""
    return TargetFiles(files=(file,), note=note)


def write_mesh(asset: SimulatorAsset, folder: Path) -> str:
    """Write the mesh and return the name of its file. Targets that refer to the mesh share this file."""
    mesh, file = asset.mesh, f"{asset.name}.obj"
    with (folder / file).open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"# {asset.block.name}: millimetres, z up\no {asset.name}\n")
        stream.write("".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices.tolist()))
        stream.write("".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist()))
    return file


def write_with_mesh(asset: SimulatorAsset, folder: Path, suffix: str, model: str, note: str) -> TargetFiles:
    """Write the mesh and a model in metres, which refers to the mesh as ``NAME.obj`` and scales it.

    Args:
        asset: The block.
        folder: An existing folder.
        suffix: The suffix of the model's file.
        model: The text of the model's file.
        note: The rest of the note, after the names of the files, the units and the axes.
    """
    mesh, file = write_mesh(asset, folder), f"{asset.name}{suffix}"
    (folder / file).write_text(model, encoding="utf-8")
    about = f"""\
- `{file}` with the mesh `{mesh}` ({len(asset.mesh.faces):,} triangles). Keep both files in the same folder.
- Units and axes: metres, z up, block frame (the OBJ's millimetres are scaled by 0.001). """
    return TargetFiles(files=(file, mesh), note=about + note)


def mesh_error(asset: SimulatorAsset) -> str:
    """Return a sentence about the proved error of the mesh."""
    proof = asset.mesh_certificate
    return (
        f"Error against the formula: at most {at_most(proof.distance_mm, 2)} mm in distance, "
        f"{at_most(proof.vertical_mm, 2)} mm in height on the steepest walls ({proof.evidence})."
    )
