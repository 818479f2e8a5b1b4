"""A writer of binary STL files, and a strict reader of binary and ASCII STL files, both with NumPy.

An STL file has no units, no names except for 80 bytes in its header, and no shared vertices. The files of this project
are in millimetres. Their header contains ``tacbench-cad`` and the name of the part, but no date, so that the same part
gives the same bytes.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.files import not_empty
from tacbench_cad.util.types import Floats, Floats32, Indices
from tacbench_cad.util.untrusted import read_bytes

#: The length of the header of a binary STL, in bytes.
HEADER_BYTES = 80
#: The largest allowed absolute value of a coordinate.
MAX_MM = 1e7
_FACET = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (9,)), ("attribute", "<u2")])


def write_stl(part: PrintPart, path: Path) -> None:
    """Write a part's mesh as binary STL.

    Args:
        part: The part. Its mesh is built if necessary.
        path: The file; see :func:`tacbench_cad.util.files.replacing`.
    """
    mesh, _ = part.mesh
    with path.open("wb") as stream:
        stream.write(_header(part.name))
        stream.write(np.uint32(len(mesh.faces)).astype("<u4").tobytes())
        stream.write(_facets(mesh).view(np.uint8).data)  # unlike tofile, write reports why it fails


def _header(name: str) -> bytes:
    text = f"tacbench-cad {name}".encode("ascii", "replace")
    return text[:HEADER_BYTES].ljust(HEADER_BYTES, b"\0")


def _facets(mesh: Mesh) -> NDArray[np.void]:
    """Return the records of the file, shape (m,), with unit normals from float64 (zero for a facet without area)."""
    facets = np.empty(len(mesh.faces), dtype=_FACET)
    corners = mesh.vertices[mesh.faces.ravel()].reshape(-1, 9)
    facets["corners"] = corners
    ax, ay, az = (corners[:, 3 + i] - corners[:, i] for i in range(3))
    bx, by, bz = (corners[:, 6 + i] - corners[:, i] for i in range(3))
    nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    length[length == 0.0] = 1.0
    normal = facets["normal"]
    normal[:, 0], normal[:, 1], normal[:, 2] = nx / length, ny / length, nz / length
    facets["attribute"] = 0
    return facets


def read_stl(path: Path) -> Mesh:
    """Read a binary or an ASCII STL.

    Corners with the same float32 coordinates become one vertex. Nothing else is repaired.

    Args:
        path: The file.

    Returns:
        The mesh in the unit of the file. An STL file names no unit, but most programs use millimetres.

    Raises:
        InputError: The file does not exist, or is a folder.
        CheckFailedError: The file is empty, incomplete or not an STL, has no triangles or a wrong number of triangles,
            or has a coordinate that is not a finite number.
    """
    data = read_bytes(not_empty(path), kind="mesh")
    corners = _binary(path, data) if _is_binary(data) else None
    if corners is None:
        corners = _ascii(path, data) if _is_ascii(data) else _refuse(path, data)
    if len(corners) == 0:
        raise CheckFailedError(f"{path}: the STL has no triangles")
    require_finite(path, corners)
    return Mesh(*weld(corners))


def _is_binary(data: bytes) -> bool:
    """Check whether the length of the file agrees with the number of triangles in its header.

    This is the only reliable sign of a binary STL, because binary files can also begin with ``solid``.
    """
    return len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")


def _is_ascii(data: bytes) -> bool:
    start = data[:1024].lstrip().lower()
    return start.startswith(b"solid") and b"\0" not in data[:1024]


def _binary(path: Path, data: bytes) -> Floats32:
    facets = np.frombuffer(data, dtype=_FACET, offset=84)
    return np.ascontiguousarray(facets["corners"]).reshape(-1, 3).astype(np.float32, copy=False)


def _refuse(path: Path, data: bytes) -> Floats32:
    """Raise an error that explains why the data are not an STL."""
    for magic, kind in ((b"PK\x03\x04", "a zip or 3MF file"), (b"ISO-10303-21", "a STEP file"), (b"ply", "a PLY file")):
        if data.startswith(magic):
            raise CheckFailedError(f"{path}: this is {kind}, not an STL")
    if len(data) < 84:
        raise CheckFailedError(f"{path}: has {len(data)} bytes, but every binary STL has at least 84 bytes")
    count, room = int.from_bytes(data[80:84], "little"), (len(data) - 84) / 50.0
    if room < count and b"\0" in data[:1024]:
        raise CheckFailedError(
            f"{path}: the header states {count} triangles, but the file contains {int(room)}; "
            "the file is incomplete, its header is wrong, or it is not an STL"
        )
    raise CheckFailedError(
        f"{path}: an STL of {count} triangles has {84 + 50 * count} bytes, but the file has {len(data)}; "
        "its header is wrong, or it is not an STL"
    )


def _ascii(path: Path, data: bytes) -> Floats32:
    """Return the corners of an ASCII STL, shape (3 m, 3)."""
    text = data.lower()
    corners = [row.split() for row in re.findall(rb"(?m)^[ \t]*vertex\b(.*)$", text)]
    begun, ended = (len(re.findall(rb"(?m)^[ \t]*%s\b" % word, text)) for word in (b"facet", b"endfacet"))
    if begun != ended or not re.search(rb"(?m)^[ \t]*endsolid\b", text):
        end = (
            f"{begun} facets begin, but {ended} facets end"
            if begun != ended
            else 'the last line, "endsolid", is missing'
        )
        raise CheckFailedError(f"{path}: the ASCII STL is incomplete: {end}")
    if len(corners) != 3 * begun or any(len(corner) != 3 for corner in corners):
        raise CheckFailedError(f"{path}: the ASCII STL has {len(corners)} corners for {begun} facets")
    try:
        with np.errstate(over="ignore"):
            return np.array(corners, dtype=np.float64).reshape(-1, 3).astype(np.float32)
    except ValueError as error:
        detail = str(error)[:100]
        raise CheckFailedError(f"{path}: the ASCII STL has a coordinate that is not a number: {detail}") from None


def require_finite(path: Path, corners: NDArray[np.floating[Any]]) -> None:
    """Check that no coordinate is NaN, infinite or extremely large. Later steps, mainly manifold3d, can hang on these.

    Args:
        path: The file, for error messages.
        corners: The coordinates, shape (n, 3).

    Raises:
        CheckFailedError: A coordinate is not finite, or larger than :data:`MAX_MM`.
    """
    finite = np.isfinite(corners)
    if not finite.all():
        bad = int(np.count_nonzero(~finite.all(axis=1)))
        raise CheckFailedError(f"{path}: {bad} corners have a coordinate that is not a finite number (NaN or infinite)")
    largest = float(np.abs(corners).max(initial=0.0))
    if largest > MAX_MM:
        raise CheckFailedError(f"{path}: has a coordinate of {largest:.3g} mm; nothing printable is larger than 10 km")


def weld(corners: Floats32) -> tuple[Floats, Indices]:
    """Merge corners with equal float32 coordinates into one vertex.

    Coordinates are equal if all bits are equal; -0 counts as 0. The corners are sorted by a 64-bit hash, which is
    several times faster than sorting them by their coordinates. The slower sort is only used if two different corners
    have the same hash.

    Args:
        corners: Three rows for each triangle, shape (3 m, 3).

    Returns:
        The vertices in float64, shape (n, 3), and the triangles, shape (m, 3).
    """
    clean = np.ascontiguousarray(corners, dtype=np.float32) + np.float32(0.0)
    bits = clean.view(np.uint32).astype(np.uint64)
    with np.errstate(over="ignore"):
        key = bits[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
        key = (key + bits[:, 1]) * np.uint64(0xBF58476D1CE4E5B9)
        key ^= key >> np.uint64(32)
        key = (key + bits[:, 2]) * np.uint64(0x94D049BB133111EB)
    order = np.argsort(key)
    ordered_key, ordered = key[order], clean[order]
    fresh = np.empty(len(key), dtype=bool)
    fresh[:1] = True
    fresh[1:] = ordered_key[1:] != ordered_key[:-1]
    differs = (ordered[1:] != ordered[:-1]).any(axis=1)
    if np.any(differs & ~fresh[1:]):
        vertices, inverse = np.unique(clean, axis=0, return_inverse=True)
        return vertices.astype(np.float64), inverse.reshape(-1, 3).astype(np.int32)
    index = np.empty(len(key), dtype=np.int32)
    index[order] = np.cumsum(fresh, dtype=np.int32) - 1
    return ordered[fresh].astype(np.float64), index.reshape(-1, 3)
