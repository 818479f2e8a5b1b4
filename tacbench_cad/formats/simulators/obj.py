"""Wavefront OBJ: the closed mesh that is printed, in mm, z up. An OBJ names no unit, so readers are given a scale."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.formats.simulators.asset import SimulatorAsset, TargetFiles


def write_obj(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.obj``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    file = write_mesh(asset, folder)
    note = f"""\
- `{file}`: the closed mesh that is printed, {len(asset.mesh.faces):,} triangles, wound outwards, without normals.
- Units and axes: millimetres, z up (an OBJ names no unit: give your reader the scale 0.001 for metres).
- {mesh_error(asset)}
- Contact: most engines collide a mesh as its convex hull unless told otherwise, and lose the relief in silence.
- Tested with trimesh 5.2: a closed body, heights of the triangles against the formula; a steel ball of 0.5 mm radius,
  dropped in PyBullet on the triangles that trimesh hands out, rests within 0.05 mm of where the formula lets it
  (textures 2 and 4, scale 1).
"""
    return TargetFiles(files=(file,), note=note)


def write_mesh(asset: SimulatorAsset, folder: Path) -> str:
    """Write the mesh and give the file's name; the targets that refer to it share it."""
    mesh, file = asset.mesh, f"{asset.name}.obj"
    with (folder / file).open("w", encoding="ascii", newline="\n") as stream:
        stream.write(f"# {asset.block.name}: millimetres, z up\no {asset.name}\n")
        stream.write("".join(f"v {x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in mesh.vertices.tolist()))
        stream.write("".join(f"f {a} {b} {c}\n" for a, b, c in (mesh.faces + 1).tolist()))
    return file


def write_with_mesh(asset: SimulatorAsset, folder: Path, suffix: str, model: str, note: str) -> TargetFiles:
    """Write the mesh, and beside it a model in metres that refers to it as ``NAME.obj`` and scales it.

    Args:
        asset: The block.
        folder: An existing folder.
        suffix: Of the model's file.
        model: Its text.
        note: What to say of it after the names of the files, the units and the axes.
    """
    mesh, file = write_mesh(asset, folder), f"{asset.name}{suffix}"
    (folder / file).write_text(model, encoding="utf-8")
    about = f"""\
- `{file}` with `{mesh}` ({len(asset.mesh.faces):,} triangles), which has to lie beside it.
- Units and axes: metres, z up, block frame (the OBJ's millimetres are scaled by 0.001). """
    return TargetFiles(files=(file, mesh), note=about + note)


def mesh_error(asset: SimulatorAsset) -> str:
    """What is proved of the mesh's top, as a sentence."""
    proof = asset.mesh_certificate
    return (
        f"Error against the formula: {proof.distance_mm:.2g} mm in distance, {proof.vertical_mm:.2g} mm in height on "
        "the steepest walls (proved)."
    )
