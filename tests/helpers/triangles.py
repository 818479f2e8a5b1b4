"""Triangles that another program has read: their heights, and the rest position of a ball dropped on them."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from helpers.resting import BALL_MM, steel_kg
from tacbench_cad.util.types import Floats, Ints

STEP_S = 1.0 / 2000.0
NO_PYBULLET = "PyBullet is not installed: pip install pybullet" + (
    "; it has no wheel above Python 3.11" if sys.version_info >= (3, 12) else ""
)


def heights_mm(points: Floats, triangles: Ints, places: Floats) -> Floats:
    """Return z of the highest triangle over each place.

    Args:
        points: The vertices in mm, z up, shape (n, 3).
        triangles: The vertex indices of the triangles, shape (m, 3).
        places: The places (x, y), shape (k, 2).
    """
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    twice = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    upward = twice > 0.0  # triangles of the top; walls have no area in this projection
    a, b, c, twice = a[upward], b[upward], c[upward], twice[upward]
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    heights = []
    for x, y in places:
        near = (low[:, 0] <= x) & (x <= high[:, 0]) & (low[:, 1] <= y) & (y <= high[:, 1])
        p, q, r, area = a[near], b[near], c[near], twice[near]
        s = ((x - p[:, 0]) * (r[:, 1] - p[:, 1]) - (y - p[:, 1]) * (r[:, 0] - p[:, 0])) / area
        t = ((q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])) / area
        over = (s >= -1e-9) & (t >= -1e-9) & (s + t <= 1.0 + 1e-9)
        assert over.any(), f"a hole over {x:g}, {y:g} mm"
        z = p[:, 2] + s * (q[:, 2] - p[:, 2]) + t * (r[:, 2] - p[:, 2])
        heights.append(float(z[over].max()))
    return np.array(heights)


def rest_on_triangles(
    points: Floats, triangles: Ints, start_mm: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the position in mm where a steel ball that is dropped on the triangles comes to rest in PyBullet."""
    pybullet = pytest.importorskip("pybullet", reason=NO_PYBULLET)
    world = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setTimeStep(STEP_S, physicsClientId=world)
        pybullet.setGravity(0, 0, -9.81, physicsClientId=world)
        relief = pybullet.createCollisionShape(
            pybullet.GEOM_MESH,
            vertices=(points / 1e3).tolist(),
            indices=triangles.ravel().tolist(),
            flags=pybullet.GEOM_FORCE_CONCAVE_TRIMESH,
            physicsClientId=world,
        )
        pybullet.createMultiBody(0, relief, physicsClientId=world)
        return drop(pybullet, world, start_mm, BALL_MM)
    finally:
        pybullet.disconnect(world)


def drop(engine: Any, world: int, start_mm: tuple[float, float, float], radius_mm: float) -> tuple[float, float, float]:
    """Drop a steel ball in a world with gravity and return its position a second later, in mm."""
    shape = engine.createCollisionShape(engine.GEOM_SPHERE, radius=radius_mm / 1e3, physicsClientId=world)
    start = [coordinate / 1e3 for coordinate in start_mm]
    ball = engine.createMultiBody(steel_kg(radius_mm), shape, basePosition=start, physicsClientId=world)
    engine.changeDynamics(
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
        engine.stepSimulation(physicsClientId=world)
    x, y, z = engine.getBasePositionAndOrientation(ball, physicsClientId=world)[0]
    return 1e3 * x, 1e3 * y, 1e3 * z
