"""The search for the block that is nearest to a relief: it tries every candidate in every placement."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.checks.body_shape import BodyShape
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.types import Bools, Floats, Ints

#: The number of points for the ranking of the candidates. The distance from the best candidate is then computed at all
#: points.
RANKING_POINTS = 600
#: A later candidate replaces an earlier candidate if its residual is less than this fraction of the earlier residual.
PREFERENCE = 0.9
#: The largest allowed distance of a mesh from the surface on its sample grid, in mm at scale 1. It covers the rounding
#: to float32.
GRID_MM = 2e-5
#: A later candidate must also have a residual that is smaller by more than this, in mm.
MIN_DIFFERENCE_MM = 1e-7


@dataclass(frozen=True, kw_only=True)
class FoundPlacement:
    """The orientation of a block in its file.

    Args:
        quarters: The number of quarter turns about z, counter-clockwise if seen from above.
        mirrored: Whether the block is mirrored (x reversed).
    """

    quarters: int
    mirrored: bool = False

    def sides(self, size_mm: tuple[float, float, float]) -> tuple[float, float]:
        """Return the sides of the block along its own x and y, given the size of its bounding box in the file."""
        x, y, _ = size_mm
        return (y, x) if self.quarters % 2 else (x, y)

    def to_block(self, points: Floats, size_mm: tuple[float, float, float]) -> tuple[Floats, Floats]:
        """Transform points from the frame of the bounding box to the frame of the block.

        Args:
            points: The points in mm, shape (k, 2) or (k, 3).
            size_mm: The size of the bounding box.

        Returns:
            The x and the y of the points, each of shape (k,).
        """
        x, y = points[:, 0], points[:, 1]
        width, depth = size_mm[0], size_mm[1]
        turned = [(x, y), (y, width - x), (width - x, depth - y), (depth - y, x)][self.quarters]
        return (self.sides(size_mm)[0] - turned[0], turned[1]) if self.mirrored else turned


#: All placements in order of preference. The mirrored placements come last.
PLACEMENTS = tuple(FoundPlacement(quarters=q, mirrored=m) for m in (False, True) for q in range(4))


@dataclass(frozen=True, kw_only=True)
class Residual:
    """The distance of a relief from a candidate.

    Attributes:
        largest_mm: The largest distance.
        rms_mm: The root mean square distance.
        at_mm: The x, y and z of the largest distance in the frame of the bounding box.
        within_mm: The largest distance of those points that are nearer than the allowed distance.
        above_mm: The height by which the whole relief is too high. It is subtracted before the distances are computed.
    """

    largest_mm: float
    rms_mm: float
    at_mm: tuple[float, float, float]
    within_mm: float
    above_mm: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A block that a file may contain.

    Args:
        block: The block.
        as_solid: Compare with the formula at the solid's datum, also if the block has a sample grid.
        stretch: The sides x, y and z of the file, as multiples of the sides of the block. The file is divided by these
            factors before the comparison.
    """

    block: Block
    as_solid: bool = False
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def on_grid(self) -> bool:
        """Whether the file is compared with straight lines between samples, and not with the formula."""
        return isinstance(self.block.sampling, SampleGrid) and not self.as_solid

    @property
    def datum_mm(self) -> float:
        """The height z of the formula's zero, in mm."""
        return self.block.solid_datum_mm if self.as_solid else self.block.datum_mm

    @cached_property
    def _compare(self) -> Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]:
        """The function of x, y and z that returns the signed height above the surface and the slope of the surface."""
        if self.on_grid:
            return Facets(self.block)
        return _Formula(self.block.surface)

    def heights(self, points: Floats, shape: BodyShape, placement: FoundPlacement) -> tuple[Floats, Floats]:
        """Return z minus the formula at all points (the datum is not subtracted), and the slope of the surface."""
        x, y = placement.to_block(points, shape.size_mm)
        fx, fy, fz = self.stretch
        return self._compare(x / fx, y / fy, points[:, 2] / fz)

    def top_mm(self, x: Floats, y: Floats) -> Floats:
        """Return the heights of the candidate's top at points of the block frame, shape (k,)."""
        return self.datum_mm - self._compare(x, y, np.zeros_like(x))[0]

    def rank(self, points: Floats, shape: BodyShape, placement: FoundPlacement) -> float:
        """Return the rms residual at some points, after subtracting the median of the heights."""
        above, slope = self.heights(points, shape, placement)
        off = (above - np.median(above)) / np.sqrt(1.0 + slope**2)
        return float(np.sqrt(np.mean(off**2)))

    def contains(self, points: Floats, shape: BodyShape, placement: FoundPlacement, within_mm: float) -> Bools:
        """Return which points of a shape are at most ``within_mm`` from the relief, shape (k,)."""
        if not len(points):
            return np.zeros(0, dtype=np.bool_)
        above, slope = self.heights(points, shape, placement)
        return np.asarray(np.abs(above - self.datum_mm) <= within_mm * np.sqrt(1.0 + slope**2))

    def measure(self, shape: BodyShape, placement: FoundPlacement, near_mm: float) -> Residual:
        """Compute the residual at all points.

        Args:
            shape: The shape.
            placement: The placement.
            near_mm: The allowed distance, and the largest height offset of the whole relief that is not corrected, in
                mm. Such a small offset can come from the error of the surface itself.
        """
        points = np.concatenate([shape.points, shape.other_points])
        above, slope = self.heights(points, shape, placement)
        median = float(np.median(above)) - self.datum_mm
        offset = median if abs(median) > near_mm else 0.0
        off = np.abs(above - self.datum_mm - offset) / np.sqrt(1.0 + slope**2)
        i = int(np.argmax(off))
        x, y, z = points[i].tolist()
        rms = float(np.sqrt(np.mean(off**2)))
        within = float(off.max(where=off <= near_mm, initial=0.0))
        return Residual(largest_mm=float(off[i]), rms_mm=rms, at_mm=(x, y, z), within_mm=within, above_mm=offset)


class _Formula:
    """The height above a formula."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        along_x, along_y = self.surface.gradient(x, y)
        return z - self.surface(x, y), np.hypot(along_x, along_y)


class Facets:
    """The height above the triangles between the samples of a block with a sample grid.

    A cell of four samples can be divided along either diagonal. For a separable surface both give the same plane. For
    other surfaces the nearer of the two pairs of triangles is used.
    """

    def __init__(self, block: Block) -> None:
        self.x, self.y = block.samples_mm
        self.z = block.surface.grid(self.x, self.y)

    def __call__(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Return the signed heights above the facets in mm, and the slopes of the facets, each of shape (n,).

        Args:
            x: The x of the points in mm, shape (n,).
            y: The y of the points in mm, shape (n,).
            z: The z of the points in mm, shape (n,).
        """
        i, s, dx = _cell(self.x, x)
        j, t, dy = _cell(self.y, y)
        z00, z10, z01, z11 = self.z[i, j], self.z[i + 1, j], self.z[i, j + 1], self.z[i + 1, j + 1]
        rising = np.where(s >= t, z00 + s * (z10 - z00) + t * (z11 - z10), z00 + t * (z01 - z00) + s * (z11 - z01))
        falling = np.where(
            s + t <= 1.0,
            z00 + s * (z10 - z00) + t * (z01 - z00),
            z11 + (1.0 - s) * (z01 - z11) + (1.0 - t) * (z10 - z11),
        )
        # The nearer diagonal depends on the datum. The median stands for the datum here, as in the ranking.
        first, second = z - rising, z - falling
        datum = np.median(first)
        nearer = np.where(np.abs(first - datum) <= np.abs(second - datum), first, second)
        slope_x = ((z10 - z00) * (1.0 - t) + (z11 - z01) * t) / dx
        slope_y = ((z01 - z00) * (1.0 - s) + (z11 - z10) * s) / dy
        return nearer, np.hypot(slope_x, slope_y)


def _cell(lines: Floats, at: Floats) -> tuple[Ints, Floats, float]:
    """Return the indices of cells between equally spaced lines, the positions within them (0 to 1), and their width."""
    step = float(lines[1] - lines[0])
    index = np.clip((at / step).astype(np.int64), 0, len(lines) - 2)
    return index, np.clip(at / step - index, 0.0, 1.0), step


@dataclass(frozen=True, eq=False)
class Match:
    """The candidate that is nearest to a relief.

    Args:
        candidate: The candidate.
        placement: Its placement.
        rms_mm: The rms residual at the ranking points.
    """

    candidate: Candidate
    placement: FoundPlacement
    rms_mm: float


def nearest(shape: BodyShape, candidates: Callable[[BodyShape, FoundPlacement], Iterable[Candidate]]) -> Match | None:
    """Return the best match of a relief.

    Args:
        shape: The shape. It must have points.
        candidates: A function that gets the shape and a placement, and returns the candidates in order of preference.
            It is called for two placements only, because the candidates depend only on which side is x.

    Returns:
        The match; None if there is no candidate.
    """
    sample = np.random.default_rng(0).choice(len(shape.points), min(len(shape.points), RANKING_POINTS), replace=False)
    points = shape.points[sample]
    by_sides = [list(candidates(shape, placement)) for placement in PLACEMENTS[:2]]
    best: Match | None = None
    for placement in PLACEMENTS:
        for candidate in by_sides[placement.quarters % 2]:
            rms = candidate.rank(points, shape, placement)
            if best is None or rms < PREFERENCE * best.rms_mm - MIN_DIFFERENCE_MM:
                best = Match(candidate, placement, rms)
    return best
