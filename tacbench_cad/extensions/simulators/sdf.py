"""SDFormat with its OBJ, for Drake: metres, with z up, and a rigid hydroelastic surface."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.extensions.simulators.obj import mesh_error, write_with_mesh
from tacbench_cad.extensions.simulators.urdf import METRES


def write_sdf(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.sdf`` and ``NAME.obj``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    name = asset.name
    sides_m = [side / 1e3 for side in (*asset.block.size_mm, asset.block.height_mm)]
    centre = " ".join(f"{side / 2.0:.9g}" for side in sides_m)
    # The moments of inertia of a massive box with the size of the block, about its centre.
    x, y, z = (asset.mass_kg / 12.0 * side**2 for side in sides_m)
    xx, yy, zz = y + z, x + z, x + y
    text = f"""\
<?xml version="1.0"?>
<!-- {asset.block.name}: metres, z up; origin at the lower corner of the underside -->
<sdf version="1.7" xmlns:drake="http://drake.mit.edu">
  <model name="{name}">
    <link name="{name}">
      <inertial>
        <pose>{centre} 0 0 0</pose>
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
Weld the block
  to the world. Its mass is the mass of solid PLA, and its inertia is the inertia of a box.
- {mesh_error(asset)}
- Contact: the block is rigid hydroelastic. The probe therefore needs a compliant hydroelastic surface, and the plant
  needs `contact_model = "hydroelastic"`. With `hydroelastic_with_fallback`, Drake uses point contact for a probe that
  is rigid or has no hydroelastic properties, and point contact uses the convex hull.
- Suggested for balls up to 1 mm radius: a step of 0.001 s, a `hydroelastic_modulus` of the probe of 1e7 Pa, and a
  `resolution_hint` of a quarter of its radius. The pressure grows with depth divided by radius, so a dome is softer: a
  dome of 20 mm radius under 2 N sinks into texture 2 by 0.78 mm at 1e7 Pa and by 0.10 mm at 1e9 Pa.
- Tested in Drake 1.51 with textures 2, 3, 4 and 6 at scale 1. The signed distances of points on the formula are
  correct. With the suggested settings, a steel ball of 0.5 mm radius, dropped into a valley, comes to rest within
  0.05 mm of the height that the formula predicts.
"""
    return write_with_mesh(asset, folder, ".sdf", text, note)
