"""URDF with its OBJ, for PyBullet: metres, with z up. ``concave`` keeps the triangles for collisions.

The mass is 0, so that PyBullet does not move the block. The file also gives no centre of mass other than the origin:
otherwise PyBullet's rays miss three quarters of the block.
"""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.extensions.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.extensions.simulators.obj import mesh_error, write_with_mesh

#: The scale from the OBJ's millimetres to metres.
METRES = "0.001 0.001 0.001"


def write_urdf(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.urdf`` and ``NAME.obj``.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    name = asset.name
    text = f"""\
<?xml version="1.0"?>
<!-- {asset.block.name}: metres, z up; origin at the lower corner of the underside -->
<robot name="{name}">
  <link name="{name}">
    <contact>
      <lateral_friction value="0.5"/>
      <rolling_friction value="0"/>
    </contact>
    <inertial>
      <mass value="0"/>
      <inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/>
    </inertial>
    <visual>
      <geometry><mesh filename="{name}.obj" scale="{METRES}"/></geometry>
      <material name="{name}"><color rgba="0.55 0.62 0.70 1"/></material>
    </visual>
    <collision concave="yes">
      <geometry><mesh filename="{name}.obj" scale="{METRES}"/></geometry>
    </collision>
  </link>
</robot>
"""
    note = f"""\
The mass is 0,
  so the block does not move.
- {mesh_error(asset)}
- Call `setPhysicsEngineParameter(enableFileCaching=0)` before `loadURDF`. Otherwise PyBullet takes an old mesh of the
  same name from its cache. `concave="yes"` on `<collision>` keeps the relief; on `<link>` it has no effect.
- Contact settings: use `setTimeStep(1/2000)` or a smaller step, and give the probe `restitution=0` and some
  `linearDamping`. The file sets the friction to 0.5.
- Suitable probes: balls of 0.5 mm and 1 mm radius, tested on meshes with a tolerance of 0.01 mm. PyBullet keeps four
  contacts for each pair of bodies, so larger probes sink in. In texture 4, a ball of 5 mm radius sank in by 0.1 mm, and
  a ball of 12 mm radius by 0.4 mm. In texture 2, a dome of 20 mm radius under 2 N sank in by 0.28 mm. Use MuJoCo for
  domes.
- Tested in PyBullet 3.2.7 at scale 1. Heights measured by rays agree with the formula (the six textures of the paper).
  A steel ball dropped into a valley comes to rest within 0.05 mm of the height that the formula predicts: with 0.5 mm
  radius on the six textures of the paper, and with 1 mm radius on textures 2 and 4.
"""
    return write_with_mesh(asset, folder, ".urdf", text, note)
