"""A CAD part with textures on its faces, which can be exported and checked like a block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.mesh import Certificate, ExpectedGeometry, Mesh, manifold_of
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.geometry.solids import (
    ANGLE_RAD,
    FREE_FRACTION,
    ROUND_DECIMALS,
    require_closed,
    rounding_mm3,
    weld,
    welded,
)
from tacbench_cad.geometry.textured.face_relief import FaceRelief
from tacbench_cad.geometry.textured.result import Textured
from tacbench_cad.geometry.texturing import Texturing
from tacbench_cad.geometry.triangulation import triangulate
from tacbench_cad.util.errors import CheckFailedError, InputError

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

    from tacbench_cad.geometry.textured.solid import TexturedSolid

#: The largest distance between a point that names a face and the face, in mm.
NEAR_MM = 1.0
#: The fraction of the tolerance for the triangles of a texture.
_FRACTION = 0.95
#: The depth by which the body of a texture reaches into the part, or a sunk texture's body out of it, in mm.
_OVERLAP_MM = 0.05
#: Vertices that are nearer than this may be merged, in mm.
_SIMPLIFY_MM = 2e-4
#: The distance that rounding of coordinates adds, in mm.
_ROUNDING_MM = 1e-5


def textured_faces(
    shape: TopoDS_Shape,
    faces: Sequence[Any],
    texturing: Texturing,
    mesh_tolerance_mm: float,
    names: tuple[str, str, str],
    spec: Mapping[str, Any],
) -> Textured:
    """Put a texture on faces of a solid, one after another.

    Args:
        shape: The part, with one solid.
        faces: The faces, which are planes or cylinders.
        texturing: The settings.
        mesh_tolerance_mm: The largest distance of the mesh from the formula.
        names: The name, the kind and the title of the part.
        spec: The input values of the part, as plain JSON values.

    Raises:
        InputError: A face is neither planar nor cylindrical, or a setting is not allowed for it.
    """
    from tacbench_cad.geometry.textured.solid import textured_solid

    name, kind, title = names
    results, solid, volume = [], shape, kernel.volume_mm3(shape)
    for face in faces:
        results.append(textured_solid(solid, face, texturing))
        solid, volume = results[-1].solid, volume + results[-1].added_mm3
    made = _Made(shape, results, texturing, mesh_tolerance_mm, volume)
    low, high = (np.round(corner, ROUND_DECIMALS - 3) + 0.0 for corner in kernel.box_mm(solid))
    (x, y, z), (low_x, low_y, low_z) = (high - low).tolist(), low.tolist()
    proved = all(result.is_proved for result in results)
    return Textured(
        printed=PrintPart(
            name=name,
            kind=kind,
            title=title,
            size_mm=(x, y, z),
            genus=kernel.genus(solid),
            make_mesh=made.mesh,
            make_solid=made.shape,
            spec=spec,
            mesh_needs_cad=True,
            low_mm=(low_x, low_y, low_z),
        ),
        heights=tuple(height for result in results for height in result.heights),
        certificate=Certificate(
            distance_mm=made.error_mm, vertical_mm=made.error_mm, evidence="proved" if proved else "measured"
        ),
        volume_mm3=volume,
    )


def face_at(shape: TopoDS_Shape, at: Sequence[float]) -> TopoDS_Face:
    """Return the face of a shape at a point.

    Args:
        shape: The shape.
        at: The point, at most :data:`NEAR_MM` from the face.

    Raises:
        InputError: The point is too far from the shape, or equally near to two faces.
    """
    from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
    from OCP.BRepExtrema import BRepExtrema_DistShapeShape
    from OCP.gp import gp_Pnt

    if len(at) != 3 or not np.all(np.isfinite(at)):
        raise InputError("at", tuple(at), "must be three finite coordinates in mm")
    vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*at)).Vertex()
    distances = [
        (BRepExtrema_DistShapeShape(vertex, face).Value(), number, face)
        for number, face in enumerate(kernel.each(shape, "FACE"))
    ]
    distances.sort(key=lambda item: item[:2])
    if not distances or distances[0][0] > NEAR_MM:
        where = f"{distances[0][0]:.4g} mm from the part" if distances else "not on the part, which has no faces"
        raise InputError("at", tuple(at), f"is {where}; choose a point on the face")
    if len(distances) > 1 and distances[1][0] - distances[0][0] < 1e-6:
        raise InputError("at", tuple(at), "is equally near to two faces; choose a point inside of the face")
    return distances[0][2]


def faces_by(shape: TopoDS_Shape, selector: str) -> list[Any]:
    """Return the faces of a shape that a selector of CadQuery chooses, for example ``">Z"`` or ``"%Cylinder"``.

    Raises:
        InputError: The selector is not right, or chooses no face.
    """
    import cadquery as cq

    faces: list[Any] = []
    try:
        faces = [face.wrapped for face in cq.Workplane(cq.Shape.cast(shape)).faces(selector).vals()]
    except Exception as error:  # the parser of CadQuery raises errors of several classes
        if not type(error).__module__.startswith("pyparsing") and not isinstance(error, (ValueError, IndexError)):
            raise
    if not faces:
        raise InputError("face", selector, 'selects no face; use a selector of CadQuery such as ">Z" or "%Cylinder"')
    return faces


@dataclass(frozen=True, eq=False)
class _Made:
    """The solid and the mesh of a part with textures on its faces.

    Args:
        before: The part without its textures.
        results: The solid after each texture.
        texturing: The settings.
        mesh_tolerance_mm: The largest distance of the mesh from the formula.
        volume_mm3: The expected volume.
    """

    before: TopoDS_Shape
    results: Sequence[TexturedSolid]
    texturing: Texturing
    mesh_tolerance_mm: float
    volume_mm3: float

    @property
    def error_mm(self) -> float:
        """The bound of the distance of the solid from the formula."""
        return max(result.error_mm for result in self.results)

    def _relief(self, allowed_mm: float) -> FaceRelief:
        return FaceRelief([height for result in self.results for height in result.heights], allowed_mm)

    @cached_property
    def _slack_mm3(self) -> float:
        """The error of the kernel's volume: large only if a face of the part is a free surface."""
        simple = {"Plane", "Cylinder", "Cone", "Sphere", "Torus", "BSplineSurface"}
        kinds = {kernel.surface_kind(face) for face in kernel.each(self.results[-1].solid, "FACE")}
        return FREE_FRACTION * self.volume_mm3 if kinds - simple else 0.0

    def shape(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """Return the solid and its expected geometry."""
        area = sum(height.area.polygon.area for result in self.results for height in result.heights)
        return self.results[-1].solid, ExpectedGeometry(
            volume_mm3=self.volume_mm3,
            volume_slack_mm3=self._slack_mm3 + self.error_mm * area,
            relief=self._relief(self.error_mm + _ROUNDING_MM),
        )

    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """Return the mesh of the part without its textures, with the bodies of the textures added or cut out.

        Raises:
            CheckFailedError: The mesh is not within the tolerance.
        """
        from tacbench_cad.geometry.textured.body import texture_body

        tolerance = _FRACTION * self.mesh_tolerance_mm
        whole = manifold_of(*weld(*triangulate(self.before, tolerance, ANGLE_RAD)))
        other = (_OVERLAP_MM + tolerance) * (1.0 if self.texturing.sunk else -1.0)
        relief = self._relief(self.mesh_tolerance_mm)
        for height in relief.heights:
            body = texture_body(height, other, tolerance).body
            whole = whole - body if self.texturing.sunk else whole + body
        mesh = welded(whole.simplify(_SIMPLIFY_MM))
        require_closed(mesh)
        distance, _ = relief.of_mesh(mesh)
        if distance > self.mesh_tolerance_mm:
            raise CheckFailedError(
                f"the mesh is {distance:.3g} mm from the formula instead of {self.mesh_tolerance_mm:g} mm; choose a "
                "larger mesh_tolerance_mm"
            )
        faces = kernel.each(self.results[-1].solid, "FACE")
        curved = kernel.area_mm2(face for face in faces if kernel.surface_kind(face) != "Plane")
        reach = np.abs(mesh.vertices).max(axis=0) + np.ptp(mesh.vertices, axis=0)
        return mesh, ExpectedGeometry(
            volume_mm3=self.volume_mm3,
            volume_slack_mm3=curved * self.mesh_tolerance_mm + self._slack_mm3 + rounding_mm3(tuple(reach.tolist())),
            size_slack_mm=self.mesh_tolerance_mm,
            relief=relief,
        )
