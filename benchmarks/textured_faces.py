"""Textures on faces of parts, compared with the kernel's own fit of the same surface and its Boolean operations.

``python benchmarks/textured_faces.py`` prints a table. Each row is one part: a plate of 40 x 30 mm with two holes and
the textures 2, 3 and 4, and a cylinder of radius 15 mm and length 30 mm with the textures 2 and 3. The times are those
of the processor, after a first part that loads the kernel. The peer fits one surface through a grid of points
(``Face.makeSplineApprox`` of CadQuery, 0.1 mm apart), makes a solid of it and combines it with the part. Around the
cylinder, it fits two surfaces, each around one half. The distance from the formula is measured on both solids. On the
plate, the peer has no row for the textures 3 and 4, because it takes longer than two minutes.
"""

from __future__ import annotations

import time

import cadquery as cq
import numpy as np
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps

from tacbench_cad.checks.solidcheck import points_on, spline_faces
from tacbench_cad.geometry.textured.face_relief import FaceRelief
from tacbench_cad.geometry.textured.solid import TexturedSolid, textured_solid
from tacbench_cad.geometry.texturing import texturing

#: The distance between the points that the kernel fits, in mm.
STEP_MM = 0.1
PLATE = cq.Workplane().box(40, 30, 5).faces(">Z").workplane().pushPoints([(-10, 5), (10, -5)]).hole(6)
CYLINDER = cq.Workplane().circle(15).extrude(30)


def volume_mm3(shape: cq.Shape) -> float:
    """Return the volume by the kernel's adaptive method."""
    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape.wrapped, properties, 1e-5, False, True)
    return float(properties.Mass())


def distance_mm(shape: cq.Shape, result: TexturedSolid) -> float:
    """Return the largest distance of a solid's spline faces from the formula."""
    return FaceRelief(result.heights, 1.0).of_points(points_on(spline_faces(shape.wrapped)))[0]


def fitted(result: TexturedSolid) -> cq.Shape:
    """Put the same texture on the plate by the kernel's fit and its Boolean operations."""
    (height,) = result.heights
    x, y = (np.linspace(0.0, size, round(size / STEP_MM) + 1) for size in height.area.size_mm)
    top = sheet(height.area.frame.point(x[:, None], y[None, :], height.grid(x, y)))
    high = height.range_mm[1]
    above = cq.Solid.extrudeLinear(cq.Face(height.area.face), cq.Vector(0, 0, high + 1.0))
    pieces = above.split(top)
    low = min(pieces.Solids(), key=lambda piece: piece.Center().z)
    return PLATE.val().fuse(low)


def fitted_around(result: TexturedSolid) -> cq.Shape:
    """Put the same texture around the cylinder. The kernel fits two sheets, because it cannot fit a closed surface."""
    (height,) = result.heights
    around, length = height.area.size_mm
    frame, beyond = height.area.frame, 1.0
    t = np.linspace(-beyond, length + beyond, round((length + 2.0 * beyond) / STEP_MM) + 1)
    outer = frame.radius_mm + height.range_mm[1] + 1.0
    plane = cq.Plane(*(tuple(vector.tolist()) for vector in (frame.origin, frame.axes[0], frame.axes[2])))
    tube = cq.Workplane(plane).circle(outer).circle(frame.radius_mm).extrude(length)
    result_shape = CYLINDER.val()
    for half in (0, 1):
        s = np.linspace(-beyond, around / 2.0 + beyond, round((around / 2.0 + 2.0 * beyond) / STEP_MM) + 1)
        s += half * around / 2.0
        top = sheet(frame.point(s[:, None], t[None, :], height.grid(s, t)))
        side = (
            cq.Workplane(plane).center(0.0, outer - 2.0 * half * outer).rect(4.0 * outer, 2.0 * outer).extrude(length)
        )
        pieces = tube.intersect(side).val().split(top)
        low = min(pieces.Solids(), key=lambda piece: piece.Volume() if piece.isInside(inner(result, half)) else 1e9)
        result_shape = result_shape.fuse(low)
    return result_shape


def inner(result: TexturedSolid, half: int) -> cq.Vector:
    """Return a point just outside of the cylinder, below the texture, in the middle of a half."""
    (height,) = result.heights
    s, t = height.area.size_mm[0] * (0.25 + 0.5 * half), height.area.size_mm[1] / 2.0
    return cq.Vector(*height.area.frame.point(np.array(s), np.array(t), height.range_mm[0] / 2.0).tolist())


def sheet(points: np.ndarray) -> cq.Face:
    """Return the kernel's fit of a grid of points, shape (n, m, 3)."""
    return cq.Face.makeSplineApprox([[cq.Vector(*point) for point in row] for row in points.tolist()], tol=1e-4)


def main() -> None:
    """Measure, and print the table."""
    textured_solid(CYLINDER.val().wrapped, CYLINDER.faces("%Cylinder").val().wrapped, texturing(1))
    print("part                   time    distance     volume         valid, solids")
    for name, part, face, texture in (  # the peer takes minutes for textures 3 and 4
        ("plate, texture 2", PLATE, ">Z", 2),
        ("plate, texture 3", PLATE, ">Z", 3),
        ("plate, texture 4", PLATE, ">Z", 4),
        ("cylinder, texture 2", CYLINDER, "%Cylinder", 2),
        ("cylinder, texture 3", CYLINDER, "%Cylinder", 3),
    ):
        settings = texturing(texture)
        start = time.process_time()
        result = textured_solid(part.val().wrapped, part.faces(face).val().wrapped, settings)
        seconds = time.process_time() - start
        show(name, seconds, cq.Solid(result.solid), result)
        if part is PLATE and texture != 2:
            continue
        start = time.process_time()
        try:
            peer = fitted(result) if part is PLATE else fitted_around(result)
        except Exception as error:  # the kernel raises errors of many classes
            print(f"  kernel's fit: failed after {time.process_time() - start:.2f} s: {error}")
        else:
            show("  kernel's fit", time.process_time() - start, peer, result)


def show(name: str, seconds: float, shape: cq.Shape, result: TexturedSolid) -> None:
    """Print one row."""
    volume = volume_mm3(shape) / result.volume_mm3 - 1.0
    print(
        f"{name:20} {seconds:6.2f} s {distance_mm(shape, result):8.5f} mm  {volume:+.1e}      {shape.isValid()}, "
        f"{len(shape.Solids())}"
    )


if __name__ == "__main__":
    main()
