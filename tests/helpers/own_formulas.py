"""Random blocks with the heights of their formulas from NumPy and SciPy alone, and distances from these formulas."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import NdBSpline

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.interpolation import height_map, spline_through
from tacbench_cad.spec.outlines import Disc, Polygon, RegularPolygon, Ring
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.spline import SplineSurface
from tacbench_cad.spec.texture_files import find_texture
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.types import Floats

#: The height of a formula in its own units, as a function of u and v.
Formula = Callable[[Floats, Floats], Floats]

#: Textures with creases and products, as the manual writes them.
LATER: dict[str, Formula] = {
    "diamond": lambda u, v: np.abs(np.sin(u)) + np.abs(np.cos(v)),
    "ridges": lambda u, v: 1.0 - np.abs(np.sin(u) * np.cos(v)),
    "dimples": lambda u, v: -np.abs(np.sin(u / 2.0) * np.cos(v / 2.0)),
    "dunes": lambda u, v: np.exp(np.sin(u)) * np.cos(v),
    "scales": lambda u, v: np.sin(u + np.sin(v)) * np.cos(v),
    "swirl": lambda u, v: np.sin(u + np.cos(v)) + np.cos(v + np.sin(u)),
}
#: The number of points of the whole top at which a distance is measured.
POINTS = 120_000
#: The number of points whose distance is always searched.
SEARCHED = 100


@dataclass(frozen=True)
class Case:
    """A block and its formula.

    Args:
        kind: What the block is an example of.
        block: The block.
        formula: The formula of its texture.
        mm_per_unit: The millimetres per unit of u, v and height.
    """

    kind: str
    block: Block
    formula: Formula
    mm_per_unit: tuple[float, float, float]

    def height(self, x: Floats, y: Floats, datum_mm: float) -> Floats:
        """Return the height of the formula above the underside in mm; the datum is stated in the manifest."""
        (a, b, c), (u, v) = self.mm_per_unit, (ends[0] for ends in self.block.domain)
        return np.asarray(datum_mm + c * self.formula(u + x / a, v + y / b))


def waves(terms: Sequence[tuple[float, float, float, float]]) -> Formula:
    """Return the sum of waves ``amplitude * sin(f u + g v + phase)``."""
    return lambda u, v: np.asarray(sum(a * np.sin(f * u + g * v + phase) for a, f, g, phase in terms))


def spline(surface: SplineSurface) -> Formula:
    """Return a spline, evaluated by SciPy from its knots and poles."""
    axes = surface.u, surface.v
    own = NdBSpline(tuple(a.knots for a in axes), surface.poles, tuple(a.degree for a in axes))
    low, high = ([a.knots[i] for a in axes] for i in (0, -1))

    def value(u: Floats, v: Floats) -> Floats:
        at = np.stack(np.broadcast_arrays(u, v), axis=-1)
        return np.asarray(own(np.clip(at, low, high)))

    return value


def random_case(seed: int) -> Case:
    """Return a random block: its texture, size, outline, key, scale and sampling depend on the seed."""
    rng = np.random.default_rng(seed)
    kind = ("sum", "oblique", "product", "catalogue", "later", "map", "spline")[seed % 7]
    size = tuple(rng.uniform(3.0, 9.0, 2).tolist())
    mm = tuple(rng.uniform(0.6, 1.5, 3).tolist())
    preset, made = "paper", None
    terms: list[tuple[float, float, float, float]] = []
    if kind in ("sum", "oblique", "product"):
        for _ in range(int(rng.integers(1, 6))):
            frequency, phase = 10.0 ** rng.uniform(-0.3, 0.9), rng.uniform(0.0, 6.3)
            amplitude = rng.uniform(0.05, 0.6) / max(1.0, frequency) ** rng.uniform(0.3, 1.0)
            angle = rng.uniform(0.0, 6.3) if kind == "oblique" else 0.0
            f, g = frequency * np.cos(angle), frequency * np.sin(angle)
            if kind == "sum" and rng.integers(2):
                f, g = 0.0, frequency
            if kind == "product":
                g = frequency * rng.uniform(0.3, 2.0)
                terms.append((amplitude / 2.0, f, -g, phase))
            terms.append((amplitude, f, g, phase))
        made, formula = plane_waves(*terms), waves(terms)
    elif kind == "catalogue":
        preset = ("paper", "released")[int(rng.integers(2))]
        made = find_texture(int(rng.integers(1, 7)), preset)
        formula = waves([(wave.amplitude, wave.f, wave.g, wave.phase) for wave in made.surface.waves])  # type: ignore[attr-defined]
        mm = Block.of(made, preset, sampling="grid").mm_per_unit
        size = tuple(float(side) * min(1.0, 5.0 * m) for side, m in zip(size, mm[:2], strict=True))
    elif kind == "later":
        name = list(LATER)[int(rng.integers(len(LATER)))]
        made, formula = find_texture(name), LATER[name]
    else:
        values = np.cumsum(rng.normal(0.0, 0.06, (14, 12)), axis=int(rng.integers(2)))
        if kind == "map":
            surface = height_map(values, mm_per_pixel=1.0)
            made = surface if isinstance(surface, Texture) else Texture(name="map", equation="map", surface=surface)
        else:
            surface = spline_through(np.linspace(0.0, 13.0, 14), np.linspace(0.0, 11.0, 12), values)
            made = Texture(name="spline", equation="spline", surface=surface)
        assert isinstance(made.surface, SplineSurface)
        formula = spline(made.surface)
        mm = (1.0, 1.0, mm[2])
    if not isinstance(made, Texture):
        made = Texture(name="waves", equation="waves", surface=made)
    separable = made.surface.is_separable
    mm3 = (float(mm[0]), float(mm[1]), float(mm[2]))
    scale = float(rng.choice([0.5, 1.0, 1.0, 2.5]))
    shape = ("plain", "plain", "key", "outline", "grid", "keyed grid")[int(rng.integers(6))]
    least = -3.0 if separable and size[0] * size[1] < 30.0 else -2.2
    outline = None
    if shape == "outline":
        side = min(size)
        angles = np.linspace(0.0, 6.28, 9, endpoint=False) + rng.uniform(0.0, 0.4, 9)
        radii = rng.uniform(0.3, 0.5, 9) * side
        outline = (
            Disc(diameter_mm=side),
            Ring(outer_mm=side, inner_mm=0.3 * side),
            RegularPolygon(sides=6, diameter_mm=side),
            Polygon(
                points_mm=tuple(zip((radii * np.cos(angles)).tolist(), (radii * np.sin(angles)).tolist(), strict=True))
            ),
        )[int(rng.integers(4))]
    n, m = (int(k) for k in rng.integers(2, 120, 2))
    block = Block.of(
        made,
        preset,
        mm_per_unit=None if made.surface.unit == "mm" else mm3,
        size_mm=(size[0], size[1]) if outline is None else None,
        height_mm=30.0,
        scale=scale,
        sampling=SampleGrid(nx=n, ny=m) if "grid" in shape else Tolerance(mm=float(10.0 ** rng.uniform(least, -0.52))),
        key_mm=float(rng.uniform(0.4, min(size) / 3.0)) * scale if "key" in shape else None,
        outline=outline,
    )
    return Case(f"{kind}, {shape}", block, formula, block.mm_per_unit)


def top_of(corners: Floats) -> Floats:
    """Return the triangles that face upwards and are not walls."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # the rounding of its corners can tilt a narrow triangle of a wall
    flat = normal[:, 2] > 1e-4 * np.linalg.norm(normal, axis=1) + 1e-5 * np.ptp(corners, axis=1).max(axis=1)
    return np.asarray(corners[flat])


def points_of(triangles: Floats) -> Floats:
    """Return a lattice of points of every triangle, with its corners, middles and edges, shape (n, 3)."""
    steps = int(np.clip(2 * round(np.sqrt(POINTS / 2.0 / len(triangles))), 4, 60))
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    inside = i + j <= steps
    weights = np.column_stack([i[inside], j[inside], steps - i[inside] - j[inside]]) / steps
    return np.asarray(np.einsum("kw,nwc->nkc", weights, triangles).reshape(-1, 3))


def largest_distance(
    points: Floats, height: Formula, size_mm: tuple[float, float], stated_mm: float
) -> tuple[float, Floats]:
    """Return the largest distance of points from the surface ``z = height(x, y)`` over a rectangle, and its point.

    Every distance is the length of a way to one point of the surface, so it is never below the true one. All points
    that could be further away than stated are searched, and a hundred others.
    """
    # each step goes to the nearest point of the tangent plane at the last one, with slopes from differences
    x, y, z = points.T
    above = z - height(x, y)
    way, foot = np.abs(above), [x, y]
    for number in range(6):
        slopes = _slopes(height, *foot)
        if number == 0:
            gx, gy = slopes
        rise = z - height(*foot) + slopes[0] * (foot[0] - x) + slopes[1] * (foot[1] - y)
        rise /= 1.0 + slopes[0] ** 2 + slopes[1] ** 2
        foot = [np.clip(t + g * rise, 0.0, side) for t, g, side in zip((x, y), slopes, size_mm, strict=True)]
        way = np.minimum(way, np.sqrt((foot[0] - x) ** 2 + (foot[1] - y) ** 2 + (z - height(*foot)) ** 2))
    # on steep walls with narrow bends, the nearest of some places uphill or downhill from the point
    steep = np.flatnonzero(way > stated_mm)
    towards = (np.stack([gx, gy]) * (np.sign(above) / np.maximum(np.hypot(gx, gy), 1e-300)))[:, steep, None]
    for t in np.array_split(stated_mm * np.linspace(0.0, 1.0, 400), 10) if len(steep) else ():
        u, v = (np.clip(p[steep, None] + k * t, 0.0, side) for p, k, side in zip((x, y), towards, size_mm, strict=True))
        away = (u - x[steep, None]) ** 2 + (v - y[steep, None]) ** 2 + (z[steep, None] - height(u, v)) ** 2
        way[steep] = np.minimum(way[steep], np.sqrt(away.min(axis=1)))
    largest, at = 0.0, points[0]
    order = np.argsort(-way)
    for start in range(0, len(order), 50):
        part = order[start : start + 50]
        part = part[way[part] > (largest if start < SEARCHED else max(largest, stated_mm))]
        if len(part) == 0:
            break
        exact = np.minimum(way[part], searched(points[part], height, size_mm, np.minimum(way[part], 1.2 * stated_mm)))
        if exact.max() > largest:
            largest, at = float(exact.max()), points[part[int(exact.argmax())]]
    return largest, at


def _slopes(height: Formula, x: Floats, y: Floats, step: float = 1e-6) -> tuple[Floats, Floats]:
    """Return the slopes along x and y from differences."""
    along_x = height(x + step, y) - height(x - step, y)
    along_y = height(x, y + step) - height(x, y - step)
    return along_x / (2.0 * step), along_y / (2.0 * step)


def searched(points: Floats, height: Formula, size_mm: tuple[float, float], reach: Floats) -> Floats:
    """Return the distances of a few points from a surface, from grids of places that become smaller."""
    centre, radius = points[:, :2].copy(), reach.copy()
    best, rows = np.full(len(points), np.inf), np.arange(len(points))
    for steps in (61, *[21] * 13):
        t = np.linspace(-1.0, 1.0, steps)
        u, v = (part.ravel() for part in np.meshgrid(t, t))
        x, y = (np.clip(centre[:, k, None] + radius[:, None] * w, 0.0, size_mm[k]) for k, w in ((0, u), (1, v)))
        away = np.sqrt((x - points[:, :1]) ** 2 + (y - points[:, 1:2]) ** 2 + (height(x, y) - points[:, 2:]) ** 2)
        nearest = away.argmin(axis=1)
        centre = np.stack([x[rows, nearest], y[rows, nearest]], axis=1)
        best, radius = np.minimum(best, away[rows, nearest]), (0.08 if steps > 21 else 0.35) * radius
    return best
