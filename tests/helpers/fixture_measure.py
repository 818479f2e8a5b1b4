"""Measure a fixture on its mesh and its solid, with independent geometry kernels."""

from __future__ import annotations

import manifold3d
import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.util.types import Floats

#: The limit of a face's normal: downward faces may overhang by 45 degrees, and chords of a cone by a little more.
STEEPEST_OVERHANG = -np.cos(np.radians(45.0)) - 0.02


def manifold(mesh: Mesh) -> manifold3d.Manifold:
    """Return the mesh as a manifold3d solid."""
    return manifold3d.Manifold(manifold3d.Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)))


def outline_of(block: Block) -> Floats:
    """Return the block's outline in the block's frame, counter-clockwise."""
    x, y = block.size_mm
    k = block.key_mm
    corner = [(x, 0.0)] if k is None else [(x - k, 0.0), (x, k)]
    return np.array([(0.0, 0.0), *corner, (x, y), (0.0, y)])


def block_prism(block: Block) -> manifold3d.Manifold:
    """Return the upright prism over the block's outline up to the block's highest point; it contains the block."""
    section = manifold3d.CrossSection([outline_of(block)], manifold3d.FillRule.NonZero)
    return section.extrude(block.height_mm)


def require_sound(part: PrintPart) -> None:
    """Check that mesh and solid are closed, have the stated genus, box and volume, and no triangle without area."""
    mesh, body = part.mesh
    solid = manifold(mesh)
    assert solid.status() == manifold3d.Error.NoError
    assert solid.genus() == part.genus
    low, high = mesh.bounds_mm
    assert np.abs(low).max() == 0.0
    assert np.abs(high - part.size_mm).max() < 1e-5
    excess = mesh.volume_mm3 - body.volume_mm3
    # Chords lie inside a hole's circle, so except for rounding a mesh never has less than the true volume.
    assert -0.01 < excess <= body.volume_slack_mm3
    assert np.array_equal(mesh.vertices, mesh.vertices.astype(np.float32))
    a, b, c = np.moveaxis(mesh.triangle_points, 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0.0

    from build123d import Solid

    shape, body = part.solid
    wrapped = Solid(shape)
    assert wrapped.is_valid
    assert abs(wrapped.volume - body.volume_mm3) <= body.volume_slack_mm3
    box = wrapped.bounding_box()
    assert np.abs(np.array([*box.min])).max() < 1e-6
    assert np.abs(np.array([*box.max]) - part.size_mm).max() < 1e-6


def overhang_heights(mesh: Mesh) -> set[float]:
    """Return the heights above the bed of all faces that overhang by more than 45 degrees, rounded to 1 um."""
    a, b, c = np.moveaxis(mesh.triangle_points, 1, 0)
    normal = np.cross(b - a, c - a)
    steep = normal[:, 2] / np.linalg.norm(normal, axis=1) < STEEPEST_OVERHANG
    return {round(float(z), 3) for z in a[steep][:, 2] if z > 0.0}


def cylinders(shape: object) -> list[tuple[float, Floats]]:
    """Return the radius and a point on the axis of every cylindrical face."""
    from build123d import GeomType, Solid
    from OCP.BRepAdaptor import BRepAdaptor_Surface

    result = []
    for face in Solid(shape).faces().filter_by(GeomType.CYLINDER):
        cylinder = BRepAdaptor_Surface(face.wrapped).Cylinder()
        place, direction = cylinder.Axis().Location(), cylinder.Axis().Direction()
        assert abs(abs(direction.Z()) - 1.0) < 1e-12
        result.append((cylinder.Radius(), np.array([place.X(), place.Y()])))
    return result
