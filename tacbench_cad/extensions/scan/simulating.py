"""The scan simulator: points on a block as printed, with a truth that is known exactly.

The printed surface is the block's formula with changed amplitudes, so it has no error of its own. Points lie on the
top, on the walls and on the table. They lie evenly over the plan of the top, as a scanner above the block sees it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from tacbench_cad.extensions.scan.cloud import Cloud, HeightGrid
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.spec import Block, Surface, Wave, WaveSum
from tacbench_cad.util.errors import InputError, one_of, require_between
from tacbench_cad.util.types import Bools, Floats

#: The walls by their outward normals; ``key`` is the chamfered corner.
Wall = Literal["x-", "x+", "y-", "y+", "key"]
WALLS: tuple[Wall, ...] = ("x-", "x+", "y-", "y+")
#: The amplitude factor of a wave by its wavelength in mm.
Transfer = Callable[[float], float]
#: Objects that are not a block.
Foreign = Literal["flat", "box", "sphere", "cylinder", "rough", "stairs", "plane waves"]
FOREIGN: tuple[Foreign, ...] = get_args(Foreign)
#: How far from the block outliers may lie, in mm.
OUTLIERS_WITHIN_MM = 3.0


def _identity() -> Pose:
    return Pose(rotation=np.eye(3), shift_mm=np.zeros(3), stretch=np.eye(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class ScanTruth:
    """What a simulated scan shows, and how well.

    Args:
        pose: The pose, with the scale and the skew of the print in its ``stretch``.
        transfer_x: The factor of the amplitude of a wave along x, by its wavelength in mm; None for 1.
        transfer_y: The same along y. A wave in another direction gets ``cos^2`` and ``sin^2`` of the two factors.
        noise_mm: The standard deviation of the noise of each point.
        noise_direction: ``depth`` for noise along z on the top and along the normal on walls, as a scanner that looks
            at each of them has; ``all`` for the same noise along all three axes.
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
    noise_mm: float = 0.02
    noise_direction: Literal["depth", "all"] = "depth"
    outlier_fraction: float = 0.0
    top_fraction: float = 1.0
    holes: int = 0
    hole_mm: float = 1.0
    walls: tuple[Wall, ...] = WALLS
    wall_offset_mm: float = 0.0
    table_mm: float = 0.0
    points: int = 200_000
    seed: int = 0

    def __post_init__(self) -> None:
        require_between("noise_mm", self.noise_mm, 0.0, 10.0)
        require_between("outlier_fraction", self.outlier_fraction, 0.0, 0.9)
        require_between("top_fraction", self.top_fraction, 0.01, 1.0)
        require_between("points", self.points, 10, 100_000_000)
        one_of("noise_direction", self.noise_direction, ("depth", "all"))
        for wall in self.walls:
            one_of("walls", wall, (*WALLS, "key"))

    def with_random_pose(self, reach_mm: float = 50.0) -> ScanTruth:
        """Return the same truth with a pose drawn from the seed, over all rotations and shifts up to ``reach_mm``."""
        rng = np.random.default_rng((self.seed, 1))
        pose = replace(self.pose, rotation=random_rotation(rng), shift_mm=rng.uniform(-reach_mm, reach_mm, 3))
        return replace(self, pose=pose)


def random_rotation(rng: np.random.Generator) -> Floats:
    """Return a rotation, shape (3, 3), drawn evenly from all rotations."""
    w, x, y, z = (lambda q: q / np.linalg.norm(q))(rng.standard_normal(4))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


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


def _printed_surface(block: Block, truth: ScanTruth) -> Surface:
    """Return the printed formula in mm. Without transfer functions, the texture need not be a sum of waves."""
    if truth.transfer_x is None and truth.transfer_y is None:
        return block.surface
    return printed_waves(block, truth.transfer_x, truth.transfer_y)


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
    surface = _printed_surface(block, truth)

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
    if truth.noise_direction == "all":
        printed += truth.noise_mm * rng.standard_normal(printed.shape)
    else:
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
        return np.ones(x.shape, dtype=bool) if block.region is None else block.region.excess(x, y) <= 0.0

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


def simulate_height_map(block: Block, truth: ScanTruth, step_mm: float = 0.1, turn_deg: float = 0.0) -> Cloud:
    """Scan a block as printed with an instrument that measures heights on a grid, from above.

    Args:
        block: The design.
        truth: What the printer and the scanner did. Of its pose, only ``stretch`` is used, without skew along z; walls,
            the table and the number of points have no effect. Outliers are heights.
        step_mm: The distance of neighbouring pixels.
        turn_deg: The angle by which the block is turned under the instrument.

    Returns:
        The scan with its ``HeightGrid``. Pixels beside the block, in holes and beyond the
        part that was seen are ``nan``.
    """
    rng = np.random.default_rng((truth.seed, 0))
    seen = _seen(block, truth, rng)
    surface = _printed_surface(block, truth)
    plan = truth.pose.stretch[:2, :2]
    turn = math.radians(turn_deg)
    turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) @ plan
    width, depth = block.size_mm
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth]]) @ turned.T
    low = corners.min(axis=0)
    columns, rows = (np.ceil((corners.max(axis=0) - low) / step_mm)).astype(int) + 1
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * step_mm + low
    x, y = (grid @ np.linalg.inv(turned).T).T
    inside = (x >= 0.0) & (x <= width) & (y >= 0.0) & (y <= depth) & seen(x, y)
    z = np.full(len(x), np.nan)
    z[inside] = truth.pose.stretch[2, 2] * (block.datum_mm + surface(x[inside], y[inside]))
    z += truth.noise_mm * rng.standard_normal(len(z))
    wrong = rng.random(len(z)) < truth.outlier_fraction
    z[wrong & inside] += rng.uniform(-OUTLIERS_WITHIN_MM, OUTLIERS_WITHIN_MM, int(np.count_nonzero(wrong & inside)))
    heights = HeightGrid(heights_mm=z.reshape(rows, columns), step_mm=(step_mm, step_mm))
    source = f"scan simulator, seed {truth.seed}"
    return Cloud(points_mm=heights.points_mm(), source=source, simulated=True, grid=heights)


def simulate_foreign(
    kind: Foreign, *, points: int = 50_000, noise_mm: float = 0.02, seed: int = 0, size_mm: float = 25.0
) -> Cloud:
    """Scan an object that is not a textured block: it must be refused.

    Args:
        kind: A flat plate, a box, a sphere, a cylinder, a rough surface, stairs, or a surface of random plane waves.
        points: The number of points.
        noise_mm: The standard deviation of the noise along z.
        seed: The seed of the shape, the pose and the noise.
        size_mm: The size of the object.
    """
    rng = np.random.default_rng((seed, 2, FOREIGN.index(one_of("kind", kind, FOREIGN))))
    x, y = rng.uniform(0.0, size_mm, (2, points))
    centre = size_mm / 2.0
    if kind == "sphere":
        direction = rng.standard_normal((points, 3))
        shape = centre * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        shape[:, 2] = np.abs(shape[:, 2])
    elif kind == "box":
        shape = rng.uniform(0.0, size_mm, (points, 3)) * (1.0, 1.0, 0.3)
        side = rng.integers(0, 5, points)
        shape[side < 2, 0] = size_mm * side[side < 2]
        middle = (side >= 2) & (side < 4)
        shape[middle, 1] = size_mm * (side[middle] - 2)
        shape[side == 4, 2] = 0.3 * size_mm
    else:
        shape = np.column_stack([x, y, _foreign_height(kind, x, y, size_mm, rng)])
    shape[:, 2] += noise_mm * rng.standard_normal(points)
    pose = ScanTruth(seed=seed).with_random_pose().pose
    return Cloud(points_mm=pose.to_scan(shape), source=f"scan simulator, {kind}, seed {seed}", simulated=True)


def _foreign_height(kind: Foreign, x: Floats, y: Floats, size_mm: float, rng: np.random.Generator) -> Floats:
    if kind == "cylinder":
        return np.sqrt(np.maximum((size_mm / 2.0) ** 2 - (x - size_mm / 2.0) ** 2, 0.0))
    if kind == "stairs":
        return np.asarray(np.floor(x / size_mm * 6.0) * rng.uniform(0.3, 0.8))
    height = np.zeros(x.shape)
    if kind in ("rough", "plane waves"):
        count, shortest = (60, 0.5) if kind == "rough" else (4, 3.0)
        for _ in range(count):
            k, angle, phase = rng.uniform(0.0, 2.0 * math.pi / shortest), *rng.uniform(0.0, 2.0 * math.pi, 2)
            height += np.sin(k * (x * math.cos(angle) + y * math.sin(angle)) + phase) / math.sqrt(count)
    return height
