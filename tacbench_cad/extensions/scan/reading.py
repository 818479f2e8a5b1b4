"""Reading of scans: meshes, point clouds and height maps, in mm and without invalid points."""

from __future__ import annotations

import codecs
import io
import itertools
import math
import re
import struct
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tacbench_cad.extensions.scan.cloud import Cloud, HeightGrid
from tacbench_cad.formats import read_foreign_mesh, read_stl
from tacbench_cad.spec import PICTURES, TABLES, read_heights
from tacbench_cad.util.errors import InputError, as_input, one_line, one_of
from tacbench_cad.util.numbers import layout, read_numbers
from tacbench_cad.util.packages import require
from tacbench_cad.util.processes import read_isolated
from tacbench_cad.util.text import counted, short
from tacbench_cad.util.types import Bools, Floats, Ints
from tacbench_cad.util.untrusted import open_input, read_bytes, require_within

Unit = Literal["um", "mm", "m", "inch"]
#: The millimetres of each unit.
UNITS: Mapping[str, float] = {"um": 1e-3, "mm": 1.0, "m": 1000.0, "inch": 25.4}
#: The allowed numbers of points. Fewer points say nothing about a texture.
MIN_POINTS, MAX_POINTS = 500, 20_000_000
#: A mesh with fewer vertices gets this number of points, evenly on its triangles. The vertices of other meshes are the
#: points that the scanner measured.
MIN_VERTICES, SAMPLED_POINTS = 50_000, 200_000
#: The endings of meshes, and of point clouds.
MESHES, CLOUDS = (".stl", ".3mf", ".ply", ".obj"), (".xyz", ".pts", ".las", ".laz")
#: The largest number of columns of a table of points: coordinates, normal, colour and brightness.
_MAX_COLUMNS = 10
_AXES = ("x", "y", "z")
#: The time limit of the reader of LAS files in s, and the additional time for each MB of the file; the same for the
#: memory in MB.
LAS_LIMITS_S, LAS_LIMITS_MB = (60.0, 10.0), (2000.0, 40.0)
#: The length of the header, the beginning of the points and the number of records, within the header of a LAS file; the
#: length of the smallest record.
_LAS_HEADER, _LAS_RECORD_BYTES = struct.Struct("<94xHII"), 54


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanFile:
    """A scan as it was read.

    Args:
        cloud: The points.
        kind: The kind of file.
        unit: The unit of the file.
        dropped: The number of points that were left out because they are not finite, or are a row of zeros.
        notes: Sentences that a reader of the result should know.
    """

    cloud: Cloud
    kind: Literal["mesh", "points", "height map"]
    unit: str
    dropped: int = 0
    notes: tuple[str, ...] = ()


def read_scan(
    path: Path,
    *,
    unit: Unit | None = None,
    mm_per_pixel: float | None = None,
    size_mm: tuple[float, float, float] | None = None,
) -> ScanFile:
    """Read a scan.

    - Meshes: STL, 3MF, PLY, OBJ. A mesh with few vertices is sampled evenly on its triangles.
    - Point clouds: PLY and OBJ without faces, XYZ, PTS, LAS, LAZ, and tables (ASC, CSV, TXT) whose header names x, y
      and z, or that have at most ten columns and begin with x, y and z.
    - Height maps: TIFF, NPY, tables with more columns, and the files of instruments that the package surfalize reads.

    Args:
        path: The file.
        unit: The unit of the coordinates, or of the heights of a height map. It is needed unless the file names one. A
            height map of whole numbers has one unit for each level. A value far from all other heights, such as
            -9999, stands for pixels that are not measured.
        mm_per_pixel: The distance of neighbouring pixels. A height map needs it unless the file contains it. Other
            scans ignore it.
        size_mm: The sides and the height of the block. If given, a scan whose size is wrong by the ratio of two units
            is refused.

    Raises:
        InputError: The file cannot be read, names no unit, or has too few points, or its unit is wrong.
        MissingToolError: The package for this kind of file is not installed.
    """
    if unit is not None:
        one_of("--unit", unit, UNITS)
    if mm_per_pixel is not None and not 0.0 < mm_per_pixel < math.inf:
        raise InputError("--mm-per-pixel", mm_per_pixel, "must be above 0")
    simulated = _is_simulated(path)
    if simulated and unit is None:
        unit = "mm"
    suffix = path.suffix.lower()
    with as_input("scan"):  # the strict readers check the files of this project
        if suffix in MESHES:
            scan = _mesh(path, suffix, unit, size_mm)
        elif suffix in (".las", ".laz"):
            scan = _points(path, _las(path), unit, size_mm)
        elif suffix in (".xyz", ".pts") or (suffix in (".asc", ".csv", ".txt") and _is_table_of_points(path)):
            scan = _points(path, read_numbers(path, "scan", "any", _AXES), unit, size_mm)
        else:
            scan = _height_map(path, unit, mm_per_pixel, size_mm)
    if len(scan.cloud) < MIN_POINTS:
        allowed = f"has {counted(len(scan.cloud), 'valid point')}, but a scan needs at least {MIN_POINTS}"
        raise InputError("scan", str(path), allowed)
    return replace(scan, cloud=replace(scan.cloud, simulated=simulated))


def _is_simulated(path: Path) -> bool:
    """Check whether a comment at the beginning of a file says that it contains a simulated scan."""
    with open_input(path, "scan", "any") as stream:
        return re.search(rb"(?m)^(comment|#|//) simulated scan", stream.read(2000)) is not None


def _mesh(path: Path, suffix: str, unit: Unit | None, size_mm: tuple[float, float, float] | None) -> ScanFile:
    if suffix in (".stl", ".3mf"):
        mesh = read_stl(path) if suffix == ".stl" else read_foreign_mesh(path)
        vertices, faces = mesh.vertices, np.asarray(mesh.faces, dtype=np.int64)
        unit = "mm" if suffix == ".3mf" and unit is None else unit  # the reader of 3MF files converts to mm
    else:
        vertices, faces = _ply(path) if suffix == ".ply" else _obj(path)
    if not len(faces):
        return _points(path, vertices, unit, size_mm)
    if not 0 <= faces.min() <= faces.max() < len(vertices):
        raise _unreadable(path, "a triangle has a vertex that does not exist")
    require_within("scan", len(vertices), MAX_POINTS, "vertices", str(path))
    finite: Bools = np.all(np.isfinite(vertices), axis=1)
    faces = faces[finite[faces].all(axis=1)]
    is_fine = np.count_nonzero(finite) >= MIN_VERTICES
    points, notes = _converted(path, vertices[finite] if is_fine else _sampled(path, vertices, faces), unit, size_mm)
    if not is_fine:
        notes += (
            f"The mesh has {len(vertices):,} vertices, so {len(points):,} points were taken evenly from its triangles. "
            "Points on one triangle are not independent, so the intervals are too short.",
        )
    cloud = Cloud(points_mm=points, source=path.name)
    dropped = int(np.count_nonzero(~finite))
    return ScanFile(cloud=cloud, kind="mesh", unit=unit or "mm", dropped=dropped, notes=notes)


def _ply(path: Path) -> tuple[Floats, Ints]:
    """Return the vertices and the faces of a PLY file; no faces for a cloud."""
    require(f"{path}: a scan of this kind", "trimesh")
    import trimesh

    data = read_bytes(path, "scan", "mesh")
    head = data[:100_000].partition(b"end_header")[0]
    stated = {word: int(count) for word, count in re.findall(rb"(?m)^element[ \t]+(\w+)[ \t]+(\d{1,18})\s", head)}
    options: dict[str, Any] = {"process": False, "skip_materials": True, "fix_texture": False}
    try:
        (body,) = trimesh.load_scene(io.BytesIO(data), file_type="ply", **options).geometry.values()
        vertices = np.asarray(body.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(getattr(body, "faces", ()), dtype=np.int64).reshape(-1, 3)
        for name, plural, rows in ((b"vertex", "vertices", vertices), (b"face", "faces", faces)):
            if len(rows) < stated.get(name, 0):
                raise ValueError(f"the header states {stated[name]:,} {plural}, but {len(rows):,} could be read")
        return vertices, faces
    except Exception as error:  # a damaged file can raise almost any error
        raise _unreadable(path, error) from None


def _obj(path: Path) -> tuple[Floats, Ints]:
    """Return the vertices and the faces of an OBJ file; no faces for a cloud. A polygon becomes a fan of triangles."""
    data = read_bytes(path, "scan", "mesh").removeprefix(codecs.BOM_UTF8)
    # without comments, the numbers of texture coordinates and normals, and line ends that a backslash cancels
    lines = re.sub(rb"#.*|/\S*|\\\r?\n", b" ", data).splitlines()
    coordinates, indices = array("d"), array("q")
    words: list[bytes] = []
    try:
        for words in map(bytes.split, lines):
            if words[:1] == [b"v"]:
                x, y, z = map(float, words[1:4])
                coordinates.extend((x, y, z))
            elif words[:1] == [b"f"]:
                after = len(coordinates) // 3 + 1  # a negative index counts backwards from the last vertex so far
                first, *others = (index if index > 0 else after + index for index in map(int, words[1:]))
                for second, third in itertools.pairwise(others):
                    indices.extend((first, second, third))
    except (ValueError, OverflowError) as error:
        raise _unreadable(path, f'the line "{b" ".join(words)[:60].decode("utf-8", "replace")}": {error}') from None
    return np.frombuffer(coordinates).reshape(-1, 3), np.frombuffer(indices, np.int64).reshape(-1, 3) - 1


def _unreadable(path: Path, error: Exception | str) -> InputError:
    detail = one_line(error, 200).rstrip(".!") or type(error).__name__
    allowed = f"cannot be read: {detail}; export it again, for example as a binary STL"
    return InputError("scan", str(path), allowed)


def _sampled(path: Path, vertices: Floats, faces: Ints) -> Floats:
    """Return points evenly on triangles. The same mesh gives the same points."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    if not area.sum() > 0.0:
        raise InputError("scan", str(path), "the triangles of the mesh have no area")
    rng = np.random.default_rng(0)
    steps = (np.arange(SAMPLED_POINTS) + rng.random(SAMPLED_POINTS)) / SAMPLED_POINTS
    chosen = np.minimum(np.searchsorted(np.cumsum(area) / area.sum(), steps), len(faces) - 1)
    s, t = rng.random((2, SAMPLED_POINTS, 1))
    root = np.sqrt(s)
    return np.asarray((1.0 - root) * a[chosen] + root * (1.0 - t) * b[chosen] + root * t * c[chosen])


def _points(path: Path, points: Floats, unit: Unit | None, size_mm: tuple[float, float, float] | None) -> ScanFile:
    require_within("scan", len(points), MAX_POINTS, "points", str(path))
    valid = np.isfinite(points).all(axis=1) & np.any(points != 0.0, axis=1)
    kept = points[valid]
    converted, notes = _converted(path, kept, unit, size_mm)
    cloud = Cloud(points_mm=converted, source=path.name)
    return ScanFile(cloud=cloud, kind="points", unit=unit or "mm", dropped=len(points) - len(kept), notes=notes)


def _las(path: Path) -> Floats:
    """Return the points of a LAS or LAZ file. A child process reads it, because laspy believes any number in it."""
    require(f"{path}: a scan of this kind", "laspy")
    points: Floats = read_isolated(path, "laspy", LAS_LIMITS_S, read_las, path, limits_mb=LAS_LIMITS_MB)
    return points


def read_las(path: Path) -> Floats:
    """Read the points of a LAS or LAZ file; called in a child process. Same errors as :func:`read_scan`."""
    import laspy

    with open_input(path, "scan", "mesh") as stream:
        try:
            _require_las(stream.read(_LAS_HEADER.size), stream.seek(0, io.SEEK_END))
            stream.seek(0)
            with laspy.open(stream) as reader:
                stated = reader.header.point_count
                require_within("scan", stated, MAX_POINTS, "points", str(path))
                points = np.asarray(reader.read().xyz, dtype=np.float64)
            if len(points) < stated:
                raise ValueError(f"the header states {stated:,} points, but {len(points):,} could be read")
            return points
        except (InputError, MemoryError):
            raise
        except Exception as error:  # a damaged file can raise almost any error; .laz needs one more package
            raise _unreadable(path, error) from None


def _require_las(header: bytes, size: int) -> None:
    """Check that the tables that a LAS header states have room in the file. laspy reads them without looking."""
    if len(header) < _LAS_HEADER.size:
        return  # laspy says so
    length, points_at, records = _LAS_HEADER.unpack(header)
    if not length + _LAS_RECORD_BYTES * records <= points_at <= size:
        raise ValueError(f"the header states {records:,} records before byte {points_at:,} of {size:,}")


def _is_table_of_points(path: Path) -> bool:
    """Check whether a table lists points and no heights: its header names x, y and z, or it has few columns."""
    with open_input(path, "scan", "any") as stream:
        data = stream.read(100_000)
    head = layout(data, len(_AXES))
    if head is not None and head.places(_AXES):
        return True
    later = layout(data[len(data) // 2 :].partition(b"\n")[2], len(_AXES))  # lines at the top can have other columns
    return later is not None and later.columns <= _MAX_COLUMNS


def _converted(
    path: Path, points: Floats, unit: Unit | None, size_mm: tuple[float, float, float] | None
) -> tuple[Floats, tuple[str, ...]]:
    """Return points in mm, and a note if their unit is doubtful.

    Raises:
        InputError: No unit is known, or it is wrong.
    """
    some = points[:: max(1, len(points) // 20_000)]
    if not len(some):
        raise InputError("scan", str(path), "has no valid point")
    length = 2.0 * float(np.quantile(np.linalg.norm(some - np.median(some, axis=0), axis=1), 0.995))
    factor, notes = _factor(path, length, unit, None if size_mm is None else math.hypot(*size_mm))
    return points * factor, notes


def _factor(path: Path, length: float, unit: Unit | None, expected_mm: float | None) -> tuple[float, tuple[str, ...]]:
    """Return the millimetres of a unit, and a note if it is doubtful.

    Args:
        path: The file.
        length: A length in the scan, in the unit of the file.
        unit: The unit.
        expected_mm: About the same length of the block; None if the block is unknown.
    """
    fitting = [
        name for name, mm in UNITS.items() if expected_mm is not None and 0.3 <= length * mm / expected_mm <= 3.0
    ]
    if unit is None:
        raise InputError(
            "--unit",
            None,
            f"{path} names no unit; add --unit with one of {', '.join(UNITS)}"
            + (f" (the size of the scan fits the block if the unit is {fitting[0]})" if fitting else ""),
        )
    factor = UNITS[unit]
    if expected_mm is None or not fitting or 0.1 <= length * factor / expected_mm <= 10.0:
        return factor, ()
    ratio = UNITS[fitting[0]] / factor
    sizes = f"{short(length * factor)} mm instead of about {short(expected_mm)} mm"
    if ratio == UNITS["inch"]:  # the scan of a small part of a block looks the same
        text = (
            f"With the unit {unit}, the scan measures {sizes}. If it shows the whole block, its unit is {fitting[0]}."
        )
        return factor, (text,)
    difference = f"a factor of {max(ratio, 1.0 / ratio):g}; the unit is probably {fitting[0]}"
    raise InputError("--unit", unit, f"{path} would measure {sizes}, {difference}")


def _height_map(
    path: Path, unit: Unit | None, mm_per_pixel: float | None, size_mm: tuple[float, float, float] | None
) -> ScanFile:
    try:
        file = read_heights(path)
    except InputError as error:
        if path.suffix.lower() in (*PICTURES, *TABLES, ".npy"):
            raise
        others = ", ".join((*MESHES, *CLOUDS, *TABLES, *PICTURES, ".npy"))
        raise InputError("scan", str(path), f"{error.allowed.rstrip('.')}; export one of {others}") from None
    values = np.asarray(file.values)
    if values.shape[1] <= _MAX_COLUMNS:
        allowed = f"has {counted(values.shape[1], 'column')}, too few for a height map; write points as an XYZ file"
        raise InputError("scan", str(path), allowed)
    if values.dtype == np.uint8:
        allowed = "has 8 bits for each pixel, as a photograph; export heights with 16 or 32 bits"
        raise InputError("scan", str(path), allowed)
    heights = values[::-1].astype(np.float64)  # the first row of a file is the farthest one
    fill = _fill_value(heights[np.isfinite(heights)])
    finite = np.isfinite(heights) & (heights != fill)
    heights[~finite] = np.nan
    if not finite.any():
        raise InputError("scan", str(path), "has no valid height")
    own: Unit | None = unit or ("mm" if file.mm_per_pixel is not None else None)  # an instrument names both units
    low, high = np.quantile(heights[finite], (0.005, 0.995))
    # the relief of a texture is a part of the height of its block
    factor, notes = _factor(path, float(high - low), own, None if size_mm is None else 0.5 * size_mm[2])
    if fill is not None:
        notes += (f"Pixels with the value {fill:g} are not measured: it is far from all other heights.",)
    step = (mm_per_pixel, mm_per_pixel) if mm_per_pixel is not None else file.mm_per_pixel
    if step is None:
        raise InputError("--mm-per-pixel", None, f"{path} does not contain the distance of its pixels; add the option")
    grid = HeightGrid(heights_mm=heights * factor, step_mm=step)
    points = grid.points_mm()
    if size_mm is not None:
        notes += _pixel_notes(path, step[0], math.hypot(*np.ptp(points[:, :2], axis=0)), math.hypot(*size_mm[:2]))
    cloud = Cloud(points_mm=points, source=path.name, grid=grid)
    return ScanFile(cloud=cloud, kind="height map", unit=own or "mm", dropped=int(np.sum(~finite)), notes=notes)


def _fill_value(values: Floats) -> float | None:
    """Return the value of pixels that are not measured, such as -9999; None if there is none.

    It occurs more than once, and its distance from the other values is more than twice their range.
    """
    for value in (values.min(initial=np.inf), values.max(initial=-np.inf)):
        others = values[values != value]
        if 0 < len(others) < len(values) - 1 and np.abs(others - value).min() > 2.0 * np.ptp(others) > 0.0:
            return float(value)
    return None


def _pixel_notes(path: Path, step_mm: float, length_mm: float, expected_mm: float) -> tuple[str, ...]:
    """Return a note if a map is smaller than the block by the ratio of two units.

    Raises:
        InputError: The map is larger than the block, or 1000 times smaller.
    """
    if 0.1 <= length_mm / expected_mm <= 10.0:
        return ()
    sizes = f"{length_mm:.4g} mm wide instead of {expected_mm:.4g} mm"
    ratio = next((each for each in (1.0 / 25.4, 1e-3, 1e3, 25.4) if 0.3 <= length_mm * each / expected_mm <= 3.0), None)
    if ratio is None:
        return ()
    if ratio == 25.4:
        return (f"The map is {sizes}. If it shows the whole block, the distance of its pixels is in inches.",)
    factor = f"a factor of {max(ratio, 1.0 / ratio):g}"
    raise InputError("--mm-per-pixel", step_mm, f"the map of {path} would be {sizes}, {factor}")
