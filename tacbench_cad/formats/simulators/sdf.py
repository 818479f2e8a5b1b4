"""SDFormat with its OBJ, for Drake: metres, z up, a rigid hydroelastic surface."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.formats.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.formats.simulators.obj import mesh_error, write_with_mesh
from tacbench_cad.formats.simulators.urdf import METRES


def _inertia_kg_m2(asset: SimulatorAsset) -> tuple[float, float, float]:
    """Moments of inertia about the centre of the block's box, taken as a massive box, in kg m^2."""
    x, y, z = ((side / 1e3) ** 2 for side in (*asset.block.size_mm, asset.block.height_mm))
    return (asset.mass_kg / 12.0 * (y + z), asset.mass_kg / 12.0 * (x + z), asset.mass_kg / 12.0 * (x + y))


def _centre_m(asset: SimulatorAsset) -> str:
    """Centre of the block's box, in m."""
    return " ".join(f"{side / 2e3:.9g}" for side in (*asset.block.size_mm, asset.block.height_mm))


def write_sdf(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.sdf`` and ``NAME.obj``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    name = asset.name
    xx, yy, zz = _inertia_kg_m2(asset)
    text = f"""\
<?xml version="1.0"?>
<!-- {asset.block.name}: metres, z up; origin at the lower corner of the underside -->
<sdf version="1.7" xmlns:drake="http://drake.mit.edu">
  <model name="{name}">
    <link name="{name}">
      <inertial>
        <pose>{_centre_m(asset)} 0 0 0</pose>
        <mass>{asset.mass_kg:.6g}</mass>
        <inertia><ixx>{xx:.6g}</ixx><iyy>{yy:.6g}</iyy><izz>{zz:.6g}</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz></inertia>
      </inertial>
      <visual name="visual">
        <geometry><mesh><uri>{name}.obj</uri><scale>{METRES}</scale></mesh></geometry>
        <material><diffuse>0.55 0.62 0.70 1</diffuse></material>
      </visual>
      <collision name="collision">
        <geometry><mesh><uri>{name}.obj</uri><scale>{METRES}</scale></mesh></geometry>
        <drake:proximity_properties>
          <drake:rigid_hydroelastic/>
          <drake:mu_static>0.5</drake:mu_static>
          <drake:mu_dynamic>0.5</drake:mu_dynamic>
        </drake:proximity_properties>
      </collision>
    </link>
  </model>
</sdf>
"""
    note = f"""\
Weld it to the world. Its mass
  is that of massive PLA, its inertia that of a box.
- {mesh_error(asset)}
- Contact: rigid hydroelastic, so give the probe a compliant surface and the plant `contact_model = "hydroelastic"`.
  With `hydroelastic_with_fallback` a probe that is rigid or has no hydroelastic properties falls back to point contact,
  which uses the convex hull.
- Suggested for balls up to 1 mm radius: step 0.001 s, the probe's `hydroelastic_modulus` 1e7 Pa and `resolution_hint` a
  quarter of its radius. Pressure grows with depth over radius, so a dome is softer: one of 20 mm radius under 2 N sinks
  into texture 2 by 0.78 mm at 1e7 Pa and by 0.10 mm at 1e9 Pa.
- Tested in Drake 1.51 with textures 2, 3, 4 and 6 at scale 1: the signed distance of points on the formula; a steel
  ball of 0.5 mm radius with those settings, dropped into a valley, rests within 0.05 mm of where the formula lets it.
"""
    return write_with_mesh(asset, folder, ".sdf", text, note)
