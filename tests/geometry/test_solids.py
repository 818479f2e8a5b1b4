"""Meshes of fixtures: closed, welded, reproducible, and within the deflection."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.fixture_measure import manifold

from tacbench_cad.geometry.solids import tessellate
from tacbench_cad.util.errors import InputError

build123d = pytest.importorskip("build123d", reason="fixtures need the extra cad")


def bored_plate() -> object:
    """A plate of 10 x 10 x 2 mm with a hole of 4 mm and a lead-in."""
    plate = build123d.Box(10, 10, 2) - build123d.Cylinder(2, 4) - build123d.Pos(0, 0, 1) * build123d.Cone(1.5, 3.5, 1)
    return plate.solids()[0].wrapped


def test_closed_and_welded() -> None:
    mesh = tessellate(bored_plate())
    solid = manifold(mesh)
    assert solid.status().name == "NoError"
    assert solid.genus() == 1
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    assert len(np.unique(mesh.faces)) == len(mesh.vertices)
    # Euler's formula for a closed surface with one handle.
    assert len(mesh.vertices) - len(mesh.faces) / 2 == 0


@pytest.mark.parametrize("deflection", [0.1, 0.01, 0.001])
def test_chords_stay_within_the_deflection(deflection: float) -> None:
    mesh = tessellate(bored_plate(), deflection)
    a, b, c = np.moveaxis(mesh.triangle_points, 1, 0)
    middles = np.concatenate([a + b, b + c, c + a]) / 2.0
    # Edges of the hole below the cone: both ends have radius 2, and the error is largest at the middle of the chord.
    below = middles[middles[:, 2] < 0.0]
    radius = np.hypot(below[:, 0], below[:, 1])
    chords = radius[radius < 2.0]
    assert len(chords) > 10
    assert 2.0 - chords.min() <= deflection + 1e-6


def test_curved_faces_of_other_kinds_are_refused() -> None:
    with pytest.raises(InputError, match="planes, cylinders, cones and splines"):
        tessellate(build123d.Solid.make_sphere(2.0).wrapped)


@pytest.mark.parametrize("deflection", [0.0, -1.0, math.nan, math.inf])
def test_an_invalid_deflection_is_refused(deflection: float) -> None:
    with pytest.raises(InputError, match="deflection"):
        tessellate(bored_plate(), deflection)
