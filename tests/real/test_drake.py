"""Drake: the signed distance on the formula is zero, and a ball rests in a valley at the height of the formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.resting import BALL_MM, NEAR_MM, Exported, centre_height_mm, places_mm, steel_kg, valley_mm

from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.spec.block import Block

pytest.importorskip("pydrake", reason="Drake is not installed: pip install drake")
from pydrake.geometry import AddCompliantHydroelasticProperties, AddContactMaterial, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia, UnitInertia, default_model_instance
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

pytestmark = pytest.mark.real

NUMBERS = "2346"


class World:
    """A world with the fixed texture and, if a start position is given, a steel ball above it."""

    def __init__(self, number: str, exported: Exported, start_mm: tuple[float, float, float] | None = None) -> None:
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=1e-3, contact_model="hydroelastic")
        self.plant, self.scene = AddMultibodyPlant(config, builder)
        name = f"texture-{number}"
        (model,) = Parser(self.plant).AddModels(str(exported(number, "sdf") / f"{name}.sdf"))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName(name, model))
        self.ball = None if start_mm is None else self._add_ball()
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())
        self.context = self.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        if start_mm is not None:
            self.plant.SetFreeBodyPose(self.context, self.ball, RigidTransform(np.array(start_mm) / 1e3))

    def _add_ball(self) -> Any:
        radius = BALL_MM / 1e3
        inertia = SpatialInertia(steel_kg(BALL_MM), np.zeros(3), UnitInertia.SolidSphere(radius))
        ball = self.plant.AddRigidBody("ball", default_model_instance(), inertia)
        surface = ProximityProperties()
        AddCompliantHydroelasticProperties(radius / 4.0, 1e7, surface)
        AddContactMaterial(dissipation=10.0, friction=CoulombFriction(0.5, 0.5), properties=surface)
        self.plant.RegisterCollisionGeometry(ball, RigidTransform(), Sphere(radius), "ball", surface)
        return ball

    @property
    def ball_mm(self) -> np.ndarray:
        return np.asarray(self.plant.EvalBodyPoseInWorld(self.context, self.ball).translation()) * 1e3


@pytest.mark.parametrize("number", mostly_long(NUMBERS, "2"))
def test_heights(number: str, exported: Exported) -> None:
    """The distance between the formula and the triangles must be within the proved error."""
    block = Block.of(number)
    world = World(number, exported)
    query = world.scene.get_query_output_port().Eval(world.scene.GetMyContextFromRoot(world.simulator.get_context()))
    places = places_mm(block, 100)
    points = np.column_stack([places, block.height_at(*places.T)]) / 1e3
    distances = [query.ComputeSignedDistanceToPoint(point, threshold=1e-3)[0].distance * 1e3 for point in points]
    assert np.abs(distances).max() <= SimulatorAsset(block).mesh_certificate.vertical_mm + 1e-5
    up = np.array([0.0, 0.0, 1e-3])
    above = [query.ComputeSignedDistanceToPoint(p + up, threshold=1.0)[0].distance for p in points]
    below = [query.ComputeSignedDistanceToPoint(p - up, threshold=1.0)[0].distance for p in points]
    assert min(above) > 0.0 > max(below)


@pytest.mark.parametrize("number", mostly_long(NUMBERS, "2"))
def test_contact_of_a_ball(number: str, exported: Exported) -> None:
    block = Block.of(number)
    x, y, z = valley_mm(block)
    world = World(number, exported, (x + 0.05, y + 0.03, z + 0.3))
    world.simulator.AdvanceTo(0.5)
    position = world.ball_mm
    assert position[2] == pytest.approx(z, abs=NEAR_MM)
    assert position[2] == pytest.approx(centre_height_mm(block, position[0], position[1]), abs=NEAR_MM)
