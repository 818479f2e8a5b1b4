"""Outlines of blocks (disc, polygon, ring), and functions for closed polygons in the plane.

The lower corner of the bounding box of an outline is at the origin, as in the block frame. Lengths are in mm.
"""

from __future__ import annotations

import itertools
import math
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError, nearest, require_between
from tacbench_cad.util.text import decimal
from tacbench_cad.util.types import Bools, Floats

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
    total = 0.0
    for outline in outlines:
        x, y = outline.T
        total += float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2.0
    return total


def is_inside(point: Floats, outlines: Iterable[Floats]) -> bool:
    """Whether a point (2,) lies inside closed outlines, by the even-odd rule."""
    crossings = 0
    for outline in outlines:
        a, b = outline, np.roll(outline, -1, axis=0)
        spans = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
        a, b = a[spans], b[spans]
        x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
        crossings += int(np.count_nonzero(x > point[0]))
    return crossings % 2 == 1


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

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distances of points from the circle. Distances of points inside are negative."""
        return np.asarray(np.hypot(x - self.centre[0], y - self.centre[1]) - self.radius)

    def nearest(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the nearest points on the circle."""
        dx, dy = x - self.centre[0], y - self.centre[1]
        length = np.hypot(dx, dy)
        factor = self.radius / np.where(length == 0.0, 1.0, length)
        at_centre = length == 0.0
        return self.centre[0] + np.where(at_centre, self.radius, dx * factor), self.centre[1] + dy * factor

    def ends(self, direction: tuple[float, float]) -> list[tuple[float, float]]:
        """Return the points that lie furthest along a unit vector, in both ways."""
        (u, v), (c, s), r = self.centre, direction, self.radius
        return [(u - r * c, v - r * s), (u + r * c, v + r * s)]

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over the disc inside."""
        if (waves := surface.plane_waves) is not None:
            return self._integral_of_waves(waves)
        n = _INTEGRAL_SIDES
        radius = self.radius * math.sqrt(2.0 * math.pi / (n * math.sin(2.0 * math.pi / n)))
        turns = 2.0 * math.pi * (np.arange(n) + 0.5) / n
        points = np.array(self.centre) + radius * np.column_stack([np.cos(turns), np.sin(turns)])
        return Corners(tuple(map(tuple, points.tolist()))).integral(surface)

    def _integral_of_waves(self, waves: tuple[Wave, ...]) -> float:
        """Return the integral in closed form: that of a plane wave is its value at the centre times 2 pi r J1(kr)/k."""
        from scipy.special import j1

        (x, y), r = self.centre, self.radius
        amplitude, f, g, phase = np.array([(w.amplitude, w.f, w.g, w.phase) for w in waves]).reshape(-1, 4).T
        k = np.hypot(f, g) * r
        shrink = np.where(k == 0.0, 1.0, 2.0 * j1(k) / np.where(k == 0.0, 1.0, k))
        return float(self.area_mm2 * np.sum(amplitude * np.sin(f * x + g * y + phase) * shrink))

    def chords(self, tolerance_mm: float, through: tuple[float, float] | None) -> tuple[Floats, float]:
        """Return points on the circle, counter-clockwise, shape (n, 2), and the distance of their chords from it.

        Args:
            tolerance_mm: The largest allowed distance.
            through: A point. If it is on the circle, it becomes one of the points.
        """
        step = 2.0 * math.acos(max(1.0 - tolerance_mm / self.radius, 0.5))
        marks = [0.0, 0.5, 1.0, 1.5, 2.0]
        if through is not None:
            dx, dy = through[0] - self.centre[0], through[1] - self.centre[1]
            if abs(math.hypot(dx, dy) - self.radius) < 1e-6 * self.radius:
                own = math.atan2(dy, dx) % (2.0 * math.pi) / math.pi
                if min(abs(own - mark) for mark in marks) > 1e-4:
                    marks = sorted([*marks, own])
        turns = np.concatenate(
            [
                np.linspace(a, b, math.ceil((b - a) * math.pi / step - 1e-9) + 1)[:-1]
                for a, b in itertools.pairwise(marks)
            ]
        )
        widest = float(np.diff(np.append(turns, 2.0)).max()) * math.pi
        # Whole and half turns are exact, so that the box of the points is the box of the circle.
        cosines = np.where(turns % 1.0 == 0.5, 0.0, np.cos(math.pi * turns))
        sines = np.where(turns % 1.0 == 0.0, 0.0, np.sin(math.pi * turns))
        points = np.array(self.centre) + self.radius * np.column_stack([cosines, sines])
        return points, self.radius * (1.0 - math.cos(widest / 2.0))

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

    @cached_property
    def array(self) -> Floats:
        """The corners, shape (n, 2)."""
        return np.array(self.points, dtype=np.float64)

    @property
    def area_mm2(self) -> float:
        """The area inside."""
        return area_mm2(self.array)

    @property
    def box(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The lower and the upper corner of the bounding box."""
        (x0, y0), (x1, y1) = self.array.min(axis=0).tolist(), self.array.max(axis=0).tolist()
        return (x0, y0), (x1, y1)

    def _sides(self) -> Iterable[tuple[Floats, Floats]]:
        return zip(self.array, np.roll(self.array, -1, axis=0), strict=True)

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Return the distances of points from the polygon. Distances of points inside are negative."""
        squared = np.full(np.broadcast_shapes(x.shape, y.shape), np.inf)
        inside = np.zeros(squared.shape, dtype=np.bool_)
        for a, b in self._sides():
            dx, dy = b - a
            t = np.clip(((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
            np.minimum(squared, (x - a[0] - t * dx) ** 2 + (y - a[1] - t * dy) ** 2, out=squared)
            if dy != 0.0:
                inside ^= ((a[1] > y) != (b[1] > y)) & (x < a[0] + (y - a[1]) / dy * dx)
        distance = np.sqrt(squared)
        distance[distance < _EDGE_MM] = 0.0
        return np.asarray(np.where(inside, -distance, distance))

    def nearest(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Return the nearest points on the polygon."""
        best = np.full(x.shape, np.inf)
        at_x, at_y = np.empty(x.shape), np.empty(x.shape)
        for a, b in self._sides():
            dx, dy = b - a
            t = np.clip(((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
            p, q = a[0] + t * dx, a[1] + t * dy
            squared = (x - p) ** 2 + (y - q) ** 2
            nearer = squared < best
            best[nearer], at_x[nearer], at_y[nearer] = squared[nearer], p[nearer], q[nearer]
        return at_x, at_y

    def ends(self, direction: tuple[float, float]) -> list[tuple[float, float]]:
        """Return the points that lie furthest along a unit vector, in both ways."""
        along = self.array @ np.array(direction)
        return [self.points[int(along.argmin())], self.points[int(along.argmax())]]

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over the inside, in closed form: a sum over triangles with a sign."""
        first, total = self.points[0], 0.0
        for a, b in zip(self.points[1:-1], self.points[2:], strict=True):
            doubled = (a[0] - first[0]) * (b[1] - first[1]) - (b[0] - first[0]) * (a[1] - first[1])
            if doubled != 0.0:
                total += math.copysign(1.0, doubled) * surface.integral_triangle([first, a, b])
        return total

    def chords(self, tolerance_mm: float, through: tuple[float, float] | None) -> tuple[Floats, float]:
        """Return the corners and 0, because the sides are straight."""
        return self.array, 0.0

    def moved_outwards(self, by_mm: float) -> Corners:
        """Return the polygon with its sides moved outwards by a distance. Its corners stay sharp."""
        a, b = np.roll(self.array, 1, axis=0), self.array
        way = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
        normal = np.column_stack([way[:, 1], -way[:, 0]])
        after = np.roll(normal, -1, axis=0)
        shift = (normal + after) / (1.0 + np.einsum("ij,ij->i", normal, after))[:, None]
        return Corners(tuple(map(tuple, (self.array + by_mm * shift).tolist())))


#: A closed curve of an outline.
Loop = Circle | Corners


@dataclass(frozen=True)
class Chords:
    """The polygons of an outline in which chords replace its circles.

    Args:
        loops: The outer polygon first, then the holes. All are counter-clockwise.
        distance_mm: The largest distance of a chord from its circle.
    """

    loops: tuple[Corners, ...]
    distance_mm: float

    @property
    def area_mm2(self) -> float:
        """The area between the outer polygon and the holes."""
        return self.loops[0].area_mm2 - sum(hole.area_mm2 for hole in self.loops[1:])

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over this area."""
        return self.loops[0].integral(surface) - sum(hole.integral(surface) for hole in self.loops[1:])


class Outline(ABC):
    """The outline of a block: an outer loop, and perhaps holes. Subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def loops(self) -> tuple[Loop, ...]:
        """The outer loop first, then the holes. All are counter-clockwise."""

    @property
    @abstractmethod
    def word(self) -> str:
        """A word for names of files, from which :func:`outline_of_word` makes the outline again: ``disc30``."""

    @property
    @abstractmethod
    def size_mm(self) -> tuple[float, float]:
        """The sides x, y of the bounding box."""

    @abstractmethod
    def scaled(self, factor: float) -> Outline:
        """Return the outline with all lengths multiplied by a factor."""

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

    @property
    def area_mm2(self) -> float:
        """The area inside of the outline, without its holes."""
        return self.loops[0].area_mm2 - sum(hole.area_mm2 for hole in self.loops[1:])

    def integral(self, surface: Surface) -> float:
        """Return the integral of a surface over this area."""
        return self.loops[0].integral(surface) - sum(hole.integral(surface) for hole in self.loops[1:])

    def chords(self, tolerance_mm: float, through: tuple[float, float] | None = None) -> Chords:
        """Replace circles by chords within a tolerance.

        Args:
            tolerance_mm: The largest distance of a chord from its circle.
            through: A point. If it is on a circle, it becomes the end of a chord.
        """
        parts = [loop.chords(tolerance_mm, through) for loop in self.loops]
        loops = tuple(Corners(tuple(map(tuple, points.tolist()))) for points, _ in parts)
        return Chords(loops, max(far for _, far in parts))

    def distance(self, u: ArrayLike, v: ArrayLike) -> Floats:
        """Return the distances of points from the inside of the outline. Points inside have negative distances."""
        x, y = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        shape, x, y = x.shape, x.reshape(-1), y.reshape(-1)
        distance = self.loops[0].distance(x, y)
        for hole in self.loops[1:]:
            distance = np.maximum(distance, -hole.distance(x, y))
        return np.asarray(distance.reshape(shape))

    excess = distance

    def meets(self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats) -> Bools:
        """Return which cells can have points inside. Cells are given by their centres and half sides."""
        return np.asarray(self.excess(u, v) <= np.hypot(half_u, half_v))

    def inner_points(
        self, u: Floats, v: Floats, half_u: float | Floats, half_v: float | Floats
    ) -> tuple[Floats, Floats]:
        """Return the centres of cells, or the nearest points of the outline for centres that are not inside."""
        x, y = np.array(u, dtype=np.float64), np.array(v, dtype=np.float64)
        for number, loop in enumerate(self.loops):
            off = loop.distance(x, y) > 0.0 if number == 0 else loop.distance(x, y) < 0.0
            x[off], y[off] = loop.nearest(x[off], y[off])
        return x, y

    def ends(self, direction: tuple[float, float]) -> list[tuple[float, float]]:
        """Return the points that lie furthest along a unit vector, in both ways."""
        return self.loops[0].ends(direction)

    def point_on(self, start: tuple[float, float], direction: tuple[float, float]) -> tuple[float, float]:
        """Return the point inside that is nearest to a point, on the line through it at right angles to a direction."""
        along = 2.0 * max(self.size_mm) * np.linspace(-1.0, 1.0, 40_001)
        along = along[np.argsort(np.abs(along), kind="stable")]
        x, y = start[0] - direction[1] * along, start[1] + direction[0] * along
        excess = self.excess(x, y)
        inside = np.flatnonzero(excess <= 0.0)
        k = int(inside[0]) if len(inside) else int(np.argmin(excess))
        return float(x[k]), float(y[k])


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

    @property
    def size_mm(self) -> tuple[float, float]:
        """The diameter, twice."""
        return (self.diameter_mm, self.diameter_mm)

    def scaled(self, factor: float) -> Disc:
        """Return the disc with another diameter."""
        return Disc(diameter_mm=self.diameter_mm * factor)

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

    @property
    def size_mm(self) -> tuple[float, float]:
        """The outer diameter, twice."""
        return (self.outer_mm, self.outer_mm)

    def scaled(self, factor: float) -> Ring:
        """Return the ring with other diameters."""
        return Ring(outer_mm=self.outer_mm * factor, inner_mm=self.inner_mm * factor)

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
    def _points(self) -> Floats:
        turns = 2.0 * math.pi * np.arange(self.sides) / self.sides
        points = self.diameter_mm / 2.0 * np.column_stack([np.cos(turns), np.sin(turns)]).round(15)
        return np.asarray(points - points.min(axis=0))

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The polygon."""
        return (Corners(tuple(map(tuple, self._points.tolist()))),)

    @property
    def word(self) -> str:
        """The word ``6gon30``."""
        return f"{self.sides}gon{decimal(self.diameter_mm)}"

    @property
    def size_mm(self) -> tuple[float, float]:
        """The sides of the bounding box."""
        x, y = self._points.max(axis=0).tolist()
        return (x, y)

    @property
    def turns(self) -> int | None:
        """The number of sides."""
        return self.sides

    def scaled(self, factor: float) -> RegularPolygon:
        """Return the polygon with another diameter."""
        return RegularPolygon(sides=self.sides, diameter_mm=self.diameter_mm * factor)

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
        if area_mm2(points) < 0.0:
            points = points[::-1]
        short = float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).min())
        if short < MIN_SIDE_MM:
            raise InputError("polygon points", None, f"has a side of {short:.2g} mm, but must have {MIN_SIDE_MM:g} mm")
        if _crosses(points):
            raise InputError("polygon points", None, "has sides that cross or touch each other")
        object.__setattr__(self, "points_mm", tuple(map(tuple, (points + 0.0).tolist())))

    @property
    def loops(self) -> tuple[Loop, ...]:
        """The polygon."""
        return (Corners(self.points_mm),)

    @property
    def word(self) -> str:
        """The word ``poly0x0x20x0x10x15`` with the coordinates of the corners."""
        return "poly" + "x".join(decimal(value) for point in self.points_mm for value in point)

    @property
    def size_mm(self) -> tuple[float, float]:
        """The sides of the bounding box."""
        x, y = np.max(self.points_mm, axis=0).tolist()
        return (x, y)

    @cached_property
    def turns(self) -> int | None:
        """The number of orientations in which the polygon is the same."""
        points = np.array(self.points_mm)
        middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
        centred = points - points.mean(axis=0)
        near = 1e-6 * float(np.abs(points - middle).max())

        def same(turns: int) -> bool:
            angle = 2.0 * math.pi / turns
            c, s = math.cos(angle), math.sin(angle)
            turned = centred @ np.array([[c, s], [-s, c]])
            return bool(np.linalg.norm(turned[:, None] - centred[None], axis=2).min(axis=1).max() < near)

        return max((turns for turns in range(2, len(points) + 1) if same(turns)), default=1)

    def scaled(self, factor: float) -> Polygon:
        """Return the polygon with other corners."""
        return Polygon(points_mm=tuple((x * factor, y * factor) for x, y in self.points_mm))

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
    sides = NAMED.get(name)
    counts = {"disc": (0, 1), "ring": (0, 2), **dict.fromkeys(NAMED, (0, 1))}
    if name == "polygon" and len(numbers) >= 6 and len(numbers) % 2 == 0:
        return Polygon(points_mm=tuple(zip(numbers[::2], numbers[1::2], strict=True)))
    if name == "polygon":
        raise InputError("outline", word, "must have at least three corners: polygon:0,0,20,0,10,15")
    if name not in counts:
        raise InputError("outline", word, f"{nearest(name, counts)}; corners are written as polygon:0,0,20,0,10,15")
    if len(numbers) not in counts[name]:
        example = {"disc": "disc:30", "ring": "ring:30,12"}.get(name, f"{name}:30")
        raise InputError("outline", word, f"write {name} or {example}")
    if name == "disc":
        return Disc(diameter_mm=numbers[0] if numbers else min(size_mm))
    if name == "ring":
        outer, inner = numbers or (min(size_mm), min(size_mm) / 2.0)
        return Ring(outer_mm=outer, inner_mm=inner)
    assert sides is not None
    if numbers:
        return RegularPolygon(sides=sides, diameter_mm=numbers[0])
    x, y = RegularPolygon(sides=sides, diameter_mm=1.0).size_mm
    largest = min(size_mm[0] / x, size_mm[1] / y)
    return RegularPolygon(sides=sides, diameter_mm=math.floor(100.0 * largest + 1e-6) / 100.0)


def outline_of_word(word: str) -> Outline | None:
    """Return the outline for a word in the name of a file, or None if the word is not that of an outline."""
    number = r"\d+(?:\.\d+)?"
    try:
        if match := re.fullmatch(f"disc({number})", word):
            return Disc(diameter_mm=float(match[1]))
        if match := re.fullmatch(f"ring({number})x({number})", word):
            return Ring(outer_mm=float(match[1]), inner_mm=float(match[2]))
        if match := re.fullmatch(rf"(\d+)gon({number})", word):
            return RegularPolygon(sides=int(match[1]), diameter_mm=float(match[2]))
        if re.fullmatch(f"poly{number}(?:x{number})+", word):
            values = [float(value) for value in word.removeprefix("poly").split("x")]
            return Polygon(points_mm=tuple(zip(values[::2], values[1::2], strict=True)))
    except (InputError, ValueError):
        pass
    return None


def _require_length(field: str, value: object) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(field, value, "must be a number of mm")
    require_between(field, float(value), MIN_SIDE_MM, 2000.0, " mm")


def _crosses(points: Floats) -> bool:
    """Return whether two sides of a closed polygon cross or touch each other, other than neighbours at their corner."""
    count = len(points)
    a, b = points, np.roll(points, -1, axis=0)
    way = b - a

    def side(p: Floats) -> Floats:
        x, y = p[None, :, 0] - a[:, None, 0], p[None, :, 1] - a[:, None, 1]
        return np.asarray(way[:, None, 0] * y - way[:, None, 1] * x)

    start, end = side(a), side(b)
    meets = (start * end <= 0.0) & (start * end <= 0.0).T
    i, j = np.triu_indices(count, 1)
    apart = (j - i > 1) & (j - i < count - 1)
    crossed = meets[i, j] & apart
    # parallel sides on one line only touch if their boxes overlap
    low, high = np.minimum(a, b), np.maximum(a, b)
    boxes = np.all((low[i] <= high[j]) & (low[j] <= high[i]), axis=1)
    folded = np.einsum("ij,ij->i", way, np.roll(way, -1, axis=0)) <= -(1.0 - 1e-12) * np.linalg.norm(
        way, axis=1
    ) * np.linalg.norm(np.roll(way, -1, axis=0), axis=1)
    return bool((crossed & boxes).any() or folded.any())
