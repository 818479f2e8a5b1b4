"""MuJoCo: rays hit the texture at the height of the formula, and a ball and a dome rest at the computed heights."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import BALL_MM, NEAR_MM, Exported, centre_height_mm, places_mm, steel_kg, valley_mm

from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec.block import Block

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
pytestmark = pytest.mark.real

DOME_MM, DOME_N = 20.0, 2.0
FILES = ("", "-tiles")
#: The default contact settings of MuJoCo.
DEFAULTS = 'solref="0.02 1" solimp="0.9 0.95 0.001" priority="1"'


def rest_of_ball(path: Path, start_mm: tuple[float, float, float], seconds: float = 1.0) -> np.ndarray:
    """Drop a steel ball and return its final position in mm."""
    spec = mujoco.MjSpec.from_file(str(path))
    mass = steel_kg(BALL_MM)
    ball = spec.worldbody.add_body(name="ball", pos=[value / 1e3 for value in start_mm])
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[BALL_MM / 1e3, 0, 0], mass=mass)
    for axis in np.eye(3):
        ball.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, damping=10.0 * mass)
    ball.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, damping=mass * 1e-5)
    _, data = run(spec, seconds)
    assert np.abs(data.qvel[:3]).max() < 1e-3, "the ball is still moving"
    return np.asarray(data.body("ball").xpos) * 1e3


def run(spec: Any, seconds: float) -> tuple[Any, Any]:
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    return model, data


def sinking_of_dome(path: Path, block: Block) -> tuple[float, float]:
    """Drop a dome of 2 N from 0.3 mm. Return its depth below the contact with the formula after 0.3 s, in mm, and its
    speed in m/s.
    """
    x, y = (side / 2.0 for side in block.size_mm)
    free = centre_height_mm(block, x, y, DOME_MM, samples=1201)
    spec = mujoco.MjSpec.from_file(str(path))
    mass = DOME_N / 9.81
    dome = spec.worldbody.add_body(name="dome", pos=[x / 1e3, y / 1e3, (free + 0.3) / 1e3])
    dome.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[DOME_MM / 1e3, 0, 0], mass=mass)
    dome.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=[0, 0, 1], damping=10.0 * mass)
    _, data = run(spec, 0.3)
    return free - float(data.body("dome").xpos[2]) * 1e3, float(data.qvel[0])


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_heights(number: str, kind: str, exported: Exported) -> None:
    block = Block.of(number)
    model = mujoco.MjModel.from_xml_path(str(exported(number, "mjcf") / f"texture-{number}{kind}.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    places = places_mm(block)
    hit, down = np.zeros(1, np.int32), [0, 0, -1]
    heights = [
        20.0 - 1e3 * mujoco.mj_ray(model, data, [x / 1e3, y / 1e3, 0.02], down, None, 1, -1, hit) for x, y in places
    ]
    error = np.abs(np.array(heights) - block.height_at(*places.T))
    assert error.max() <= SimulatorAsset(block).heights.certificate.vertical_mm + 1e-5


@pytest.mark.parametrize("kind", FILES)
@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_contact_of_a_ball(number: str, kind: str, exported: Exported) -> None:
    block = Block.of(number)
    x, y, z = valley_mm(block)
    position = rest_of_ball(exported(number, "mjcf") / f"texture-{number}{kind}.xml", (x + 0.05, y + 0.03, z + 0.3))
    assert position[2] == pytest.approx(z, abs=NEAR_MM)
    assert position[2] == pytest.approx(centre_height_mm(block, position[0], position[1]), abs=NEAR_MM)


def test_a_soft_dome_runs_out_of_contacts_on_one_field(exported: Exported) -> None:
    """Show with the default settings of MuJoCo that a single field has too few contacts and that tiles avoid this."""
    folder, block = exported("2", "mjcf"), Block.of("2")
    sinking = []
    for kind in FILES:
        text = (folder / f"texture-2{kind}.xml").read_text(encoding="utf-8")
        text = re.sub(r'solref=.*?priority="1"', DEFAULTS, text).replace('timestep="0.0005"', 'timestep="0.002"')
        soft = folder / f"soft{kind}.xml"
        soft.write_text(text, encoding="utf-8")
        sinking.append(sinking_of_dome(soft, block)[0])
        soft.unlink()
    single_field, tiles = sinking
    assert single_field > 0.3 and tiles < NEAR_MM


def test_a_users_scene_attaches_the_texture(exported: Exported) -> None:
    child = mujoco.MjSpec.from_file(str(exported("2", "mjcf") / "texture-2-tiles.xml"))
    scene = mujoco.MjSpec()
    scene.option.timestep = child.option.timestep
    frame = scene.worldbody.add_frame(pos=[0.1, 0.0, 0.0])
    scene.attach(child, prefix="a-", frame=frame)
    model = scene.compile()
    assert model.ngeom == 64 and model.body("a-texture-2").pos[0] == pytest.approx(0.1)
