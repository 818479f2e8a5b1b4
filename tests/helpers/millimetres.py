"""Texture files whose pattern is known in mm, and the distance of a textured plate from the pattern."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacbench_cad.util.types import Floats

#: The sides of the plate, and of the textured region of its top with the default margin of 1 mm.
PLATE_MM, REGION_MM = (14.0, 11.0, 4.0), (12.0, 9.0)
#: The default distance of the lowest point of a texture from the face.
BASE_MM = 0.2

Pattern = Callable[[Floats, Floats], Floats]


@dataclass(frozen=True)
class Known:
    """A texture with a pattern that is known without the program.

    Args:
        write: Writes its file into a folder, and returns the file.
        pattern: The height in mm at x and y in mm from the lower corner of the textured region.
        error_mm: The largest difference between the pattern and the texture in the file.
    """

    write: Callable[[Path], Path]
    pattern: Pattern
    error_mm: float = 0.0


def _wave(amplitude: float, keys: str) -> str:
    return f"[[wave]]\namplitude = {amplitude}\n{keys}\n"


def _toml(folder: Path, name: str, text: str) -> Path:
    path = folder / f"{name}.toml"
    path.write_text(f'[texture]\nname = "{name}"\n{text}', encoding="utf-8")
    return path


def _hex(folder: Path) -> Path:
    waves = "".join(_wave(0.15, f"angle_deg = {angle}\nwavelength_mm = 2.0") for angle in (0, 60, 120))
    return _toml(folder, "hexbumps", 'family = "plane-waves"\n' + waves)


def _hex_pattern(x: Floats, y: Floats) -> Floats:
    angles = (math.radians(angle) for angle in (0, 60, 120))
    return np.asarray(sum(0.15 * np.sin(math.pi * (x * math.cos(a) + y * math.sin(a))) for a in angles))


def _map(folder: Path) -> Path:
    x, y = np.arange(0.0, 16.05, 0.1), np.arange(0.0, 12.05, 0.1)
    # the first row of an image is at the largest y
    np.save(folder / "map.npy", _map_pattern(x[None, :], y[::-1, None]))
    return _toml(folder, "map", 'family = "image"\nfile = "map.npy"\nmm_per_pixel = 0.1\n')


def _map_pattern(x: Floats, y: Floats) -> Floats:
    return np.asarray(0.3 * np.sin(2.0 * math.pi * x / 5.0) + 0.2 * np.cos(2.0 * math.pi * (x + y) / 4.0))


def _table(folder: Path) -> Path:
    waves = _wave(1.0, "f = 2.0\ng = 0.0") + _wave(0.5, "f = 1.0\ng = -1.5")
    block = "[block]\nmm_per_unit = [0.8, 1.1, 0.25]\ndomain = [[1.0, 16.0], [2.0, 12.0]]\n"
    return _toml(folder, "table", 'family = "plane-waves"\n' + waves + block)


def _table_pattern(x: Floats, y: Floats) -> Floats:
    u, v = 1.0 + x / 0.8, 2.0 + y / 1.1
    return np.asarray(0.25 * (np.sin(2.0 * u) + 0.5 * np.sin(u - 1.5 * v)))


def _mixed(folder: Path) -> Path:
    waves = _wave(1.0, "f = 2.0\ng = 0.0") + _wave(0.5, "angle_deg = 30\nwavelength_mm = 3.0")
    return _toml(folder, "mixed", 'family = "plane-waves"\n' + waves + "[block]\nmm_per_unit = [0.8, 1.1, 0.25]\n")


def _mixed_pattern(x: Floats, y: Floats) -> Floats:
    along = x * math.cos(math.pi / 6.0) + y * math.sin(math.pi / 6.0)
    return np.asarray(0.25 * (np.sin(2.0 * x / 0.8) + 0.5 * np.sin(2.0 * math.pi * along / 3.0)))


KNOWN = {
    "wavelength_mm": Known(_hex, _hex_pattern),
    "height map": Known(_map, _map_pattern, 1e-5),
    "table": Known(_table, _table_pattern),
    "mixed waves": Known(_mixed, _mixed_pattern),
}


def off_mm(points: Floats, pattern: Pattern, region_mm: tuple[float, float], corner_mm: Floats) -> float:
    """Return the largest distance along z of points on a texture from its pattern, whose level is free.

    Args:
        points: Points on the surface of the part, shape (n, 3). Those that are not on the texture are left out.
        pattern: The pattern.
        region_mm: The sides of the textured region.
        corner_mm: The lower corner of the region, with a height below the texture and above all else.
    """
    x, y, z = (points - corner_mm).T
    inside = (x > 0.01) & (x < region_mm[0] - 0.01) & (y > 0.01) & (y < region_mm[1] - 0.01) & (z > 0.0)
    assert inside.sum() > 50
    level = z[inside] - pattern(x[inside], y[inside])
    return float(np.ptp(level)) / 2.0


def stl_points(path: Path) -> Floats:
    """Return the corners and the centres of the triangles of a binary STL file, shape (n, 3)."""
    data = path.read_bytes()
    count = int.from_bytes(data[80:84], "little")
    rows = np.frombuffer(
        data, offset=84, count=count, dtype=[("normal", "<f4", 3), ("points", "<f4", (3, 3)), ("", "<u2")]
    )
    corners = rows["points"].astype(np.float64)
    return np.concatenate([corners.reshape(-1, 3), corners.mean(axis=1)])
