"""OpenUSD as text (``.usda``): one mesh in metres, z up, not subdivided, colliding with its triangles."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.formats.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.formats.simulators.obj import mesh_error


def write_usd(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.usda``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    mesh, file = asset.mesh, f"{asset.name}.usda"
    prim = asset.name.replace("-", "_")
    prim = prim if prim[0].isalpha() else f"_{prim}"  # a prim's name may hold no hyphen and begin with no digit
    points = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in (mesh.vertices / 1e3).tolist())
    low, high = (", ".join(f"{value / 1e3:.9g}" for value in one) for one in mesh.bounds_mm)
    text = f"""\
#usda 1.0
(
    defaultPrim = "{prim}"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
    doc = "{asset.block.name}: origin at the lower corner of the underside"
)

def Xform "{prim}" (
    kind = "component"
)
{{
    def Mesh "block" (
        prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI", "MaterialBindingAPI"]
    )
    {{
        uniform token physics:approximation = "none"
        rel material:binding:physics = </{prim}/material>
        uniform token subdivisionScheme = "none"
        uniform token orientation = "rightHanded"
        uniform bool doubleSided = 0
        float3[] extent = [({low}), ({high})]
        color3f[] primvars:displayColor = [(0.26, 0.34, 0.45)]
        int[] faceVertexCounts = [{", ".join(["3"] * len(mesh.faces))}]
        int[] faceVertexIndices = [{", ".join(map(str, mesh.faces.ravel().tolist()))}]
        point3f[] points = [{points}]
    }}

    def Material "material" (
        prepend apiSchemas = ["PhysicsMaterialAPI"]
    )
    {{
        float physics:staticFriction = 0.5
        float physics:dynamicFriction = 0.5
        float physics:restitution = 0
    }}
}}
"""
    (folder / file).write_text(text, encoding="utf-8")
    note = f"""\
- `{file}`: one mesh, {len(asset.mesh.faces):,} triangles, as text; reference it by its default prim.
- Units and axes: metres (`metersPerUnit = 1`), z up (`upAxis = "Z"`), block frame. No rigid body: it stands still.
- {mesh_error(asset)}
- `subdivisionScheme = "none"`: else a viewer smooths the relief away. Collision with the triangles themselves
  (`physics:approximation = "none"`); leave it so: a convex hull has no relief. Only a still body may collide like that.
- Contact settings: friction 0.5 and restitution 0 are in the file. Suggested, not tested here: a step of 0.0005 s or
  finer for probes of about 1 mm, and a contact offset far below the relief.
- Tested with usd-core 26.11: OpenUSD's own validators find nothing (texture 2); heights of the triangles against
  the formula; a steel ball of 0.5 mm radius, dropped in PyBullet on the triangles that usd-core hands out, rests
  within 0.05 mm of where the formula lets it (textures 2 and 4, scale 1). No engine that reads USD itself was run.
"""
    return TargetFiles(files=(file,), note=note)
