"""3MF by lib3mf: millimetres, the part's parameters as metadata, and the same bytes for the same part.

Three things of lib3mf's own output are replaced afterwards. Its vertex writer rounds in single precision, so that one
float32 coordinate in sixteen comes back as its neighbour at any setting of its precision: the vertices are written
here with the nine digits that give every float32 back. The zip container is packed again with fixed dates and order.
And all UUIDs, random by default, are derived from the part's name and parameters.
"""

from __future__ import annotations

import ctypes
import importlib.util
import io
import json
import struct
import uuid
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.formats.stl import require_finite
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.part import Part
from tacbench_cad.util.door import open_input, require_within
from tacbench_cad.util.errors import CheckFailedError, MissingToolError, one_line
from tacbench_cad.util.files import not_empty
from tacbench_cad.util.types import Floats

#: XML name space of our metadata (3MF asks for one for names that it does not define). It is a name, not a page.
NAMESPACE = "urn:tacbench-cad:2026"
#: Every zip entry's date: the earliest that a zip can hold.
ZIP_DATE = (1980, 1, 1, 0, 0, 0)
#: A model that unpacks to more than this is refused before it is read, in MB.
MAX_UNPACKED_MB = 2000
#: A model may not be this many times smaller packed than unpacked (ours are 8 to 10 times smaller).
MAX_PACKING = 200

_MODEL = "3D/3dmodel.model"


def why_missing() -> str | None:
    """Why 3MF cannot be written on this machine, or None."""
    if importlib.util.find_spec("lib3mf") is None:
        return 'lib3mf is not installed (it has no wheel for ARM Linux); elsewhere: pip install "tacbench-cad"'
    return None


def _lib3mf() -> tuple[Any, Any]:
    """The wrapper and the module of lib3mf's generated classes.

    Raises:
        MissingToolError: It is not installed or does not load.
    """
    if (reason := why_missing()) is not None:
        raise MissingToolError(f"3MF: {reason}")
    import lib3mf

    try:
        return lib3mf.get_wrapper(), lib3mf.Lib3MF
    except Exception as error:  # lib3mf raises its own class, defined in the module that failed to load
        raise MissingToolError(f"3MF: lib3mf does not load: {error}") from None


def metadata(part: Part) -> dict[str, str]:
    """What a 3MF file says of a part: one entry for each parameter of its spec; lists and tables as JSON.

    Args:
        part: The part.

    Returns:
        Texts by name, in the order of the spec.
    """
    entries = {"version": __version__, "name": part.name, "kind": part.kind}
    for key, value in part.spec.items():
        entries[str(key)] = value if isinstance(value, str) else json.dumps(value, allow_nan=False)
    return entries


def write_3mf(part: Part, path: Path) -> None:
    """Write a part's mesh as 3MF.

    Args:
        part: The part; its mesh is built if it is not yet.
        path: The file; see :func:`tacbench_cad.util.files.replacing`.

    Raises:
        MissingToolError: lib3mf is not there.
        OSError: The file cannot be written.
    """
    if part.placed:
        return write_plate([(one, (0.0, 0.0)) for one in _in_place(part)], part.name, path, kind=part.kind)
    return _write([(part, None)], part.title, metadata(part), path)


def _in_place(assembly: Part) -> list[Part]:
    """The parts of an assembly with their meshes where they are used; each use is a part of its own."""

    def transformed(part: Part, matrix: Floats) -> tuple[Mesh, ExpectedGeometry]:
        mesh, expected = part.mesh
        return mesh.transformed(matrix), expected

    names = [
        f"{part.name} in slot {i}" if part.kind == "block" else part.name for i, (part, _) in enumerate(assembly.placed)
    ]
    return [
        replace(part, name=name, make_mesh=partial(transformed, part, matrix))
        for name, (part, matrix) in zip(names, assembly.placed, strict=True)
    ]


def write_plate(placed: Sequence[tuple[Part, tuple[float, float]]], name: str, path: Path, kind: str = "plate") -> None:
    """Write several parts, each at its place on a bed, as one 3MF. The same part twice is one object.

    Args:
        placed: Parts and where their lower corner lies, in mm.
        name: The plate's name.
        path: The file; see :func:`tacbench_cad.util.files.replacing`.
        kind: What the file says that it is: ``plate`` or ``assembly``.

    Raises:
        MissingToolError: lib3mf is not there.
        OSError: The file cannot be written.
    """
    places = [[part.name, *place] for part, place in placed]
    entries = {"version": __version__, "name": name, "kind": kind, "parts": json.dumps(places)}
    _write(placed, f"{name}, {len(placed)} parts", entries, path)


def _write(
    placed: Sequence[tuple[Part, tuple[float, float] | None]], title: str, entries: dict[str, str], path: Path
) -> None:
    """Write a model of parts, each at a place or where it is."""
    wrapper, module = _lib3mf()
    identity = uuid.uuid5(uuid.NAMESPACE_URL, f"{NAMESPACE}:{json.dumps(entries, sort_keys=True)}")
    model = wrapper.CreateModel()
    model.SetUnit(module.ModelUnit.MilliMeter)
    things: dict[str, Any] = {}
    meshes: list[Mesh] = []
    for i, (part, place) in enumerate(placed):
        if part.name not in things:
            meshes.append(part.mesh[0])
            thing = things[part.name] = model.AddMeshObject()
            thing.SetName(part.name)
            thing.SetUUID(str(uuid.uuid5(identity, f"object{len(things) - 1 or ''}")))
            _set_geometry(wrapper, module, thing, meshes[-1])
        transform = wrapper.GetIdentityTransform()
        if place is not None:
            transform = wrapper.GetTranslationTransform(*place, 0.0)
        model.AddBuildItem(things[part.name], transform).SetUUID(str(uuid.uuid5(identity, f"item{i or ''}")))
    model.SetBuildUUID(str(uuid.uuid5(identity, "build")))
    group = model.GetMetaDataGroup()
    group.AddMetaData("", "Title", title, "xs:string", True)
    group.AddMetaData("", "Application", f"tacbench-cad {__version__}", "xs:string", True)
    for name, text in entries.items():
        group.AddMetaData(NAMESPACE, name, text, "xs:string", True)
    writer = model.QueryWriter("3mf")
    writer.SetStrictModeActive(True)
    writer.SetDecimalPrecision(1)  # its vertices are replaced, so they may be short
    # Not WriteToFile: where the disk is full, that ends the whole process.
    path.write_bytes(_repacked(bytes(writer.WriteToBuffer()), [mesh.vertices for mesh in meshes]))


def _set_geometry(wrapper: Any, module: Any, thing: Any, mesh: Mesh) -> None:
    """Hand over whole arrays: the wrapper's own method converts vertex by vertex in Python."""
    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float32)
    triangles = np.ascontiguousarray(mesh.faces, dtype=np.uint32)
    wrapper.checkError(
        thing,
        wrapper.lib.lib3mf_meshobject_setgeometry(
            thing._handle,
            ctypes.c_uint64(len(vertices)),
            vertices.ctypes.data_as(ctypes.POINTER(module.Position)),
            ctypes.c_uint64(len(triangles)),
            triangles.ctypes.data_as(ctypes.POINTER(module.Triangle)),
        ),
    )


def _repacked(container: bytes, vertices: Sequence[Floats]) -> bytes:
    """The container with the exact vertices of its objects in its model, packed with fixed dates and order."""
    with zipfile.ZipFile(io.BytesIO(container)) as packed:
        entries = {name: packed.read(name) for name in sorted(packed.namelist())}
    pieces, rest = [], entries[_MODEL]
    for each in vertices:
        before, _, rest = rest.partition(b"<vertices>")
        _, _, rest = rest.partition(b"</vertices>")
        pieces += [before, b"<vertices>\n", _vertex_lines(each), b"\n</vertices>"]
    entries[_MODEL] = b"".join([*pieces, rest])
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as packed:
        for name, content in entries.items():
            info = zipfile.ZipInfo(name, date_time=ZIP_DATE)
            info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 0, 0
            packed.writestr(info, content, compresslevel=6)
    return result.getvalue()


def _vertex_lines(vertices: Floats) -> bytes:
    """One XML element a vertex. Each distinct number is put into digits once: a grid has few."""
    values, index = np.unique(vertices, return_inverse=True)
    words = [f"{value:.9g}" for value in values.tolist()]
    rows = index.reshape(-1, 3).tolist()
    return "\n".join([f'<vertex x="{words[i]}" y="{words[j]}" z="{words[k]}"/>' for i, j, k in rows]).encode("ascii")


def read_3mf(path: Path) -> tuple[Mesh, dict[str, str]]:
    """Read a 3MF in strict mode, without repairing anything: everything in its build as one mesh.

    Args:
        path: The file.

    Returns:
        The mesh in mm, with a shell or more for each part, and the metadata by names without their name space.

    Raises:
        InputError: See :func:`read_parts`.
        MissingToolError: Likewise.
        CheckFailedError: Likewise.
    """
    parts, entries = read_parts(path)
    return Mesh.joined([mesh for _, mesh in parts]), entries


def read_parts(path: Path) -> tuple[list[tuple[str, Mesh]], dict[str, str]]:
    """Read each part of a 3MF's build at its place, in strict mode, without repairing anything.

    A unit other than the millimetre is converted.

    Args:
        path: The file.

    Returns:
        Name of the object (empty where it has none) and its mesh in mm, in the order of the file; and the metadata by
        names without their name space.

    Raises:
        InputError: There is no such file, or it is a folder.
        MissingToolError: lib3mf is not there.
        CheckFailedError: The file is empty, no 3MF, refused or warned of by the strict reader, or has an object
            without triangles.
    """
    wrapper, module = _lib3mf()
    _require_container(not_empty(path))
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    try:
        reader.ReadFromFile(str(path))
    except module.ELib3MFException as error:
        raise CheckFailedError(f"{path}: the strict 3MF reader refuses it: {one_line(error, 200)}") from None
    warnings = [reader.GetWarning(i)[1] for i in range(reader.GetWarningCount())]
    if warnings:
        raise CheckFailedError(f"{path}: the strict 3MF reader warns: {warnings[0]}")
    parts = _placed(path, wrapper, module, model)
    group = model.GetMetaDataGroup()
    entries = [group.GetMetaData(i) for i in range(group.GetMetaDataCount())]
    return parts, {entry.GetName(): entry.GetValue() for entry in entries}


def _require_container(path: Path) -> None:
    """Refuse what is no zip, and what would unpack to far more than a model has, before anything is unpacked."""
    try:
        with open_input(path, kind="mesh") as stream, zipfile.ZipFile(stream) as packed:
            infos = packed.infolist()
    # On a damaged directory the zip reader ends in almost any error.
    except (zipfile.BadZipFile, OSError, NotImplementedError, ValueError, struct.error, OverflowError) as error:
        raise CheckFailedError(f"{path}: this is no 3MF: {error}") from None
    if not any(info.filename.lower().endswith(".model") for info in infos):
        raise CheckFailedError(f"{path}: this zip file holds no 3MF model")
    unpacked = sum(info.file_size for info in infos)
    packed_size = sum(info.compress_size for info in infos)
    require_within("file", unpacked / 1e6, MAX_UNPACKED_MB, "MB unpacked", str(path))
    if unpacked > MAX_PACKING * max(packed_size, 10_000):
        raise CheckFailedError(f"{path}: unpacks from {packed_size} to {unpacked} bytes; no 3MF model packs like that")


_MM = {"MicroMeter": 1e-3, "MilliMeter": 1.0, "CentiMeter": 10.0, "Inch": 25.4, "Foot": 304.8, "Meter": 1000.0}


def _placed(path: Path, wrapper: Any, module: Any, model: Any) -> list[tuple[str, Mesh]]:
    """The build items with their names, at their places, in mm."""
    unit = model.GetUnit()
    factor = _MM[getattr(unit, "name", None) or module.ModelUnit(unit).name]
    parts: list[tuple[str, Mesh]] = []
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        thing = item.GetObjectResource()
        if not thing.IsMeshObject():
            raise CheckFailedError(f"{path}: holds an assembly of components; check its parts one by one")
        points, indices = _geometry(wrapper, module, model.GetMeshObjectByID(thing.GetUniqueResourceID()))
        if item.HasObjectTransform():
            fields = np.array([list(row) for row in item.GetObjectTransform().Fields])
            points = (points @ fields[:3] + fields[3]).astype(np.float32).astype(np.float64)
        require_finite(path, points)
        parts.append((thing.GetName(), Mesh(points if factor == 1.0 else points * factor, indices)))
    if not parts or not all(len(mesh.faces) for _, mesh in parts):
        raise CheckFailedError(f"{path}: the 3MF has no triangles in its build, or none in one of its objects")
    return parts


def _geometry(wrapper: Any, module: Any, thing: Any) -> tuple[Floats, Any]:
    count, facets = thing.GetVertexCount(), thing.GetTriangleCount()
    vertices, triangles = np.empty((count, 3), np.float32), np.empty((facets, 3), np.uint32)
    for array, kind, call in (
        (vertices, module.Position, wrapper.lib.lib3mf_meshobject_getvertices),
        (triangles, module.Triangle, wrapper.lib.lib3mf_meshobject_gettriangleindices),
    ):
        needed = ctypes.c_uint64(0)
        pointer = array.ctypes.data_as(ctypes.POINTER(kind))
        wrapper.checkError(thing, call(thing._handle, ctypes.c_uint64(len(array)), ctypes.byref(needed), pointer))
    return vertices.astype(np.float64), triangles.astype(np.int32)
