"""Outlines of blocks (disc, polygon, ring), and functions for closed polygons in the plane.

The lower corner of the bounding box of an outline is at the origin, as in the block frame. Lengths are in mm.
"""

from __future__ import annotations

import contextlib
import math
import re
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import ArrayLike

from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError, nearest, require_between
from tacbench_cad.util.text import decimal
from tacbench_cad.util.types import Floats

#: The allowed numbers of corners of polygons.
CORNERS_RANGE = (3, 1000)
#: The smallest width of a ring, and the smallest length of a polygon's side, in mm.
MIN_WIDTH_MM, MIN_SIDE_MM = 1.0, 0.1
#: The names of regular polygons.
NAMED = {"triangle": 3, "square": 4, "pentagon": 5, "hexagon": 6, "octagon": 8}
#: The number of sides of the polygon with the same area that replaces a circle in integrals without a closed form. The
#: error is a fraction of about 1e-9 of the volume.
_INTEGRAL_SIDES = 1024
#: The number of decimals of a polygon's corners in mm.
_DECIMALS = 6
#: Points closer to a side than this count as inside, in mm. It is much less than the rounding of coordinates.
_EDGE_MM = 1e-12


def area_mm2(*outlines: Floats) -> float:
    """Return the area of closed outlines (n, 2), in mm^2. The area of a clockwise outline is subtracted."""
    rings = [shapely.LinearRing(outline) for outline in outlines]
    return float(sum(shapely.Polygon(ring).area * (1.0 if ring.is_ccw else -1.0) for ring in rings))


@dataclass(frozen=True)
class Circle:
    """A circle.

    Args:
        centre: The centre.
        radius: The radius.
    """

    centre: tuple[float, float]
    radius: float

    @property
    def area_mm2(self) -> float:
        """The area of the disc inside."""
        return math.pi * self.radius**2

    @property
    def box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The lower and the upper corner of the bounding box."""
        (x, y), r = self.centre, self.radius
        return (x - r, y - r), (x + r, y + r)

    @property
    def polygon(self) -> shapely.Polygon:
        """A polygon with its corners on the circle."""
        return shapely.Point(self.centre).buffer(self.radius, quad_segs=64)

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distances of points from the circle. Distances of points inside are negative."""
        return np.asarray(np.hypot(x - self.centre[0], y - self.centre[1]) - self.radius)

    def nearest(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the nearest points on the circle."""
        angle = np.arctan2(y - self.centre[1], x - self.centre[0])
        return self.centre[0] + self.radius * np.cos(angle), self.centre[1] + self.radius * np.sin(angle)

    def span(self, direction: tuple[float, float]) -> tuple[float, float]:
        """Return the lowest and the highest coordinate along a unit vector."""
        middle = float(np.dot(self.centre, direction))
        return middle - self.radius, middle + self.radius

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over the disc inside."""
        if (waves := surface.plane_waves) is not None:
            return self._integral_of_waves(waves)
        n = _INTEGRAL_SIDES
        radius = self.radius * math.sqrt(2.0 * math.pi / (n * math.sin(2.0 * math.pi / n)))
        turns = 2.0 * math.pi * (np.arange(n) + 0.5) / n
        return Corners.of(np.array(self.centre) + radius * np.column_stack([np.cos(turns), np.sin(turns)])).integral(
            surface
        )

    def _integral_of_waves(self, waves: tuple[Wave, ...]) -> float:
        """Return the integral in closed form: that of a plane wave is its value at the centre times 2 pi r J1(kr)/k."""
        from scipy.special import j1

        (x, y), r = self.centre, self.radius
        amplitude, f, g, phase = np.array([(w.amplitude, w.f, w.g, w.phase) for w in waves]).reshape(-1, 4).T
        k = np.hypot(f, g) * r
        shrink = np.where(k == 0.0, 1.0, 2.0 * j1(k) / np.where(k == 0.0, 1.0, k))
        return float(self.area_mm2 * np.sum(amplitude * np.sin(f * x + g * y + phase) * shrink))

    def chords(self, tolerance_mm: float, through: tuple[float, float] | None) -> tuple[Corners, float]:
        """Return a polygon with its corners on the circle, and the distance of its sides from it.

        Args:
            tolerance_mm: The largest allowed distance.
            through: A point. If it is on the circle, it becomes one of the corners.
        """
        step = 2.0 * math.acos(max(1.0 - tolerance_mm / self.radius, 0.5))
        # A multiple of four, so that the box of the points is the box of the circle
        count = 4 * math.ceil(math.pi / 2.0 / step - 1e-9)
        angles = 2.0 * math.pi * np.arange(count) / count
        if through is not None and abs(float(self.distance(*np.array(through)))) < 1e-6 * self.radius:
            own = math.atan2(through[1] - self.centre[1], through[0] - self.centre[0]) % (2.0 * math.pi)
            if np.abs(np.append(angles, 2.0 * math.pi) - own).min() > 1e-4:
                angles = np.sort(np.append(angles, own))
        unit = np.column_stack([np.cos(angles), np.sin(angles)]).round(15)
        return Corners.of(np.array(self.centre) + self.radius * unit), self.radius * (1.0 - math.cos(math.pi / count))

    def moved_outwards(self, by_mm: float) -> Circle:
        """Return the circle with another radius."""
        return Circle(self.centre, self.radius + by_mm)


@dataclass(frozen=True)
class Corners:
    """A closed polygon.

    Args:
        points: The corners, counter-clockwise.
    """

    points: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, points: Floats) -> Corners:
        """Make a polygon from an array of corners, shape (n, 2)."""
        return cls(tuple(map(tuple, points.tolist())))

    @cached_property
    def array(self) -> Floats:
        """The corners, shape (n, 2)."""
        return np.array(self.points, dtype=np.float64)

    @cached_property
    def polygon(self) -> shapely.Polygon:
        """The polygon as a geometry of shapely."""
        polygon = shapely.Polygon(self.points)
        shapely.prepare(polygon)
        return polygon

    @property
    def area_mm2(self) -> float:
        """The area inside."""
        return float(self.polygon.area)

    @property
    def box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The lower and the upper corner of the bounding box."""
        x0, y0, x1, y1 = self.polygon.bounds
        return (x0, y0), (x1, y1)

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distances of points from the polygon. Distances of points inside are negative."""
        distance = shapely.distance(self.polygon.exterior, shapely.points(x, y))
        distance = np.where(distance < _EDGE_MM, 0.0, distance)
        return np.asarray(np.where(shapely.contains_xy(self.polygon, x, y), -distance, distance))

    def nearest(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the nearest points on the polygon."""
        sides = self.polygon.exterior
        points = shapely.line_interpolate_point(sides, shapely.line_locate_point(sides, shapely.points(x, y)))
        return shapely.get_x(points), shapely.get_y(points)

    def span(self, direction: tuple[float, float]) -> tuple[float, float]:
        """Return the lowest and the highest coordinate along a unit vector."""
        along = self.array @ np.array(direction)
        return float(along.min()), float(along.max())

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over the inside, in closed form: a sum over triangles with a sign."""
        first, total = self.points[0], 0.0
        for a, b in zip(self.points[1:-1], self.points[2:], strict=True):
            doubled = (a[0] - first[0]) * (b[1] - first[1]) - (b[0] - first[0]) * (a[1] - first[1])
            if doubled != 0.0:
                total += math.copysign(1.0, doubled) * surface.integral_triangle([first, a, b])
        return total

    def chords(self, tolerance_mm: float, through: tuple[float, float] | None) -> tuple[Corners, float]:
        """Return the polygon itself and 0, because the sides are straight."""
        return self, 0.0

    def moved_outwards(self, by_mm: float) -> Corners:
        """Return the polygon with its sides moved outwards by a distance. Its corners stay sharp."""
        a, b = np.roll(self.array, 1, axis=0), self.array
        way = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        normal = np.column_stack([way[:, 1], -way[:, 0]])
        after = np.roll(normal, -1, axis=0)
        shift = (normal + after) / (1.0 + np.einsum("ij,ij->i", normal, after))[:, None]
        return Corners.of(self.array + by_mm * shift)


#: A closed curve of an outline.
Loop = Circle | Corners


class LoopRegion(ABC):
    """A connected part of the plane: the inside of an outer loop without its holes."""

    @property
    @abstractmethod
    def loops(self) -> tuple[Loop, ...]:
        """The outer loop first, then the holes. All are counter-clockwise."""

    @property
    def area_mm2(self) -> float:
        """The area inside of the outer loop, without the holes."""
        return self.loops[0].area_mm2 - sum(hole.area_mm2 for hole in self.loops[1:])

    @property
    def polygon(self) -> shapely.Polygon:
        """The region as a polygon of shapely, in which chords replace circles."""
        return shapely.Polygon(self.loops[0].polygon.exterior, [hole.polygon.exterior for hole in self.loops[1:]])

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over this area."""
        return self.loops[0].integral(surface) - sum(hole.integral(surface) for hole in self.loops[1:])

    def distance(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return the distances of points from the area. Points inside have negative distances."""
        x, y = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        distance = self.loops[0].distance(x, y)
        for hole in self.loops[1:]:
            distance = np.maximum(distance, -hole.distance(x, y))
        return np.asarray(distance)

    def inner_points(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """Return the points themselves, or for points that are not inside the nearest points of the loops."""
        x, y = np.array(u, dtype=np.float64), np.array(v, dtype=np.float64)
        for number, loop in enumerate(self.loops):
            off = loop.distance(x, y) > 0.0 if number == 0 else loop.distance(x, y) < 0.0
            x[off], y[off] = loop.nearest(x[off], y[off])
        return x, y

    def span(self, direction: tuple[float, float]) -> tuple[float, float]:
        """Return the lowest and the highest coordinate along a unit vector. All coordinates between them occur."""
        return self.loops[0].span(direction)

    def point_at(self, direction: tuple[float, float], along: float) -> tuple[float, float]:
        """Return a point of the area with a coordinate along a unit vector."""
        (c, s), reach = direction, 2.0 * float(np.abs(self.loops[0].box).max())
        line = shapely.LineString([(c * along - s * way, s * along + c * way) for way in (-reach, reach)])
        inside = max(shapely.get_parts(self.polygon.intersection(line)), key=shapely.length, default=None)
        point = shapely.shortest_line(line, self.polygon).interpolate(0.0) if inside is None else inside.centroid
        return point.x, point.y


@dataclass(frozen=True)
class Polygons(LoopRegion):
    """An area between polygons, for example one in which chords replace the circles of an outline.

    Args:
        corners: The outer polygon first, then the holes. All are counter-clockwise.
        distance_mm: The largest distance of a chord from its circle.
    """

    corners: tuple[Corners, ...]
    distance_mm: float = 0.0

    @property
    def loops(self) -> tuple[Corners, ...]:
        """The polygons."""
        return self.corners


def without_key(size_mm: tuple[float, float], key_mm: float) -> Polygons:
    """Return a rectangle from the origin without the corner at (x, 0), for a key with a leg in mm."""
    x, y = size_mm
    return Polygons((Corners(((0.0, 0.0), (x - key_mm, 0.0), (x, key_mm), (x, y), (0.0, y))),))


def key_wedge(x_mm: float, key_mm: float, beyond_mm: float) -> Corners:
    """Return the triangle that cuts a key off a rectangle: the corner at (x, 0), and a margin outside of the sides."""
    left, right = x_mm - key_mm - beyond_mm, x_mm + beyond_mm
    return Corners(((left, -beyond_mm), (right, -beyond_mm), (right, key_mm + beyond_mm)))


class Outline(LoopRegion):
    """The outline of a block: an outer loop, and perhaps holes. Subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def word(self) -> str:
        """A word for names of files, from which :func:`outline_of_word` makes the outline again: ``disc30``."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """The sides x, y of the bounding box."""
        return self.loops[0].box[1]

    def scaled(self, factor: float) -> Self:
        """Return the outline with all lengths multiplied by a factor."""
        lengths = [field.name for field in fields(self) if field.name.endswith("_mm")]  # type: ignore[arg-type]
        scaled = {name: (np.array(getattr(self, name)) * factor).tolist() for name in lengths}
        return replace(self, **scaled)  # type: ignore[type-var]

    def stretched(self, x: float, y: float) -> Outline:
        """Return the outline with its lengths along x and y multiplied by two factors.

        A circle stays a circle, with the mean of both factors.
        """
        if isinstance(corners := self.loops[0], Corners):
            return Polygon(points_mm=tuple((x * a, y * b) for a, b in corners.points))
        return self.scaled((x + y) / 2.0)

    def moved_outwards(self, by_mm: float) -> Outline:
        """Return the outline with all walls moved outwards by a distance. Its lower corner is at the origin again.

        Raises:
            InputError: A side or a hole would vanish.
        """
        corners, moved = self.loops[0], self.loops[0].moved_outwards(by_mm)
        assert isinstance(corners, Corners) and isinstance(moved, Corners)
        before, after = (np.roll(loop.array, -1, axis=0) - loop.array for loop in (corners, moved))
        if np.any(np.einsum("ij,ij->i", before, after) <= 0.0):
            raise InputError("outline", str(self), f"loses a side if its walls are moved outwards by {by_mm:g} mm")
        return Polygon(points_mm=moved.points)

    @property
    def turns(self) -> int | None:
        """The number of orientations in which the outline is the same; None if these are all orientations."""
        return None

    def chords(self, tolerance_mm: float, through: tuple[float, float] | None = None) -> Polygons:
        """Replace circles by chords within a tolerance.

        Args:
            tolerance_mm: The largest distance of a chord from its circle.
            through: A point. If it is on a circle, it becomes the end of a chord.
        """
        loops, distances = zip(*(loop.chords(tolerance_mm, through) for loop in self.loops), strict=True)
        return Polygons(loops, max(distances))


@dataclass(frozen=True, kw_only=True)
class Disc(Outline):
    """A disc.

    Args:
        diameter_mm: The diameter.
    """

    diameter_mm: float

    def __post_init__(self) -> None:
        _require_length("disc diameter", self.diameter_mm)

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The circle."""
        radius = self.diameter_mm / 2.0
        return (Circle((radius, radius), radius),)

    @property
    def word(self) -> str:
        """The word ``disc30``."""
        return f"disc{decimal(self.diameter_mm)}"

    def moved_outwards(self, by_mm: float) -> Disc:
        """Return the disc with another diameter."""
        return Disc(diameter_mm=self.diameter_mm + 2.0 * by_mm)

    def __str__(self) -> str:
        return f"disc of {decimal(self.diameter_mm)} mm"


@dataclass(frozen=True, kw_only=True)
class Ring(Outline):
    """A ring.

    Args:
        outer_mm: The outer diameter.
        inner_mm: The diameter of the hole.
    """

    outer_mm: float
    inner_mm: float

    def __post_init__(self) -> None:
        _require_length("ring outer diameter", self.outer_mm)
        _require_length("ring inner diameter", self.inner_mm)
        if self.outer_mm - self.inner_mm < 2.0 * MIN_WIDTH_MM:
            limit = self.outer_mm - 2.0 * MIN_WIDTH_MM
            most = f"must be at most {limit:g} mm for a ring at least {MIN_WIDTH_MM:g} mm wide"
            raise InputError("ring inner diameter", self.inner_mm, most)

    @property
    def loops(self) -> tuple[Loop, ...]:
        """Both circles."""
        radius = self.outer_mm / 2.0
        return (Circle((radius, radius), radius), Circle((radius, radius), self.inner_mm / 2.0))

    @property
    def word(self) -> str:
        """The word ``ring30x12``."""
        return f"ring{decimal(self.outer_mm)}x{decimal(self.inner_mm)}"

    def moved_outwards(self, by_mm: float) -> Ring:
        """Return the ring with other diameters. The hole becomes smaller."""
        return Ring(outer_mm=self.outer_mm + 2.0 * by_mm, inner_mm=self.inner_mm - 2.0 * by_mm)

    def __str__(self) -> str:
        return f"ring of {decimal(self.outer_mm)} mm with a hole of {decimal(self.inner_mm)} mm"


@dataclass(frozen=True, kw_only=True)
class RegularPolygon(Outline):
    """A regular polygon. One of its corners lies on the right, at the largest x.

    Args:
        sides: The number of sides.
        diameter_mm: The diameter of the circle through the corners.
    """

    sides: int
    diameter_mm: float

    def __post_init__(self) -> None:
        _require_length("polygon diameter", self.diameter_mm)
        least, most = CORNERS_RANGE
        if isinstance(self.sides, bool) or not isinstance(self.sides, int) or not least <= self.sides <= most:
            raise InputError("polygon sides", self.sides, f"must be a whole number from {least} to {most}")
        side = self.diameter_mm * math.sin(math.pi / self.sides)
        if side < MIN_SIDE_MM:
            raise InputError("polygon sides", self.sides, f"makes sides of {side:.2g} mm; use a disc")

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """The polygon."""
        angles = 2.0 * math.pi * np.arange(self.sides) / self.sides
        points = self.diameter_mm / 2.0 * np.column_stack([np.cos(angles), np.sin(angles)]).round(15)
        return (Corners.of(points - points.min(axis=0)),)

    @property
    def word(self) -> str:
        """The word ``6gon30``."""
        return f"{self.sides}gon{decimal(self.diameter_mm)}"

    @property
    def turns(self) -> int | None:
        """The number of sides."""
        return self.sides

    def __str__(self) -> str:
        names = {sides: name for name, sides in NAMED.items()}
        name = names.get(self.sides, f"regular polygon with {self.sides} sides")
        return f"{name} in a circle of {decimal(self.diameter_mm)} mm"


@dataclass(frozen=True, kw_only=True)
class Polygon(Outline):
    """A polygon of any shape. Its sides must not cross or touch each other.

    Args:
        points_mm: The corners in either direction. They are moved so that the lower corner of their box is the origin.
    """

    points_mm: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        try:
            points = np.array([(float(x), float(y)) for x, y in self.points_mm])
        except (TypeError, ValueError):
            raise InputError("polygon points", self.points_mm, "must be a list of points (x, y) in mm") from None
        least, most = CORNERS_RANGE
        if not least <= len(points) <= most:
            raise InputError("polygon points", len(points), f"must be from {least} to {most} points")
        if not np.isfinite(points).all():
            raise InputError("polygon points", self.points_mm, "must be finite numbers of mm")
        points = (points - points.min(axis=0)).round(_DECIMALS)
        if not shapely.LinearRing(points).is_ccw:
            points = points[::-1]
        short = float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).min())
        if short < MIN_SIDE_MM:
            raise InputError("polygon points", None, f"has a side of {short:.2g} mm, but must have {MIN_SIDE_MM:g} mm")
        if not shapely.Polygon(points).is_valid:
            raise InputError("polygon points", None, "has sides that cross or touch each other")
        object.__setattr__(self, "points_mm", tuple(map(tuple, (points + 0.0).tolist())))

    @cached_property
    def loops(self) -> tuple[Loop, ...]:
        """The polygon."""
        return (Corners(self.points_mm),)

    @property
    def word(self) -> str:
        """The word ``poly0x0x20x0x10x15`` with the coordinates of the corners."""
        return "poly" + "x".join(decimal(value) for point in self.points_mm for value in point)

    @cached_property
    def turns(self) -> int | None:
        """The number of orientations in which the polygon is the same."""
        polygon, count = self.loops[0].polygon, len(self.points_mm)
        turned = {
            turns: shapely.affinity.rotate(polygon, 360.0 / turns, origin=polygon.centroid)
            for turns in range(2, count + 1)
            if count % turns == 0
        }
        near = 1e-6 * max(self.size_mm)
        return max((turns for turns, one in turned.items() if polygon.hausdorff_distance(one) < near), default=1)

    def __str__(self) -> str:
        return f"polygon with {len(self.points_mm)} corners"


def outline_of(word: str, size_mm: tuple[float, float]) -> Outline:
    """Return the outline for a word of the command line or of a texture file.

    Args:
        word: ``disc``, ``hexagon`` and so on, or ``ring``, for the largest one in a rectangle; or with sizes:
            ``disc:30``, ``hexagon:30``, ``ring:30,12``, ``polygon:0,0,20,0,10,15``. The words in names of files are
            allowed as well, such as ``disc30``.
        size_mm: The sides of the rectangle.

    Raises:
        InputError: The word or a size is not allowed.
    """
    if (known := outline_of_word(word)) is not None:
        return known
    name, _, rest = word.strip().lower().partition(":")
    try:
        numbers = [float(number) for number in rest.split(",")] if rest else []
    except ValueError:
        raise InputError("outline", word, "must have numbers of mm after the colon, such as disc:30") from None
    kinds = {"disc": "disc", "ring": "ring", **{name: f"{sides}gon" for name, sides in NAMED.items()}}
    if name != "polygon" and name not in kinds:
        raise InputError("outline", word, f"{nearest(name, kinds)}; corners are written as polygon:0,0,20,0,10,15")
    if not numbers and name == "ring":
        numbers = [min(size_mm), min(size_mm) / 2.0]
    elif not numbers and name in kinds:
        x, y = (1.0, 1.0) if name == "disc" else RegularPolygon(sides=NAMED[name], diameter_mm=1.0).size_mm
        largest = min(size_mm[0] / x, size_mm[1] / y)
        numbers = [largest if name == "disc" else math.floor(100.0 * largest + 1e-6) / 100.0]
    outline = _outline(kinds.get(name, "poly"), numbers)
    if outline is None and name == "polygon":
        raise InputError("outline", word, "must have at least three corners: polygon:0,0,20,0,10,15")
    if outline is None:
        raise InputError("outline", word, f"write {name} or {'ring:30,12' if name == 'ring' else f'{name}:30'}")
    return outline


def outline_of_word(word: str) -> Outline | None:
    """Return the outline for a word in the name of a file, or None if the word is not that of an outline."""
    match = re.fullmatch(r"(disc|ring|poly|\d+gon)(\d+(?:\.\d+)?(?:x\d+(?:\.\d+)?)*)", word)
    with contextlib.suppress(InputError):
        return _outline(match[1], [float(number) for number in match[2].split("x")]) if match else None
    return None


def _outline(kind: str, numbers: list[float]) -> Outline | None:
    """Return the outline of a kind ``disc``, ``ring``, ``6gon`` or ``poly``; None for a wrong count of numbers."""
    if kind == "poly" and len(numbers) >= 6 and len(numbers) % 2 == 0:
        return Polygon(points_mm=tuple(zip(numbers[::2], numbers[1::2], strict=True)))
    if kind == "disc" and len(numbers) == 1:
        return Disc(diameter_mm=numbers[0])
    if kind == "ring" and len(numbers) == 2:
        return Ring(outer_mm=numbers[0], inner_mm=numbers[1])
    if kind.endswith("gon") and len(numbers) == 1:
        return RegularPolygon(sides=int(kind.removesuffix("gon")), diameter_mm=numbers[0])
    return None


def _require_length(field: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(field, value, "must be a number of mm")
    require_between(field, float(value), MIN_SIDE_MM, 2000.0, " mm")
