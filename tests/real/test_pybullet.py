"""PyBullet: rays hit the texture at the height of the formula, and a small ball rests at the computed height."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import BALL_MM, NEAR_MM, Exported, centre_height_mm, places_mm, steel_kg, valley_mm

from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec.block import Block

pybullet = pytest.importorskip("pybullet", reason="PyBullet is not installed: pip install pybullet")
pytestmark = pytest.mark.real

STEP_S = 1.0 / 2000.0


@pytest.fixture
def world() -> Iterator[int]:
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=client)
    pybullet.setTimeStep(STEP_S, physicsClientId=client)
    pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
    yield client
    pybullet.disconnect(client)


def load(number: str, exported: Exported, world: int) -> int:
    path = exported(number, "urdf") / f"texture-{number}.urdf"
    return int(pybullet.loadURDF(str(path), physicsClientId=world))


@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_heights(number: str, exported: Exported, world: int) -> None:
    block = Block.of(number)
    body = load(number, exported, world)
    places = places_mm(block)
    hits = [
        pybullet.rayTest([x / 1e3, y / 1e3, 0.02], [x / 1e3, y / 1e3, -0.02], physicsClientId=world)[0]
        for x, y in places
    ]
    assert all(hit[0] == body for hit in hits), "a ray missed the block"
    error = np.abs(np.array([hit[3][2] * 1e3 for hit in hits]) - block.height_at(*places.T))
    assert error.max() <= SimulatorAsset(block).mesh_certificate.vertical_mm + 1e-5


def drop(world: int, start_mm: tuple[float, float, float]) -> tuple[float, float, float]:
    """Drop a steel ball in a world with gravity and return its position a second later, in mm."""
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=BALL_MM / 1e3, physicsClientId=world)
    start = [coordinate / 1e3 for coordinate in start_mm]
    ball = pybullet.createMultiBody(steel_kg(BALL_MM), shape, basePosition=start, physicsClientId=world)
    pybullet.changeDynamics(
        ball,
        -1,
        linearDamping=5,
        angularDamping=5,
        lateralFriction=0.5,
        rollingFriction=0,
        restitution=0,
        physicsClientId=world,
    )
    for _ in range(round(1.0 / STEP_S)):
        pybullet.stepSimulation(physicsClientId=world)
    x, y, z = pybullet.getBasePositionAndOrientation(ball, physicsClientId=world)[0]
    return 1e3 * x, 1e3 * y, 1e3 * z


@pytest.mark.parametrize("number", mostly_long("123456", "2", "4"))
def test_contact_of_a_ball(number: str, exported: Exported, world: int) -> None:
    block = Block.of(number)
    load(number, exported, world)
    x, y, z = valley_mm(block)
    position = drop(world, (x + 0.05, y + 0.03, z + 0.3))
    assert position[2] == pytest.approx(z, abs=NEAR_MM)
    assert position[2] == pytest.approx(centre_height_mm(block, position[0], position[1]), abs=NEAR_MM)
