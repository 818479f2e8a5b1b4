"""Textures on faces of parts, compared with the kernel's own fit of the same surface and its Boolean operations.

``python benchmarks/textured_faces.py`` prints a table. Each row is one part: a plate of 40 x 30 mm with two holes and
texture 2, and a cylinder of radius 15 mm and length 30 mm with the textures 2 and 3. The times are those of the
processor, after a first part that loads the kernel. The peer fits one surface through a grid of points
(``Face.makeSplineApprox`` of CadQuery, 0.1 mm apart), makes a solid of it and combines it with the part. The distance
from the formula is measured on both solids. For the cylinder, the peer has no ready function, so only the plate has a
peer.
"""

from __future__ import annotations

import time

import cadquery as cq
import numpy as np
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps

from tacbench_cad.checks.solidcheck import points_on, spline_faces
from tacbench_cad.geometry.textured.relief import FaceRelief
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
    regions = [(region, height) for region, _, height in result.regions]
    return FaceRelief(regions, np.zeros(3), 1.0).of_points(points_on(spline_faces(shape.wrapped)))[0]


def fitted(result: TexturedSolid) -> cq.Shape:
    """Put the same texture on the plate by the kernel's fit and its Boolean operations."""
    ((region, _, height),) = result.regions
    x, y = (np.linspace(0.0, size, round(size / STEP_MM) + 1) for size in region.size_mm)
    points = region.frame.point(x[:, None], y[None, :], height.grid(x, y))
    top = cq.Face.makeSplineApprox([[cq.Vector(*point) for point in row] for row in points.tolist()], tol=1e-4)
    high = height.range_mm[1]
    above = cq.Solid.extrudeLinear(cq.Face(region.face), cq.Vector(0, 0, high + 1.0))
    pieces = above.split(top)
    low = min(pieces.Solids(), key=lambda piece: piece.Center().z)
    return PLATE.val().fuse(low)


def main() -> None:
    """Measure, and print the table."""
    textured_solid(CYLINDER.val().wrapped, CYLINDER.faces("%Cylinder").val().wrapped, texturing(1))
    print("part                   time    distance     volume         valid, solids")
    for name, part, face, texture in (
        ("plate, texture 2", PLATE, ">Z", 2),
        ("cylinder, texture 2", CYLINDER, "%Cylinder", 2),
        ("cylinder, texture 3", CYLINDER, "%Cylinder", 3),
    ):
        settings = texturing(texture)
        start = time.process_time()
        result = textured_solid(part.val().wrapped, part.faces(face).val().wrapped, settings)
        seconds = time.process_time() - start
        show(name, seconds, cq.Solid(result.solid), result)
        if part is PLATE:
            start = time.process_time()
            try:
                peer = fitted(result)
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
