"""URDF with its OBJ, for PyBullet: metres, z up, collision with the triangles (``concave``) and not with their hull.

The block has no mass, so that PyBullet holds it still, and above all no centre of mass beside the origin: with one,
PyBullet's rays miss three quarters of the block.
"""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.formats.simulators.asset import SimulatorAsset, TargetFiles
from tacbench_cad.formats.simulators.obj import mesh_error, write_with_mesh

#: From the OBJ's millimetres to metres.
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
Mass 0: it stands still.
- {mesh_error(asset)}
- Load it with `setPhysicsEngineParameter(enableFileCaching=0)` before `loadURDF`: else a mesh that changed under its
  name is taken from the cache. `concave="yes"` on `<collision>` keeps the relief; on `<link>` it has no effect.
- Contact settings: `setTimeStep(1/2000)` or finer, on the probe `restitution=0` and some `linearDamping`; friction 0.5
  is in the file.
- Probes that hold: balls of 0.5 and of 1 mm radius, on this very mesh (tolerance 0.01 mm). PyBullet keeps four contacts
  a pair: a ball of 5 mm radius sank by 0.1 mm into texture 4, one of 12 mm by 0.4 mm, a dome of 20 mm radius under 2 N
  by 0.28 mm into texture 2. Press domes in MuJoCo.
- Tested in PyBullet 3.2.7 with the paper's six at scale 1: rays against the formula; a steel ball of 0.5 mm radius
  dropped into a valley rests within 0.05 mm of where the formula lets it (1 mm radius: textures 2 and 4).
"""
    return write_with_mesh(asset, folder, ".urdf", text, note)
