"""Press a dome of 20 mm radius, similar to a TacTip, on texture 2 in MuJoCo with 2 N.

The script loads the exported file, adds the dome and lets it fall from above the middle of the block. It prints
``sunk_mm``, the depth of the dome's lowest point below the block's highest point. Install MuJoCo first:
``pip install mujoco``.
"""

from pathlib import Path

import mujoco

from tacbench_cad import Block
from tacbench_cad.extensions.simulators import export_to_simulators

RADIUS_MM, FORCE_N = 20.0, 2.0

block = Block.of(2)
(written,) = export_to_simulators([block], ["mjcf"], Path("sim"))

# MuJoCo keeps at most 50 contacts for each pair of geoms, so a wide dome needs a height field in several tiles.
spec = mujoco.MjSpec.from_file(str(written.folder / "texture-2-tiles.xml"))
mass = FORCE_N / 9.81
x, y = (side / 2.0 for side in block.size_mm)
start_mm = (x, y, block.height_mm + RADIUS_MM)
dome = spec.worldbody.add_body(name="dome", pos=[length_mm / 1e3 for length_mm in start_mm])
dome.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[RADIUS_MM / 1e3, 0, 0], mass=mass)
dome.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], damping=10.0 * mass)

model = spec.compile()
data = mujoco.MjData(model)
while data.time < 1.0:
    mujoco.mj_step(model, data)

sunk_mm = start_mm[2] - 1e3 * float(data.body("dome").xpos[2])
print(f"the dome's summit lies {sunk_mm:.3f} mm below the highest point, {data.ncon} contacts")
