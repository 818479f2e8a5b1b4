"""OpenUSD as text (``.usda``): one mesh in metres, with z up, without subdivision. Collisions use its triangles."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.extensions.simulators.obj import mesh_error


def write_usd(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.usda``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    mesh, file = asset.mesh, f"{asset.name}.usda"
    prim = asset.name.replace("-", "_")
    prim = (
        prim if prim[0].isalpha() else f"_{prim}"
    )  # the name of a prim has no hyphens and does not begin with a digit
    points = ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in (mesh.vertices / 1e3).tolist())
    low, high = (", ".join(f"{value / 1e3:.9g}" for value in corner) for corner in mesh.bounds_mm)
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
- `{file}`: one mesh with {len(asset.mesh.faces):,} triangles, as text. Reference its default prim.
- Units and axes: metres (`metersPerUnit = 1`), z up (`upAxis = "Z"`), block frame. The block is not a rigid body, so it
  does not move.
- {mesh_error(asset)}
- `subdivisionScheme = "none"` is set, because subdivision would smooth the relief away.
- `physics:approximation = "none"` is set, so the triangles are used for collisions. Do not change it: a convex hull has
  no relief. This setting is allowed only for bodies that do not move.
- Contact settings: the file sets the friction to 0.5 and the restitution to 0. For probes of about 1 mm, a step of
  0.0005 s or less and a contact offset much smaller than the relief are suggested, but not tested.
- Tested with usd-core 26.11: the validators of OpenUSD report no errors (texture 2), and the heights of the triangles
  agree with the formula. The triangles that usd-core reads were also tested in PyBullet: a steel ball of 0.5 mm radius,
  dropped into a valley, comes to rest within 0.05 mm of the height that the formula predicts (textures 2 and 4,
  scale 1). No engine that reads USD files was run.
"""
    return TargetFiles(files=(file,), note=note)
