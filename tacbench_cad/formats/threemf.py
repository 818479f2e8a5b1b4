"""3MF files by lib3mf: millimetres, and the part's parameters as metadata. The same part gives the same bytes.

Four things differ from the usual output of lib3mf:

- The vertices are written with nine digits, which preserve every float32 value. The writer of lib3mf rounds in single
  precision: with any setting of its precision, one float32 coordinate in sixteen is read back as a neighbouring value.
- The positions of parts on a plate are written with nine digits, and not with six.
- The zip container has fixed dates and a fixed order.
- All UUIDs are derived from the name and the parameters of the part. By default, they are random.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import io
import json
import re
import struct
import uuid
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.formats.stl import require_finite
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.storage import packed_blocks
from tacbench_cad.util.errors import CheckFailedError, MissingToolError, one_line
from tacbench_cad.util.files import not_empty
from tacbench_cad.util.processes import read_isolated
from tacbench_cad.util.types import Floats
from tacbench_cad.util.untrusted import open_input, require_within

#: The XML namespace of this project's metadata. 3MF requires a namespace for names that it does not define. It is only
#: a name, not the address of a page.
NAMESPACE = "urn:tacbench-cad:2026"
#: The date of every zip entry: the earliest date that a zip file can store.
ZIP_DATE = (1980, 1, 1, 0, 0, 0)
#: The largest allowed size of an unpacked model, in MB. It is checked before the model is read.
MAX_UNPACKED_MB = 2000
#: The largest allowed number of components of an object, if each component is replaced by its own components.
MAX_COMPONENTS = 100_000
#: The time limit of the reader for an untrusted file, in s, and the additional time for each MB of the file. The memory
#: limit and the additional memory for each MB, in MB.
LIMITS_S, LIMITS_MB = (60.0, 20.0), (2000.0, 100.0)
#: The largest allowed ratio of unpacked to packed size. Files of this project have ratios of 8 to 10.
MAX_PACKING = 200

#: The length of the pieces in which a model is searched for components, in bytes.
_CHUNK_BYTES = 1 << 20
_MODEL = "3D/3dmodel.model"
#: The name of the metadata with the packed blocks in the file. lib3mf refuses a text of 64 KB or more, so a longer one
#: continues in ``blocks1``, ``blocks2`` and so on.
BLOCKS, _MAX_TEXT = "blocks", 50_000
#: The beginning of an object with its attributes, or of one of its components.
_TAG = re.compile(rb"<(?:[\w.-]+:)?(object|component)\b([^>]*)")
_ID, _OBJECT_ID = (re.compile(rb"(?:^|\s)%s\s*=\s*[\"']\s*(\d{1,20})" % name) for name in (b"id", b"objectid"))


def why_missing() -> str | None:
    """Return the reason why this machine cannot write 3MF files, or None if it can."""
    if importlib.util.find_spec("lib3mf") is None:
        return 'lib3mf is not installed: pip install "tacbench-cad" (there is no lib3mf package for Linux on ARM)'
    return None


def _lib3mf() -> tuple[Any, Any]:
    """Return the wrapper of lib3mf and the module of its generated classes.

    Raises:
        MissingToolError: lib3mf is not installed, or does not load.
    """
    if (reason := why_missing()) is not None:
        raise MissingToolError(f"3MF: {reason}")
    import lib3mf

    try:
        return lib3mf.get_wrapper(), lib3mf.Lib3MF
    except Exception as error:  # lib3mf raises its own class, defined in the module that failed to load
        raise MissingToolError(f"3MF: lib3mf does not load: {error}") from None


def metadata(part: PrintPart) -> dict[str, str]:
    """Return the metadata of a part's 3MF file, with one entry for each parameter of the part's spec.

    Args:
        part: The part.

    Returns:
        Strings by name, in the order of the spec. Lists and tables are written as JSON.
    """
    entries = {"version": __version__, "name": part.name, "kind": part.kind}
    for key, value in part.spec.items():
        entries[str(key)] = value if isinstance(value, str) else json.dumps(value, allow_nan=False)
    return entries


def write_3mf(part: PrintPart, path: Path) -> None:
    """Write a part's mesh as 3MF.

    Args:
        part: The part. Its mesh is built if necessary.
        path: The file; see :func:`tacbench_cad.util.files.replacing`.

    Raises:
        MissingToolError: lib3mf is not available.
        OSError: The file cannot be written.
    """
    if part.placed:
        return write_plate([(use, (0.0, 0.0)) for use in _in_place(part)], part.name, path, kind=part.kind)
    return _write([(part, None)], part.title, metadata(part), path)


def _in_place(assembly: PrintPart) -> list[PrintPart]:
    """Return one part for each use of a part in an assembly, with its mesh in the assembly's frame."""

    def transformed(part: PrintPart, matrix: Floats) -> tuple[Mesh, ExpectedGeometry]:
        mesh, expected = part.mesh
        return mesh.transformed(matrix), expected

    names = [
        f"{part.name} in slot {i}" if part.kind == "block" else part.name for i, (part, _) in enumerate(assembly.placed)
    ]
    return [
        replace(part, name=name, make_mesh=partial(transformed, part, matrix))
        for name, (part, matrix) in zip(names, assembly.placed, strict=True)
    ]


def write_plate(
    placed: Sequence[tuple[PrintPart, tuple[float, float]]], name: str, path: Path, kind: str = "plate"
) -> None:
    """Write several parts at their positions on a bed as one 3MF file.

    If a part occurs twice, the file has one object for it, which is used twice.

    Args:
        placed: The parts, each with the x and y of its lower corner, in mm.
        name: The name of the plate.
        path: The file; see :func:`tacbench_cad.util.files.replacing`.
        kind: The kind that the file states in its metadata: ``plate`` or ``assembly``.

    Raises:
        MissingToolError: lib3mf is not available.
        OSError: The file cannot be written.
    """
    places = [[part.name, *place] for part, place in placed]
    entries = {"version": __version__, "name": name, "kind": kind, "parts": json.dumps(places)}
    _write(placed, f"{name}, {len(placed)} parts", entries, path)


def _write(
    placed: Sequence[tuple[PrintPart, tuple[float, float] | None]], title: str, entries: dict[str, str], path: Path
) -> None:
    """Write a model of parts, each with its position on the bed, or None if the part is not moved."""
    wrapper, module = _lib3mf()
    blocks = {part.name: part.block for part, _ in placed if part.block is not None}
    packed = packed_blocks(blocks) if blocks else ""
    for number, begin in enumerate(range(0, len(packed), _MAX_TEXT)):
        entries = {**entries, f"{BLOCKS}{number or ''}": packed[begin : begin + _MAX_TEXT]}
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
    writer.SetDecimalPrecision(1)  # the vertices are replaced later, so a low precision is faster
    # Do not use WriteToFile: it terminates the process if the disk is full.
    places = [place for _, place in placed]
    path.write_bytes(_repacked(bytes(writer.WriteToBuffer()), [mesh.vertices for mesh in meshes], places))


def _set_geometry(wrapper: Any, module: Any, thing: Any, mesh: Mesh) -> None:
    """Pass whole arrays to lib3mf. The method of the wrapper would convert each vertex in Python."""
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


def _repacked(container: bytes, vertices: Sequence[Floats], places: Sequence[tuple[float, float] | None]) -> bytes:
    """Repack a container with the exact vertices of its objects, with fixed dates and a fixed order.

    The positions of its items are also exact. lib3mf writes six digits, which move a block by up to 0.0005 mm.
    """
    rest_of_places = iter(places)

    def exact(item: re.Match[bytes]) -> bytes:
        place = next(rest_of_places)
        if place is None:
            return item[0]
        return re.sub(rb'(transform="1 0 0 0 1 0 0 0 1) [^"]*', rb"\1 %.9g %.9g 0" % place, item[0])

    with zipfile.ZipFile(io.BytesIO(container)) as packed:
        entries = {name: packed.read(name) for name in sorted(packed.namelist())}
    pieces, rest = [], entries[_MODEL]
    for points in vertices:
        before, _, rest = rest.partition(b"<vertices>")
        _, _, rest = rest.partition(b"</vertices>")
        pieces += [before, b"<vertices>\n", _vertex_lines(points), b"\n</vertices>"]
    entries[_MODEL] = b"".join([*pieces, re.sub(rb"<item\b[^>]*>", exact, rest)])
    result = io.BytesIO()
    with zipfile.ZipFile(result, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as packed:
        for name, content in entries.items():
            info = zipfile.ZipInfo(name, date_time=ZIP_DATE)
            info.compress_type, info.create_system, info.external_attr = zipfile.ZIP_DEFLATED, 0, 0
            packed.writestr(info, content, compresslevel=6)
    return result.getvalue()


def _vertex_lines(vertices: Floats) -> bytes:
    """Return one XML element for each vertex. Each distinct number is formatted only once, because a grid has few."""
    values, index = np.unique(vertices, return_inverse=True)
    words = [f"{value:.9g}" for value in values.tolist()]
    rows = index.reshape(-1, 3).tolist()
    return "\n".join([f'<vertex x="{words[i]}" y="{words[j]}" z="{words[k]}"/>' for i, j, k in rows]).encode("ascii")


def read_3mf(path: Path) -> tuple[Mesh, dict[str, str]]:
    """Read all parts in the build of a 3MF file as one mesh, without repairs.

    Args:
        path: The file.

    Returns:
        The mesh in mm, with at least one shell for each part, and the metadata by names without their namespace.

    Raises:
        InputError: Same as for :func:`read_parts`.
        MissingToolError: Same as for :func:`read_parts`.
        CheckFailedError: Same as for :func:`read_parts`.
    """
    parts, entries = read_parts(path)
    return Mesh.joined([mesh for _, mesh in parts]), entries


def read_parts(path: Path, strict: bool = True) -> tuple[list[tuple[str, Mesh]], dict[str, str]]:
    """Read each part in the build of a 3MF file at its position, without repairs.

    Units other than the millimetre are converted.

    Args:
        path: The file.
        strict: Whether a file is refused that breaks a rule of the format, also where this does not affect its meshes.

    Returns:
        The name of each object (empty if it has none) with its mesh in mm, in the order of the file. And the metadata
        by names without their namespace.

    Raises:
        InputError: The file does not exist, or is a folder.
        MissingToolError: lib3mf is not available.
        CheckFailedError: The file is empty or not a 3MF, the strict reader refuses it or reports a warning, or an
            object has no triangles.
    """
    wrapper, module = _lib3mf()
    _require_container(not_empty(path))
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(strict)
    try:
        reader.ReadFromFile(str(path))
    except module.ELib3MFException as error:
        raise CheckFailedError(
            f"{path}: the {'strict ' if strict else ''}3MF reader refuses it: {one_line(error, 200)}"
        ) from None
    warnings = [reader.GetWarning(i)[1] for i in range(reader.GetWarningCount())]
    if warnings and strict:
        raise CheckFailedError(f"{path}: the strict 3MF reader warns: {warnings[0]}")
    parts = _placed(path, wrapper, module, model)
    group = model.GetMetaDataGroup()
    entries = [group.GetMetaData(i) for i in range(group.GetMetaDataCount())]
    return parts, {entry.GetName(): entry.GetValue() for entry in entries}


def read_untrusted(path: Path, strict: bool = True) -> tuple[list[tuple[str, Mesh]], dict[str, str]]:
    """Same as :func:`read_parts`, but in a child process with limits of time and memory.

    Raises:
        InputError: Same as for :func:`read_parts`, or the file exceeds a limit.
        MissingToolError: Same as for :func:`read_parts`.
        CheckFailedError: Same as for :func:`read_parts`.
    """
    parts: tuple[list[tuple[str, Mesh]], dict[str, str]] = read_isolated(
        path, "the 3MF reader", LIMITS_S, read_parts, path, strict, limits_mb=LIMITS_MB
    )
    return parts


def read_foreign_mesh(path: Path) -> Mesh:
    """Read a 3MF file of any program as one mesh, not strictly; same errors as :func:`read_untrusted`."""
    return Mesh.joined([mesh for _, mesh in read_untrusted(path, strict=False)[0]])


def _require_container(path: Path) -> None:
    """Check that a file is a zip container, would not unpack to an extreme size, and has no extreme nesting."""
    with _zip_errors(path), open_input(path, kind="mesh") as stream, zipfile.ZipFile(stream) as packed:
        infos = packed.infolist()
        _require_bounded(path, infos)
        components = _expanded(packed, infos)
    require_within("file", components, MAX_COMPONENTS, "components in one object", str(path))


@contextlib.contextmanager
def _zip_errors(path: Path) -> Iterator[None]:
    """Replace errors of the zip reader, which can raise almost any error if a container is damaged."""
    try:
        yield
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        RuntimeError,  # encrypted
        ValueError,
        struct.error,
        OverflowError,
    ) as error:
        raise CheckFailedError(f"{path}: this is not a 3MF: {error}") from None


def _require_bounded(path: Path, infos: Sequence[zipfile.ZipInfo]) -> None:
    if not any(info.filename.lower().endswith(".model") for info in infos):
        raise CheckFailedError(f"{path}: this zip file contains no 3MF model")
    unpacked = sum(info.file_size for info in infos)
    packed_size = sum(info.compress_size for info in infos)
    require_within("file", unpacked / 1e6, MAX_UNPACKED_MB, "MB unpacked", str(path))
    if unpacked > MAX_PACKING * max(packed_size, 10_000):
        raise CheckFailedError(
            f"{path}: would unpack from {packed_size} to {unpacked} bytes; a 3MF model may be at most {MAX_PACKING} "
            "times as large unpacked"
        )


def _expanded(packed: zipfile.ZipFile, infos: Sequence[zipfile.ZipInfo]) -> int:
    """Return the largest number of components of an object, with the components of its components.

    lib3mf follows each of them: an object with eleven levels of ten components each would occupy it for minutes. An
    object can only have components that the file defines before it.
    """
    counts: dict[bytes, int] = {}
    models = [info for info in infos if info.filename.lower().endswith(".model")]
    for info in sorted(models, key=lambda info: info.filename == _MODEL):  # the others define objects for this one
        number, rest = b"", b""
        with packed.open(info) as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                rest += chunk
                end = rest.rfind(b"<")
                for tag in _TAG.finditer(rest, 0, max(end, 0)):
                    name = (_ID if tag[1] == b"object" else _OBJECT_ID).search(tag[2])
                    if name is not None and tag[1] == b"object":
                        number = name[1]
                        counts[number] = 0
                    elif name is not None and number:
                        counts[number] += max(1, counts.get(name[1], 0))
                rest = rest[end:] if len(rest) - end < _CHUNK_BYTES else b""
    return max(counts.values(), default=0)


_MM = {"MicroMeter": 1e-3, "MilliMeter": 1.0, "CentiMeter": 10.0, "Inch": 25.4, "Foot": 304.8, "Meter": 1000.0}


def _placed(path: Path, wrapper: Any, module: Any, model: Any) -> list[tuple[str, Mesh]]:
    """Return the names and the meshes of the build items, at their positions, in mm."""
    unit = model.GetUnit()
    factor = _MM[getattr(unit, "name", None) or module.ModelUnit(unit).name]
    parts: list[tuple[str, Mesh]] = []
    items = model.GetBuildItems()
    while items.MoveNext():
        item = items.GetCurrent()
        thing = item.GetObjectResource()
        if not thing.IsMeshObject():
            raise CheckFailedError(f"{path}: contains an assembly of components; check each of its parts separately")
        points, indices = _geometry(wrapper, module, model.GetMeshObjectByID(thing.GetUniqueResourceID()))
        if item.HasObjectTransform():
            fields = np.array([list(row) for row in item.GetObjectTransform().Fields])
            points = points @ fields[:3] + fields[3]
        require_finite(path, points)
        parts.append((thing.GetName(), Mesh(points if factor == 1.0 else points * factor, indices)))
    if not parts or not all(len(mesh.faces) for _, mesh in parts):
        raise CheckFailedError(f"{path}: the build of the 3MF is empty, or one of its objects has no triangles")
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
