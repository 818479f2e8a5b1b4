"""Measure how deep a probe sinks into exported textures in each physics engine.

    python benchmarks/contact_in_engines.py [--textures 24]

The notes in the exported folders quote these figures. Each row is a ball, or a dome that is pressed with 2 N and can
move up and down only. It is dropped from 0.3 mm above the lowest valley (a ball) or above the block's centre (a dome).

* ``low``: how far its centre is finally below the computed height of rest at the start, in mm;
* ``sinks``: how far its centre is below the computed height of contact at its final position, in mm. On the walls of
  a square wave, a sideways motion changes this value by the slope of the wall.

An engine that is not installed is left out and named.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.extensions.simulators.folder import export_to_simulators
from tacbench_cad.spec.block import Block

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.resting import centre_height_mm, settled_mm, steel_kg, valley_mm

DOME_MM, DOME_N, GRAVITY = 20.0, 2.0, 9.81
DEFAULTS = 'solref="0.02 1" solimp="0.9 0.95 0.001" priority="1"'
Place = tuple[float, float, float]


def start_mm(block: Block, radius_mm: float) -> Place:
    """Return the computed position of rest: above the block's centre for a dome, in the lowest valley for a ball."""
    if radius_mm >= DOME_MM:
        x, y = (side / 2.0 for side in block.size_mm)
        return (x, y, centre_height_mm(block, x, y, radius_mm, 1201))
    return settled_mm(block, *valley_mm(block)[:2], radius_mm)


def mass_kg(radius_mm: float) -> float:
    return DOME_N / GRAVITY if radius_mm >= DOME_MM else steel_kg(radius_mm)


def mujoco(path: Path, start: Place, radius_mm: float, seconds: float) -> np.ndarray:
    import mujoco as engine

    spec = engine.MjSpec.from_file(str(path))
    mass, (x, y, z) = mass_kg(radius_mm), start
    body = spec.worldbody.add_body(name="probe", pos=[x / 1e3, y / 1e3, (z + 0.3) / 1e3])
    body.add_geom(type=engine.mjtGeom.mjGEOM_SPHERE, size=[radius_mm / 1e3, 0, 0], mass=mass)
    for axis in np.eye(3)[2 if radius_mm >= DOME_MM else 0 :]:
        body.add_joint(type=engine.mjtJoint.mjJNT_SLIDE, axis=axis, damping=10.0 * mass)
    model = spec.compile()
    data = engine.MjData(model)
    for _ in range(round(seconds / model.opt.timestep)):
        engine.mj_step(model, data)
    return np.asarray(data.body("probe").xpos) * 1e3


def pybullet(path: Path, start: Place, radius_mm: float, seconds: float, step: float = 1.0 / 2000.0) -> np.ndarray:
    import pybullet as engine

    client = engine.connect(engine.DIRECT)
    engine.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    engine.setTimeStep(step, physicsClientId=client)
    engine.setGravity(0, 0, -GRAVITY, physicsClientId=client)
    engine.loadURDF(str(path), physicsClientId=client)
    shape = engine.createCollisionShape(engine.GEOM_SPHERE, radius=radius_mm / 1e3, physicsClientId=client)
    place = [start[0] / 1e3, start[1] / 1e3, (start[2] + 0.3) / 1e3]
    probe = engine.createMultiBody(mass_kg(radius_mm), shape, basePosition=place, physicsClientId=client)
    engine.changeDynamics(
        probe, -1, linearDamping=5, angularDamping=5, restitution=0, lateralFriction=0.5, physicsClientId=client
    )
    for _ in range(round(seconds / step)):
        if radius_mm >= DOME_MM:  # it may move up and down only
            (_, _, z), turn = engine.getBasePositionAndOrientation(probe, physicsClientId=client)
            (_, _, speed), _ = engine.getBaseVelocity(probe, physicsClientId=client)
            engine.resetBasePositionAndOrientation(probe, [*place[:2], z], turn, physicsClientId=client)
            engine.resetBaseVelocity(probe, [0, 0, speed], [0, 0, 0], physicsClientId=client)
        engine.stepSimulation(physicsClientId=client)
    position = engine.getBasePositionAndOrientation(probe, physicsClientId=client)[0]
    engine.disconnect(client)
    return np.array(position) * 1e3


def drake(path: Path, start: Place, radius_mm: float, seconds: float, modulus_pa: float = 1e7) -> np.ndarray:
    from pydrake import geometry, math
    from pydrake.multibody import parsing, plant, tree
    from pydrake.systems import analysis, framework

    builder = framework.DiagramBuilder()
    config = plant.MultibodyPlantConfig(time_step=1e-3, contact_model="hydroelastic")
    world, _ = plant.AddMultibodyPlant(config, builder)
    (model,) = parsing.Parser(world).AddModels(str(path))
    world.WeldFrames(world.world_frame(), world.GetFrameByName(path.stem, model))
    radius, place = radius_mm / 1e3, np.array([start[0], start[1], start[2] + 0.3]) / 1e3
    inertia = tree.SpatialInertia(mass_kg(radius_mm), np.zeros(3), tree.UnitInertia.SolidSphere(radius))
    body = world.AddRigidBody("probe", tree.default_model_instance(), inertia)
    surface = geometry.ProximityProperties()
    geometry.AddCompliantHydroelasticProperties(min(radius / 4.0, 1e-3), modulus_pa, surface)
    friction = plant.CoulombFriction(0.5, 0.5)
    geometry.AddContactMaterial(dissipation=10.0, friction=friction, properties=surface)
    world.RegisterCollisionGeometry(body, math.RigidTransform(), geometry.Sphere(radius), "probe", surface)
    dome = radius_mm >= DOME_MM
    if dome:
        offset = tree.FixedOffsetFrame("above", world.world_frame(), math.RigidTransform(place))
        above = world.AddFrame(offset)
        world.AddJoint(tree.PrismaticJoint("up", above, body.body_frame(), [0, 0, 1]))
    world.Finalize()
    simulator = analysis.Simulator(builder.Build())
    context = world.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    if not dome:
        world.SetFreeBodyPose(context, body, math.RigidTransform(place))
    simulator.AdvanceTo(seconds)
    return np.asarray(world.EvalBodyPoseInWorld(context, body).translation()) * 1e3


def row(engine: str, case: str, block: Block, radius_mm: float, seconds: float, run: Callable[..., Any]) -> None:
    """Run one probe and print its line."""
    begin = time.perf_counter()
    rest = start_mm(block, radius_mm)
    x, y, z = run(rest, radius_mm, seconds)
    free = centre_height_mm(block, x, y, radius_mm, 1201 if radius_mm > 2.0 else 201)
    seconds_taken = time.perf_counter() - begin
    print(
        f"{engine:<10}{block.texture.name:<11}{case:<30}{radius_mm:>8g}{seconds:>8g}{rest[2] - z:>10.3f}"
        f"{free - z:>10.3f}{seconds_taken:>9.1f}",
        flush=True,
    )


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--textures", default="24", help="numbers of the paper's textures (default 24)")
    numbers = parser.parse_args().textures
    print(f"{'engine':<10}{'texture':<11}{'what':<30}{'R (mm)':>8}{'t (s)':>8}{'low':>10}{'sinks':>10}{'took (s)':>9}")
    with tempfile.TemporaryDirectory() as out:
        for block in map(Block.of, numbers):
            folder = export_to_simulators([block], ["mjcf", "urdf", "sdf"], Path(out))[0].folder
            name = block.texture.name
            if importlib.util.find_spec("mujoco"):
                for kind in ("", "-tiles"):
                    original = folder / f"{name}{kind}.xml"
                    soft = folder / f"{name}{kind}-soft.xml"
                    text = re.sub(r'solref=.*?priority="1"', DEFAULTS, original.read_text(encoding="utf-8"))
                    soft.write_text(text.replace('timestep="0.0005"', 'timestep="0.002"'), encoding="utf-8")
                    for label, path in (("settings of the file", original), ("MuJoCo's defaults", soft)):
                        for radius in (0.5, 1.0, DOME_MM):
                            case = f"{kind[1:] or 'one'}, {label}"
                            row("mujoco", case, block, radius, 0.3, lambda *a, path=path: mujoco(path, *a))
            if importlib.util.find_spec("pybullet"):
                path = folder / f"{name}.urdf"
                for radius in (0.5, 1.0, 5.0, 12.0, DOME_MM):
                    row("pybullet", "step 1/2000 s", block, radius, 0.6, lambda *a, p=path: pybullet(p, *a))
            if importlib.util.find_spec("pydrake"):
                path = folder / f"{name}.sdf"
                for radius, modulus in ((0.5, 1e7), (1.0, 1e7), (DOME_MM, 1e7), (DOME_MM, 1e9)):
                    case = f"modulus {modulus:g} Pa"
                    row("drake", case, block, radius, 0.5, lambda *a, p=path, m=modulus: drake(p, *a, modulus_pa=m))
    for module in ("mujoco", "pybullet", "pydrake"):
        if not importlib.util.find_spec(module):
            print(f"left out: {module} is not installed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
