"""The scan simulator: points on a block as printed, with a truth that is known exactly.

The printed surface is the block's formula with changed amplitudes, so it has no error of its own. Points lie on the
top, on the walls and on the table. They lie evenly over the plan of the top, as a scanner above the block sees it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Interval

from tacbench_cad.extensions.scan.cloud import Cloud
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.spec import Block, Surface, Wave, WaveSum
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: The walls by their outward normals; ``key`` is the chamfered corner.
Wall = Literal["x-", "x+", "y-", "y+", "key"]
WALLS: tuple[Wall, ...] = ("x-", "x+", "y-", "y+")
#: The amplitude factor of a wave by its wavelength in mm.
Transfer = Callable[[float], float]
#: How far from the block outliers may lie, in mm.
OUTLIERS_WITHIN_MM = 3.0


def _identity() -> Pose:
    return Pose(rotation=np.eye(3), shift_mm=np.zeros(3), stretch=np.eye(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanTruth(Checked):
    """What a simulated scan shows, and how well.

    Args:
        pose: The pose, with the scale and the skew of the print in its ``stretch``.
        transfer_x: The factor of the amplitude of a wave along x, by its wavelength in mm; None for 1.
        transfer_y: The same along y. A wave in another direction gets ``cos^2`` and ``sin^2`` of the two factors.
        noise_mm: The standard deviation of the noise of each point: along z on the top, along the normal on walls, as a
            scanner that looks at each of them has it.
        outlier_fraction: The fraction of points that lie anywhere within 3 mm of the block's box.
        top_fraction: The fraction of the top that was seen: the part on one side of a random line.
        holes: The number of round holes in the top.
        hole_mm: The radius of a hole.
        walls: The walls that were seen.
        wall_offset_mm: The distance of the printed walls outside of their position.
        table_mm: The width of the strip of the table that was seen around the block, in mm.
        points: The number of points.
        seed: The seed of everything random.
    """

    pose: Pose = field(default_factory=_identity)
    transfer_x: Transfer | None = None
    transfer_y: Transfer | None = None
    noise_mm: Annotated[float, Interval(ge=0.0, le=10.0)] = 0.02
    outlier_fraction: Annotated[float, Interval(ge=0.0, le=0.9)] = 0.0
    top_fraction: Annotated[float, Interval(ge=0.01, le=1.0)] = 1.0
    holes: int = 0
    hole_mm: float = 1.0
    walls: tuple[Wall, ...] = WALLS
    wall_offset_mm: float = 0.0
    table_mm: float = 0.0
    points: Annotated[int, Interval(ge=10, le=100_000_000)] = 200_000
    seed: int = 0

    def with_random_pose(self, reach_mm: float = 50.0) -> ScanTruth:
        """Return the same truth with a pose drawn from the seed, over all rotations and shifts up to ``reach_mm``."""
        from scipy.spatial.transform import Rotation

        rng = np.random.default_rng((self.seed, 1))
        rotation = Rotation.from_quat(np.roll(rng.standard_normal(4), -1)).as_matrix()
        pose = replace(self.pose, rotation=rotation, shift_mm=rng.uniform(-reach_mm, reach_mm, 3))
        return replace(self, pose=pose)


def stretch(
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0), skew: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Floats:
    """Return the matrix of a print with these scales along x, y, z and these skews xy, xz, yz; shape (3, 3)."""
    matrix = np.diag(np.asarray(scale, dtype=np.float64))
    matrix[0, 1], matrix[0, 2], matrix[1, 2] = skew
    return matrix


def low_pass(half_mm: float) -> Transfer:
    """Return a transfer function that halves a wave of the length ``half_mm`` and keeps long waves."""
    return lambda wavelength_mm: 0.5 ** ((half_mm / wavelength_mm) ** 2)


def printed_waves(block: Block, transfer_x: Transfer | None, transfer_y: Transfer | None) -> WaveSum:
    """Return the block's formula in mm with the amplitude of each wave multiplied by its factor.

    Raises:
        InputError: The texture is not a sum of waves.
    """
    if not isinstance(block.surface, WaveSum):
        raise InputError("texture", block.texture.name, "must be a sum of waves, because each wave gets its own factor")
    return WaveSum(
        tuple(
            replace(wave, amplitude=wave.amplitude * _factor(wave, transfer_x, transfer_y))
            for wave in block.surface.waves
        )
    )


def _factor(wave: Wave, transfer_x: Transfer | None, transfer_y: Transfer | None) -> float:
    frequency = math.hypot(wave.f, wave.g)
    if frequency == 0.0:
        return 1.0
    length, along_x = 2.0 * math.pi / frequency, (wave.f / frequency) ** 2
    x, y = (1.0 if transfer is None else transfer(length) for transfer in (transfer_x, transfer_y))
    return along_x * x + (1.0 - along_x) * y


def simulate_scan(block: Block, truth: ScanTruth) -> Cloud:
    """Scan a block as printed.

    Args:
        block: The design.
        truth: What the printer and the scanner did.

    Returns:
        The points in random order. The same truth gives the same points.

    Raises:
        InputError: The texture has no waves to change, or walls are wanted of a block that is not a rectangle.
    """
    rng = np.random.default_rng((truth.seed, 0))
    surface: Surface = block.surface
    if truth.transfer_x is not None or truth.transfer_y is not None:
        surface = printed_waves(block, truth.transfer_x, truth.transfer_y)

    def height(x: Floats, y: Floats) -> Floats:
        return np.asarray(block.datum_mm + surface(x, y))

    edges = _edges(block, truth.walls)
    top_mm2 = block.footprint_mm2 * truth.top_fraction
    table_mm2 = _table_area(block, truth.table_mm)
    areas = [top_mm2, table_mm2, *(math.dist(*edge) * block.height_mm for edge in edges)]
    outliers = round(truth.points * truth.outlier_fraction)
    top, table, *walls = _split(truth.points - outliers, areas)
    x, y = _plan(block, truth, top, rng)
    parts = [(np.column_stack([x, y, height(x, y)]), np.array([0.0, 0.0, 1.0]))]
    for edge, count in zip(edges, walls, strict=True):
        parts.append(_wall(edge, count, height, rng))
    if truth.table_mm:
        parts.append((_table(block, truth.table_mm, table, rng), np.array([0.0, 0.0, 1.0])))
    nominal = np.concatenate([points for points, _ in parts])
    printed = nominal @ truth.pose.stretch.T
    normals = np.repeat([normal for _, normal in parts], [len(points) for points, _ in parts], axis=0)
    printed[:, :2] += truth.wall_offset_mm * normals[:, :2]
    printed += truth.noise_mm * rng.standard_normal((len(printed), 1)) * normals
    if outliers:
        margin = np.full(3, OUTLIERS_WITHIN_MM)
        high = np.array([*block.size_mm, block.height_mm]) + margin
        printed = np.concatenate([printed, rng.uniform(-margin, high, (outliers, 3))])
    rng.shuffle(printed)
    points = (printed - truth.pose.shift_mm) @ truth.pose.rotation
    return Cloud(points_mm=points, source=f"scan simulator, seed {truth.seed}", simulated=True)


def _split(count: int, areas: list[float]) -> list[int]:
    """Divide ``count`` points between areas, in proportion to their sizes."""
    ends = np.round(count * np.cumsum([0.0, *areas]) / sum(areas)).astype(int)
    return [int(number) for number in np.diff(ends)]


def _plan(block: Block, truth: ScanTruth, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return ``count`` random places on the part of the top that was seen."""
    seen = _seen(block, truth, rng)
    found: list[Floats] = []
    missing = count
    while missing > 0:
        tried = rng.uniform((0.0, 0.0), block.size_mm, (int(1.2 * missing / truth.top_fraction) + 100, 2))
        found.append(tried[seen(*tried.T)][:missing])
        missing -= len(found[-1])
        if len(found) > 50:
            raise InputError("holes", truth.holes, f"of {truth.hole_mm:g} mm leave too little of the top")
    places = np.concatenate([*found, np.zeros((0, 2))])
    return places[:, 0], places[:, 1]


def _seen(block: Block, truth: ScanTruth, rng: np.random.Generator) -> Callable[[Floats, Floats], Bools]:
    """Return the function that says which places of the plan were seen."""

    def on_block(x: Floats, y: Floats) -> Bools:
        return np.ones(x.shape, dtype=bool) if block.region is None else block.region.distance(x, y) <= 0.0

    angle = rng.uniform(0.0, 2.0 * math.pi)
    tried = rng.uniform((0.0, 0.0), block.size_mm, (20_000, 2))
    along = tried @ (math.cos(angle), math.sin(angle))
    limit = np.quantile(along[on_block(*tried.T)], truth.top_fraction) if truth.top_fraction < 1.0 else math.inf
    centres = rng.uniform((0.0, 0.0), block.size_mm, (truth.holes, 2))

    def seen(x: Floats, y: Floats) -> Bools:
        keep = on_block(x, y) & (x * math.cos(angle) + y * math.sin(angle) <= limit)
        for centre in centres:
            keep &= (x - centre[0]) ** 2 + (y - centre[1]) ** 2 > truth.hole_mm**2
        return np.asarray(keep)

    return seen


_Edge = tuple[tuple[float, float], tuple[float, float]]


def _edges(block: Block, walls: tuple[Wall, ...]) -> list[_Edge]:
    """Return the lower edges of walls, each with the block on its left."""
    if walls and block.outline is not None:
        raise InputError("walls", list(walls), f"need a rectangular block, but the outline is a {block.outline}")
    (x, y), key = block.size_mm, block.key_mm or 0.0
    edges: dict[Wall, _Edge] = {
        "y-": ((0.0, 0.0), (x - key, 0.0)),
        "key": ((x - key, 0.0), (x, key)),
        "x+": ((x, key), (x, y)),
        "y+": ((x, y), (0.0, y)),
        "x-": ((0.0, y), (0.0, 0.0)),
    }
    if "key" in walls and not key:
        raise InputError("walls", "key", "needs a block with a key")
    return [edges[wall] for wall in walls]


def _wall(
    edge: _Edge, count: int, height: Callable[[Floats, Floats], Floats], rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """Return points on a wall, from the underside to the surface, and the outward normal."""
    (x0, y0), (x1, y1) = edge
    t, up = rng.random((2, count))
    x, y = x0 + (x1 - x0) * t, y0 + (y1 - y0) * t
    length = math.hypot(x1 - x0, y1 - y0)
    return np.column_stack([x, y, up * height(x, y)]), np.array([(y1 - y0) / length, (x0 - x1) / length, 0.0])


def _table_area(block: Block, width: float) -> float:
    x, y = block.size_mm
    return (x + 2.0 * width) * (y + 2.0 * width) - x * y


def _table(block: Block, width: float, count: int, rng: np.random.Generator) -> Floats:
    """Return points on the table around the block's rectangle, at z = 0."""
    size = np.asarray(block.size_mm)
    fraction = size.prod() / (size + 2.0 * width).prod()
    tried = rng.uniform(-width, size + width, (int(1.2 * count / (1.0 - fraction)) + 200, 2))
    outside = tried[np.any((tried < 0.0) | (tried > size), axis=1)][:count]
    return np.column_stack([outside, np.zeros(len(outside))])
