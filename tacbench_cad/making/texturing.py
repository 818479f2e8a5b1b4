"""One way to put a texture on faces of any part: of CadQuery or build123d, from a STEP file, or a mesh."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.formats import format_of, step
from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.textured.result import Textured
from tacbench_cad.geometry.textured.textured_faces import face_at, faces_by, textured_faces
from tacbench_cad.geometry.texturing import texturing
from tacbench_cad.spec.sampling import TOLERANCE_MM
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.entries import load_named
from tacbench_cad.util.errors import InputError, as_input, require_between

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape


def textured(
    part: Any,
    face: Any,
    texture: Texture | str | int | Path,
    *,
    name: str | None = None,
    kind: str = "part",
    title: str = "",
    mesh_tolerance_mm: float = TOLERANCE_MM,
    scale: float = 1.0,
    spec: Mapping[str, Any] | None = None,
    **settings: Any,
) -> Textured:
    """Put a texture on one or more planar or cylindrical faces of a part.

    The faces of the solid are within ``tolerance_mm`` of the formula. The mesh of the texture is made from the formula,
    too, and not by the CAD kernel; it is within ``mesh_tolerance_mm``. The part keeps its coordinates.

    Args:
        part: A part of CadQuery, build123d or Open CASCADE with one solid in mm, a STEP, STL or 3MF file, a
            :class:`~tacbench_cad.Mesh`, a ``Manifold`` of manifold3d, or an object with ``vertices`` and ``faces``, for
            example of trimesh.
        face: A face of the part, several faces, a point on a face, or a selector of CadQuery such as ``">Z"``. On a
            mesh, a point on the flat or cylindrical region: all connected triangles on the same plane or cylinder,
            within 0.005 mm.
        texture: A texture, the number or name of one of the six, the name of a later one, or a TOML file.
        name: The name of the part in its files; None for the name of the file, or ``part``.
        kind: The kind of part, a word of your own.
        title: A description for people, in one line.
        mesh_tolerance_mm: The largest distance of the mesh from the formula.
        scale: The millimetres for each unit of a mesh; 25.4 for inches.
        spec: The input values of the part, as plain JSON values, for the manifest.
        **settings: The other settings of :class:`~tacbench_cad.geometry.texturing.Texturing`: ``depth_mm``,
            ``margin_mm``, ``fade_mm``, ``up``, ``sunk``, ``base_mm``, ``mm_per_unit`` and ``tolerance_mm``.

    Raises:
        InputError: The part cannot be read, a face is neither planar nor cylindrical, or a setting is not allowed.
        CheckFailedError: The result is not closed, or does not have the volume of the integral of the formula.
        MissingToolError: The part is a mesh, and the extension ``foreign_meshes`` is not installed.
    """
    require_between("mesh_tolerance_mm", mesh_tolerance_mm, 1e-4, 10.0, " mm")
    require_between("scale", scale, 1e-6, 1e6)
    own = texturing(texture, **settings)
    is_file = isinstance(part, (str, Path))
    word = name or (part_name(Path(part)) if is_file else "part")
    names = (word, kind, title or f"{word} with {own.texture.name}")
    values = {**(spec or {}), **settings, "texture": own.texture.name}
    if (format_of(Path(part)).shape == "mesh") if is_file else not kernel.is_shape(part):
        on_mesh = load_named("tacbench.texturing", "part", "mesh")
        result: Textured = on_mesh(part, face, own, mesh_tolerance_mm, scale, names, values)
        return result
    if scale != 1.0:
        raise InputError("scale", scale, "must be 1 for a STEP file and other solids, because their unit is known")
    shape = _solid_of(Path(part)) if is_file else kernel.shape_of(part, "part")
    return textured_faces(shape, _faces(shape, face), own, mesh_tolerance_mm, names, values)


def _solid_of(path: Path) -> TopoDS_Shape:
    with as_input("file"):
        step.require_readable(path)
        return step.read_step(path)


def _faces(shape: TopoDS_Shape, face: Any) -> Sequence[TopoDS_Shape]:
    """Return the faces of a shape that a user names."""
    if isinstance(face, str):
        face = faces_by(shape, face)
    elif hasattr(face, "vals"):
        face = face.vals()
    several = list(face) if isinstance(face, Sequence) else [face]
    if several and all(isinstance(number, (int, float)) for number in several):
        return [face_at(shape, several)]
    if not several:
        raise InputError("face", None, "must be a face of the part; select at least one")
    return [kernel.shape_of(item, "face") for item in several]


def part_name(path: Path) -> str:
    """Return a name for a part that is allowed in its files."""
    return re.sub(r"[^A-Za-z0-9 ._+-]", "_", path.stem).lstrip(" ._+-") or "part"
