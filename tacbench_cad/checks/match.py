"""Which block a relief is: every candidate in every placement, ranked by its residual."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.checks.look import Look
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.types import Floats, Ints

#: Points that rank the candidates; the chosen one is then measured at all of them.
RANKING_POINTS = 600
#: A candidate further down the list must be this much nearer to be preferred.
PREFERENCE = 0.9
#: Distance from its own sample-grid surface up to which a mesh is that surface: float32 rounding, mm at scale 1.
GRID_MM = 2e-5
#: Differences of residuals below this do not decide, in mm.
INDIFFERENT_MM = 1e-7


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a block lies in its file.

    Args:
        quarters: Quarter turns about z, counter-clockwise seen from above.
        mirrored: Whether it is its own mirror image (x reversed).
    """

    quarters: int
    mirrored: bool = False

    def sides(self, size_mm: tuple[float, float, float]) -> tuple[float, float]:
        """The block's own sides, from those of its box."""
        x, y, _ = size_mm
        return (y, x) if self.quarters % 2 else (x, y)

    def to_block(self, points: Floats, size_mm: tuple[float, float, float]) -> tuple[Floats, Floats]:
        """Coordinates x, y in the block's frame of points in the box frame.

        Args:
            points: Shape (k, 2) or (k, 3).
            size_mm: The box.
        """
        x, y = points[:, 0], points[:, 1]
        width, depth = size_mm[0], size_mm[1]
        turned = [(x, y), (y, width - x), (width - x, depth - y), (depth - y, x)][self.quarters]
        return (self.sides(size_mm)[0] - turned[0], turned[1]) if self.mirrored else turned


#: In order of preference: a mirror image only where no turn will do.
PLACEMENTS = tuple(Placement(quarters=q, mirrored=m) for m in (False, True) for q in range(4))


@dataclass(frozen=True, kw_only=True)
class Residual:
    """How far a relief lies from a candidate.

    Attributes:
        largest_mm: Largest distance.
        rms_mm: Root mean square distance.
        at_mm: x, y, z in the box frame of the largest.
        above_mm: How much higher than it should the whole relief stands; taken off before the distances.
    """

    largest_mm: float
    rms_mm: float
    at_mm: tuple[float, float, float]
    above_mm: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A block that a file may be.

    Args:
        block: The block.
        as_solid: Compare with the formula at the solid's datum, also where the block has a sample grid.
        stretch: What the file's sides x, y, z are of the block's; other than 1 the comparison is made after
            shrinking it back.
    """

    block: Block
    as_solid: bool = False
    stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def on_grid(self) -> bool:
        """Whether straight lines between samples are meant, and not the formula."""
        return isinstance(self.block.sampling, SampleGrid) and not self.as_solid

    @property
    def datum_mm(self) -> float:
        """Height z of the formula's zero, in mm."""
        return self.block.solid_datum_mm if self.as_solid else self.block.datum_mm

    @cached_property
    def _compare(self) -> Callable[[Floats, Floats, Floats], tuple[Floats, Floats]]:
        """From x, y and z above the datum: signed height above the surface, and its slope."""
        if self.on_grid:
            return Facets(self.block)
        return _Formula(self.block.surface)

    def heights(self, points: Floats, look: Look, placement: Placement) -> tuple[Floats, Floats]:
        """How far points stand above the candidate (z less formula, the datum not taken off), and the slope there."""
        x, y = placement.to_block(points, look.size_mm)
        fx, fy, fz = self.stretch
        return self._compare(x / fx, y / fy, points[:, 2] / fz)

    def rank(self, points: Floats, look: Look, placement: Placement) -> float:
        """The rms residual at some points, with the best height taken off."""
        above, slope = self.heights(points, look, placement)
        off = (above - np.median(above)) / np.sqrt(1.0 + slope**2)
        return float(np.sqrt(np.mean(off**2)))

    def measure(self, look: Look, placement: Placement, near_mm: float) -> Residual:
        """The residual at all points.

        Args:
            look: The shape.
            placement: How it lies.
            near_mm: A median height up to this is no offset but the surface's own error.
        """
        above, slope = self.heights(look.points, look, placement)
        middle = float(np.median(above)) - self.datum_mm
        offset = middle if abs(middle) > near_mm else 0.0
        off = np.abs(above - self.datum_mm - offset) / np.sqrt(1.0 + slope**2)
        i = int(np.argmax(off))
        x, y, z = look.points[i].tolist()
        rms = float(np.sqrt(np.mean(off**2)))
        return Residual(largest_mm=float(off[i]), rms_mm=rms, at_mm=(x, y, z), above_mm=offset)


class _Formula:
    """Height above a formula."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def __call__(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        along_x, along_y = self.surface.gradient(x, y)
        return z - self.surface(x, y), np.hypot(along_x, along_y)


class Facets:
    """Height above the triangles between samples of a block with a sample grid.

    A cell of four samples may be cut along either diagonal; of a separable surface both give the same plane. The
    nearer of the two counts.
    """

    def __init__(self, block: Block) -> None:
        self.x, self.y = block.samples_mm
        self.z = block.surface.grid(self.x, self.y)

    def __call__(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats]:
        """Signed heights above the facets in mm, and their slopes, at places in mm; all of shape (n,)."""
        i, s, dx = _cell(self.x, x)
        j, t, dy = _cell(self.y, y)
        z00, z10, z01, z11 = self.z[i, j], self.z[i + 1, j], self.z[i, j + 1], self.z[i + 1, j + 1]
        rising = np.where(s >= t, z00 + s * (z10 - z00) + t * (z11 - z10), z00 + t * (z01 - z00) + s * (z11 - z01))
        falling = np.where(
            s + t <= 1.0,
            z00 + s * (z10 - z00) + t * (z01 - z00),
            z11 + (1.0 - s) * (z01 - z11) + (1.0 - t) * (z10 - z11),
        )
        # Which diagonal is nearer depends on the datum: it is taken off by the median, as in the ranking.
        first, second = z - rising, z - falling
        middle = np.median(first)
        nearer = np.where(np.abs(first - middle) <= np.abs(second - middle), first, second)
        slope_x = ((z10 - z00) * (1.0 - t) + (z11 - z01) * t) / dx
        slope_y = ((z01 - z00) * (1.0 - s) + (z11 - z10) * s) / dy
        return nearer, np.hypot(slope_x, slope_y)


def _cell(lines: Floats, at: Floats) -> tuple[Ints, Floats, float]:
    """Index of the cell, place within it (0 to 1) and its width, on equally spaced lines."""
    step = float(lines[1] - lines[0])
    index = np.clip((at / step).astype(np.int64), 0, len(lines) - 2)
    return index, np.clip(at / step - index, 0.0, 1.0), step


@dataclass(frozen=True, eq=False)
class Match:
    """The candidate that a relief is nearest to.

    Args:
        candidate: The candidate.
        placement: How it lies.
        rms_mm: The rms residual at the ranking points.
    """

    candidate: Candidate
    placement: Placement
    rms_mm: float


def nearest(look: Look, candidates: Callable[[Look, Placement], Iterable[Candidate]]) -> Match | None:
    """The best match of a relief.

    Args:
        look: The shape; it must have points.
        candidates: For the shape and a placement (of which only the sides count: which of them is x) the candidates
            in order of preference.

    Returns:
        The match; None where there is no candidate.
    """
    some = np.random.default_rng(0).choice(len(look.points), min(len(look.points), RANKING_POINTS), replace=False)
    points = look.points[some]
    by_sides = [list(candidates(look, placement)) for placement in PLACEMENTS[:2]]
    best: Match | None = None
    for placement in PLACEMENTS:
        for candidate in by_sides[placement.quarters % 2]:
            rms = candidate.rank(points, look, placement)
            if best is None or rms < PREFERENCE * best.rms_mm - INDIFFERENT_MM:
                best = Match(candidate, placement, rms)
    return best
