"""A part of a user with textures on its faces, which can be exported and checked like a block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh, manifold_of
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.geometry.solids import ANGLE_RAD, FREE_FRACTION, ROUND_DECIMALS, require_closed, rounding_mm3, weld
from tacbench_cad.geometry.texturing import Texturing, texturing
from tacbench_cad.geometry.triangulation import triangulate
from tacbench_cad.spec.sampling import TOLERANCE_MM
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import CheckFailedError, InputError, require_between

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

    from tacbench_cad.geometry.textured.face_relief import FaceRelief
    from tacbench_cad.util.types import Floats, Indices

#: The largest distance between a point that names a face and the face, in mm.
NEAR_MM = 1.0
#: The fraction of the tolerance for the triangles of a texture.
_FRACTION = 0.95
#: The depth by which the body of a texture reaches into the part, or a sunk texture's body out of it, in mm.
OVERLAP_MM = 0.05
#: The largest distance between the outline of a texture and its chords, in mm.
_OUTLINE_MM = 1e-3
#: Vertices that are nearer than this may be merged, in mm.
_SIMPLIFY_MM = 2e-4
#: The distance that rounding of coordinates adds, in mm.
_ROUNDING_MM = 1e-5


def textured_part(
    part: Any,
    face: Any,
    texture: Texture | str | int | Path,
    *,
    name: str,
    kind: str = "part",
    title: str = "",
    mesh_tolerance_mm: float = TOLERANCE_MM,
    spec: Mapping[str, Any] | None = None,
    **settings: Any,
) -> PrintPart:
    """Put a texture on one or more faces of a part, for export to STEP, STL and 3MF.

    The faces of the STEP file are within ``tolerance_mm`` of the formula. The mesh of the texture is made from the
    formula, too, and not by the CAD kernel. The distance of each mesh from the formula is measured at nine points of
    each triangle of the texture, and again when a file is checked. In the files, the lower corner of the bounding box
    is at the origin.

    Args:
        part: A part of CadQuery, build123d or Open CASCADE with one solid, in mm.
        face: A planar or cylindrical face of the part, or several faces.
        texture: A texture, the number or name of one of the six, the name of a later one, or a TOML file.
        name: The name of the part in its files.
        kind: The kind of part, a word of your own.
        title: A description for people, in one line.
        mesh_tolerance_mm: The largest distance of the mesh from the formula.
        spec: The input values of the part, as plain JSON values, for the manifest.
        **settings: The other settings of :class:`~tacbench_cad.geometry.texturing.Texturing`: ``depth_mm``,
            ``margin_mm``, ``fade_mm``, ``up``, ``sunk``, ``base_mm``, ``mm_per_unit`` and ``tolerance_mm``.

    Raises:
        InputError: A face is neither planar nor cylindrical, or a setting is not allowed for it.
    """
    require_between("mesh_tolerance_mm", mesh_tolerance_mm, 1e-4, 10.0, " mm")
    faces = [kernel.shape_of(item, "face") for item in _several(face)]
    if not faces:
        raise InputError("face", None, "must be a face of the part; select at least one")
    made = TexturedFaces(kernel.shape_of(part, "part"), faces, texturing(texture, **settings), mesh_tolerance_mm)
    own = {**(spec or {}), **settings, "texture": made.texturing.texture.name, "depth_mm": made.depth_mm}
    return made.part(name, kind, title, own)


def _several(face: Any) -> Sequence[Any]:
    if hasattr(face, "vals"):
        return list(face.vals())
    return list(face) if isinstance(face, (list, tuple)) else [face]


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
        faces = cq.Workplane(cq.Shape.cast(shape)).faces(selector).vals()
    except Exception as error:  # the parser of CadQuery raises errors of several classes
        if not type(error).__module__.startswith("pyparsing") and not isinstance(error, (ValueError, IndexError)):
            raise
    if not faces:
        raise InputError("face", selector, 'selects no face; use a selector of CadQuery such as ">Z" or "%Cylinder"')
    return faces


class TexturedFaces:
    """A part with a texture on one or more of its faces: its solid and its mesh.

    Args:
        shape: The part, with one solid.
        faces: The faces.
        texturing: The settings.
        mesh_tolerance_mm: The largest distance of the mesh from the formula.
        keeps_place: Whether files keep the coordinates of the part. Otherwise, the lower corner of the bounding box is
            at the origin.
    """

    def __init__(
        self,
        shape: TopoDS_Shape,
        faces: Sequence[Any],
        texturing: Texturing,
        mesh_tolerance_mm: float,
        keeps_place: bool = False,
    ) -> None:
        from tacbench_cad.geometry.textured.solid import TexturedSolid, textured_solid

        self.texturing, self._mesh_tolerance_mm = texturing, mesh_tolerance_mm
        self._before = shape
        before, volume = shape, kernel.volume_mm3(shape)
        self.results: list[TexturedSolid] = []
        for face in faces:
            result = textured_solid(before, face, texturing)
            volume += result.added_mm3
            before = result.solid
            self.results.append(result)
        self.depth_mm = max(height.depth_mm for result in self.results for _, _, height in result.regions)
        low, high = kernel.box_mm(before)
        to_origin = np.eye(4)
        self._shift_mm = np.zeros(3) if keeps_place else -low
        to_origin[:3, 3] = self._shift_mm
        self.solid = before.Moved(kernel.location(to_origin))
        self._low_mm, self._size_mm = (np.round(x, ROUND_DECIMALS - 3) for x in (low + self._shift_mm, high - low))
        self.volume_mm3 = volume

    def part(self, name: str, kind: str, title: str, spec: Mapping[str, Any]) -> PrintPart:
        """Return the part for its files; see :class:`~tacbench_cad.geometry.part.PrintPart`."""
        (x, y, z), (low_x, low_y, low_z) = self._size_mm.tolist(), (self._low_mm + 0.0).tolist()
        return PrintPart(
            name=name,
            kind=kind,
            title=title or name,
            size_mm=(x, y, z),
            genus=kernel.genus(self.solid),
            make_mesh=self.mesh,
            make_solid=self.shape,
            spec=spec,
            mesh_needs_cad=True,
            low_mm=(low_x, low_y, low_z),
        )

    def _relief(self, allowed_mm: float) -> FaceRelief:
        from tacbench_cad.geometry.textured.face_relief import FaceRelief

        regions = [(region, height) for result in self.results for region, _, height in result.regions]
        return FaceRelief(regions, self._shift_mm, allowed_mm)

    @property
    def _reach_mm(self) -> tuple[float, float, float]:
        """The largest coordinates of the part or its size, whichever is larger."""
        x, y, z = np.maximum(self._size_mm, np.abs(self._low_mm) + self._size_mm).tolist()
        return x, y, z

    @cached_property
    def _slack_mm3(self) -> float:
        """The error of the kernel's volume: large only if a face of the part is a free surface."""
        return FREE_FRACTION * self.volume_mm3 if _has_free_edges(self.solid) else 0.0

    def shape(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """Return the solid and its expected geometry."""
        error = max(result.error_mm for result in self.results)
        return self.solid, ExpectedGeometry(
            volume_mm3=self.volume_mm3,
            volume_slack_mm3=self._slack_mm3 + error * kernel.area_mm2(r.face for r in self._regions()),
            relief=self._relief(error + _ROUNDING_MM),
        )

    def _regions(self) -> list[Any]:
        return [region for result in self.results for region, _, _ in result.regions]

    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """Return the mesh and its expected geometry.

        Raises:
            CheckFailedError: The mesh is not within the tolerance.
        """
        relief = self._relief(self._mesh_tolerance_mm)
        curved = kernel.area_mm2(
            face for face in kernel.each(self.solid, "FACE") if kernel.surface_kind(face) != "Plane"
        )
        vertices, triangles = weld(*self._combined(_FRACTION * self._mesh_tolerance_mm))
        require_closed(vertices, triangles)
        mesh = Mesh(vertices=vertices, faces=triangles)
        found, _ = relief.of_mesh(mesh)
        if found > self._mesh_tolerance_mm:
            raise CheckFailedError(
                f"the mesh is {found:.3g} mm from the formula instead of {self._mesh_tolerance_mm:g} mm; choose a "
                "larger mesh_tolerance_mm"
            )
        slack = curved * self._mesh_tolerance_mm + self._slack_mm3 + rounding_mm3(self._reach_mm)
        return mesh, ExpectedGeometry(
            volume_mm3=self.volume_mm3,
            volume_slack_mm3=slack,
            size_slack_mm=self._mesh_tolerance_mm,
            relief=relief,
        )

    def _combined(self, tolerance_mm: float) -> tuple[Floats, Indices]:
        """Return the mesh of the part without its textures, with the bodies of the textures added or cut out."""
        from tacbench_cad.geometry.textured.body import Area, texture_body

        whole = manifold_of(*weld(*triangulate(self._before, tolerance_mm, ANGLE_RAD)))
        overlap_mm = OVERLAP_MM + tolerance_mm
        for result in self.results:
            for region, _, height in result.regions:
                area = Area.of_region(region, min(tolerance_mm, _OUTLINE_MM))
                other_mm = overlap_mm if self.texturing.sunk else -overlap_mm
                body = texture_body(area, height, self.texturing, result.mm_per_unit, other_mm, tolerance_mm).body
                whole = whole - body if self.texturing.sunk else whole + body
        combined = whole.simplify(_SIMPLIFY_MM).to_mesh64()
        vertices = np.asarray(combined.vert_properties, dtype=np.float64)[:, :3]
        return vertices + self._shift_mm, np.asarray(combined.tri_verts, dtype=np.int32)


def _has_free_edges(shape: TopoDS_Shape) -> bool:
    """Return whether a wall or a plane is bounded by a free curve, as below an ellipse or a spline."""
    simple = {"Plane", "Cylinder", "Cone", "Sphere", "Torus", "BSplineSurface"}
    return any(kernel.surface_kind(face) not in simple for face in kernel.each(shape, "FACE"))
