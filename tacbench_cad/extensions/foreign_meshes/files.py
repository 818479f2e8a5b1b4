"""A texture on a mesh from a file of anybody: read the mesh, texture it, and write it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.checks import read_mesh
from tacbench_cad.extensions.foreign_meshes.on_mesh import TexturedMesh, texture_on_mesh
from tacbench_cad.formats import format_of, read_foreign_mesh, read_stl
from tacbench_cad.geometry import ExpectedGeometry, Mesh, PrintPart, texturing
from tacbench_cad.making import part_name
from tacbench_cad.spec import TOLERANCE_MM, Texture
from tacbench_cad.util.errors import CheckFailedError, InputError, as_input, require_between
from tacbench_cad.util.files import replacing


def textured_mesh(
    mesh: Any, at: Sequence[float], texture: Texture | str | int | Path, *, scale: float = 1.0, **settings: Any
) -> TexturedMesh:
    """Put a texture on the flat or cylindrical region of a mesh around a point.

    The region consists of the connected triangles that lie on the same plane or cylinder as the triangle at the point,
    within 0.005 mm. The rest of the mesh stays as it is.

    Args:
        mesh: An STL or 3MF file, a :class:`~tacbench_cad.Mesh`, a ``Manifold`` of manifold3d, or an object with
            ``vertices`` and ``faces``, for example of trimesh.
        at: A point on the region, in mm.
        texture: A texture, the number or name of one of the six, or a TOML file.
        scale: The millimetres for each unit of the mesh.
        **settings: ``depth_mm``, ``margin_mm``, ``fade_mm``, ``up``, ``sunk``, ``base_mm``, ``mm_per_unit`` and
            ``tolerance_mm``; see :class:`~tacbench_cad.geometry.texturing.Texturing`. The default of ``tolerance_mm``
            is 0.01.

    Raises:
        InputError: The mesh is not closed or probably not in mm, the region is neither flat nor cylindrical, or a
            setting is not allowed for it.
        CheckFailedError: The result is not closed.
    """
    require_between("scale", scale, 1e-6, 1e6)
    name = "mesh"
    if isinstance(mesh, (str, Path)):
        name = str(mesh)
        own = _read(Path(mesh))
    elif isinstance(mesh, Mesh):
        own = mesh
    elif hasattr(mesh, "to_mesh64"):
        raw = mesh.to_mesh64()
        own = Mesh(np.array(raw.vert_properties)[:, :3], np.array(raw.tri_verts, dtype=np.int32))
    elif hasattr(mesh, "vertices") and hasattr(mesh, "faces"):
        own = Mesh(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int32))
    else:
        raise InputError("mesh", mesh, "must be an STL or 3MF file, or an object with vertices and faces")
    if scale != 1.0:
        own = Mesh(own.vertices * scale, own.faces)
    return texture_on_mesh(own, at, texturing(texture, **{"tolerance_mm": TOLERANCE_MM, **settings}), name)


def _read(path: Path) -> Mesh:
    """Read a mesh. Files of other programs that break a rule of 3MF are read as well."""
    form = format_of(path)
    if form.shape != "mesh":
        raise InputError("mesh", str(path), "must be an STL or 3MF file")
    with as_input("file"):
        if form.name == "3mf":
            return read_foreign_mesh(path)
        return read_stl(path)


def write_textured_mesh(result: TexturedMesh, path: Path | str) -> Path:
    """Write a textured mesh as STL or 3MF, and read it back. The file keeps the coordinates of the part.

    Args:
        result: The mesh.
        path: The file. Its ending determines the format.

    Returns:
        The path.

    Raises:
        InputError: The ending is unknown, or the folder cannot be written.
        CheckFailedError: The file does not contain the mesh.
    """
    path = Path(path)
    form = format_of(path)
    if form.shape != "mesh":
        raise InputError("output file", str(path), "must end in .stl or .3mf, because the part is a mesh")
    mesh, settings = result.mesh, result.texturing
    low, high = mesh.bounds_mm
    x, y, z = (high - low).tolist()
    spec = {"texture": settings.texture.name, "depth_mm": result.depth_mm, "margin_mm": settings.margin_mm}
    part = PrintPart(
        name=part_name(path),
        kind="part",
        title=f"{path.stem} with {settings.texture.name}",
        size_mm=(x, y, z),
        genus=0,
        make_mesh=lambda: (mesh, ExpectedGeometry(volume_mm3=result.volume_mm3, volume_slack_mm3=0.0)),
        make_solid=None,
        spec=spec,
    )
    with replacing(path) as temporary:
        form.write(part, temporary)
        back = read_mesh(temporary)
        if len(back.faces) != len(mesh.faces) or abs(back.volume_mm3 - mesh.volume_mm3) > 1e-6 * mesh.volume_mm3:
            raise CheckFailedError(f"{path}: the file does not contain the mesh that was written")
    return path
