"""The deviations of a scanned print from its formula: a map of the top, the walls, and their numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.extensions.scan.cloud import Cloud
from tacbench_cad.extensions.scan.estimates import ScanFit
from tacbench_cad.spec import EDGE_MM, SKIN_MM, Block, Extrema, crest_errors, pin_shifts_px, points_of, without_edge
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Ints

#: The wanted number of points in each cell of the map, and the range of the cells' sides, in mm.
POINTS_PER_CELL = 6.0
CELL_RANGE_MM = (0.05, 1.0)
#: The largest fraction of the deviations that the second number of a summary leaves out.
_TAIL = 0.05


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The size of many deviations.

    Args:
        count: The number of deviations: cells of the top, or points of walls.
        mean_mm: Their mean; positive if the print is too large.
        rms_mm: Their root mean square.
        within_95_mm: The absolute value that 95 % of them do not exceed.
        largest_mm: The largest absolute value.
    """

    count: int
    mean_mm: float
    rms_mm: float
    within_95_mm: float
    largest_mm: float

    @classmethod
    def of(cls, deviations_mm: Floats) -> Summary | None:
        """Summarize deviations of any shape; NaN is left out. None if nothing is left."""
        known = deviations_mm[np.isfinite(deviations_mm)]
        if len(known) == 0:
            return None
        sizes = np.abs(known)
        return cls(
            count=len(known),
            mean_mm=float(known.mean()),
            rms_mm=float(np.sqrt(np.mean(known**2))),
            within_95_mm=float(np.quantile(sizes, 1.0 - _TAIL)),
            largest_mm=float(sizes.max()),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class TopMap:
    """The deviation of the top on a grid.

    Args:
        block: The block.
        x_mm: The x coordinates of the cells' middles, shape (n,).
        y_mm: The y coordinates, shape (m,).
        deviation_mm: The mean of the points' signed deviations along the outward normal, shape (n, m); NaN for a cell
            without points.
        height_error_mm: The same along z: print minus formula.
        counts: The number of points in each cell.
        stretch: The scales and skews of the print that the deviation does not contain, shape (3, 3).
        noise_mm: The standard deviation of the noise of a single point.
        layer_mm: The error from which a crest counts as lost.
    """

    block: Block
    x_mm: Floats
    y_mm: Floats
    deviation_mm: Floats
    height_error_mm: Floats
    counts: Ints
    stretch: Floats
    noise_mm: float
    layer_mm: float

    @property
    def cell_mm(self) -> float:
        """The side of a cell."""
        return float(math.sqrt(self.block.size_mm[0] / len(self.x_mm) * self.block.size_mm[1] / len(self.y_mm)))

    @cached_property
    def inside(self) -> Bools:
        """Whether a cell is not near the edge, shape (n, m)."""
        return without_edge(self.block, self.x_mm, self.y_mm)

    @cached_property
    def compared(self) -> Bools:
        """Whether a cell is compared: it is not near the edge, and has points. Shape (n, m)."""
        return self.inside & (self.counts > 0)

    @property
    def seen_fraction(self) -> float:
        """The fraction of the top, without its edge, that has points."""
        return float(self.compared.sum() / self.inside.sum())

    @cached_property
    def formula_mm(self) -> Floats:
        """The heights of the formula above the underside, shape (n, m)."""
        return self.block.datum_mm + self.block.surface.grid(self.x_mm, self.y_mm)

    @property
    def printed_mm(self) -> Floats:
        """The heights of the print, shape (n, m); NaN for a cell without points."""
        return self.formula_mm + self.height_error_mm

    @cached_property
    def summary(self) -> Summary | None:
        """The numbers of the compared cells."""
        return Summary.of(self.deviation_mm[self.compared])

    @cached_property
    def noise_rms_mm(self) -> float:
        """The part of the root mean square that the noise of single points causes."""
        counts = self.counts[self.compared]
        return float(self.noise_mm * np.sqrt(np.mean(1.0 / counts))) if len(counts) else math.nan

    @cached_property
    def peaks(self) -> Extrema:
        """The errors at the crests of the formula; see :mod:`tacbench_cad.spec.crest_errors`."""
        return crest_errors.peaks(*self._surfaces)

    @cached_property
    def valleys(self) -> Extrema:
        """The errors at the valleys of the formula."""
        return crest_errors.valleys(*self._surfaces)

    @property
    def _surfaces(self) -> tuple[Floats, Floats, Bools, Floats, Floats, float]:
        return self.formula_mm, self.printed_mm, self.inside, self.x_mm, self.y_mm, self.layer_mm

    @cached_property
    def pin_shifts_px(self) -> Floats:
        """How far the deviation moves the pins of a TacTip, shape (n, m); NaN where it is unknown.

        The sensor feels the whole deviation, also that of the scale and the skew. They are therefore put back, about
        the middle of the block. It feels the edge of the block more than any deviation near it, so that a strip of the
        skin's thickness is left out along the edge.
        """
        x, y, z = self.x_mm[:, None], self.y_mm[None, :], self.formula_mm
        middle = np.array([*self.block.size_mm, 0.0]) / 2.0
        middle[2] = float(z.mean())
        places = np.stack(np.broadcast_arrays(x, y, z), axis=-1) - middle
        nominal = places @ np.linalg.inv(self.stretch).T + middle
        moved = self.block.height_at(nominal[..., 0], nominal[..., 1]) - z
        relief = (self.stretch[2, 2] - 1.0) * (z - middle[2])
        whole = np.where(self.counts > 0, self.height_error_mm + moved + relief, np.nan)
        edge = min(EDGE_MM + SKIN_MM, min(self.block.size_mm) / 4.0)
        inside = without_edge(self.block, self.x_mm, self.y_mm, edge)
        return np.where(inside, pin_shifts_px(whole, self.cell_mm), np.nan)

    @cached_property
    def pin_shift_px(self) -> float | None:
        """The root mean square of :attr:`pin_shifts_px`; None if nothing is known."""
        known = self.pin_shifts_px[np.isfinite(self.pin_shifts_px)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else None


@dataclass(frozen=True, kw_only=True, eq=False)
class WallPoints:
    """The deviations of the walls' points.

    Args:
        points_mm: The points in the block frame, with the scale and the skew undone, shape (n, 3).
        deviation_mm: The signed deviations along the outward normal, shape (n,).
        outward_mm: How far each point lies outside of the nominal wall, with the scale and the skew, shape (n,).
    """

    points_mm: Floats
    deviation_mm: Floats
    outward_mm: Floats

    @cached_property
    def summary(self) -> Summary | None:
        """The numbers of the walls; None if no wall was scanned."""
        return Summary.of(self.deviation_mm)

    @property
    def outward_95_mm(self) -> float | None:
        """The distance outside of the nominal walls that 95 % of the points do not exceed; None without walls."""
        return float(np.quantile(self.outward_mm, 1.0 - _TAIL)) if len(self.outward_mm) else None


def top_map(cloud: Cloud, block: Block, fit: ScanFit, *, layer_mm: float, cell_mm: float | None = None) -> TopMap:
    """Return the map of the top's deviation.

    Args:
        cloud: The scan.
        block: The block.
        fit: The fit of the scan to the block.
        layer_mm: The height of a layer, from which a crest counts as lost.
        cell_mm: The side of a cell; None to choose it so that a cell has about six points.

    Raises:
        InputError: No point of the scan lies on the top.
    """
    which = fit.used & fit.on_top & np.isfinite(fit.deviation_mm)
    if not which.any():
        raise InputError("scan", cloud.source, "has no point on the top of the block; scan the top")
    points, deviation = fit.pose.to_block(cloud.points_mm[which]), fit.deviation_mm[which]
    if cell_mm is None:
        seen_mm2 = block.footprint_mm2  # a partial scan has smaller cells than it could have
        cell_mm = float(np.clip(math.sqrt(POINTS_PER_CELL * seen_mm2 / len(points)), *CELL_RANGE_MM))
    x, y = points_of(block, cell_mm)
    at = _cell(points[:, 0], x, block.size_mm[0]) * len(y) + _cell(points[:, 1], y, block.size_mm[1])
    x_on, y_on = (np.clip(points[:, i], 0.0, block.size_mm[i]) for i in (0, 1))
    counts = np.bincount(at, minlength=len(x) * len(y))

    def mean(values: Floats) -> Floats:
        sums = np.bincount(at, values, len(x) * len(y))
        return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan).reshape(len(x), len(y))

    return TopMap(
        block=block,
        x_mm=x,
        y_mm=y,
        deviation_mm=mean(deviation),
        height_error_mm=mean(points[:, 2] - block.height_at(x_on, y_on)),
        counts=counts.reshape(len(x), len(y)),
        stretch=fit.pose.stretch,
        noise_mm=fit.noise_mm,
        layer_mm=layer_mm,
    )


def _cell(along_mm: Floats, middles_mm: Floats, side_mm: float) -> Ints:
    return np.clip((along_mm / side_mm * len(middles_mm)).astype(np.int64), 0, len(middles_mm) - 1)


def wall_points(cloud: Cloud, block: Block, fit: ScanFit) -> WallPoints:
    """Return the deviations of the points that lie on walls. A height map only shows their rim, so it has none."""
    which = fit.used & fit.on_walls & np.isfinite(fit.deviation_mm) & (cloud.grid is None)
    points, deviation = fit.pose.to_block(cloud.points_mm[which]), fit.deviation_mm[which]
    size = np.asarray(block.size_mm)
    from_middle = points[:, :2] - size / 2.0
    if block.outline is None:
        # The outward normal of the nearest of the four sides.
        relative = from_middle / size
        along = (np.arange(len(points)), np.argmax(np.abs(relative), axis=1))
        normal = np.zeros_like(relative)
        normal[along] = np.sign(relative[along])
    else:
        normal = from_middle / np.maximum(np.linalg.norm(from_middle, axis=1, keepdims=True), 1e-9)
    grown = from_middle @ (fit.pose.stretch[:2, :2] - np.eye(2)).T
    return WallPoints(
        points_mm=points, deviation_mm=deviation, outward_mm=deviation + np.einsum("ij,ij->i", grown, normal)
    )


def noise_of_repeat(first: TopMap, second: TopMap) -> float:
    """Return the root mean square of the noise in a map's cells, from the map of a second scan of the same print.

    Errors of the scanner that are the same in both scans cancel, and do not count as noise.

    Args:
        first: The map of the first scan.
        second: The map of the second scan, on the same grid.

    Raises:
        InputError: The grids differ, or the scans have no part of the top in common.
    """
    if first.deviation_mm.shape != second.deviation_mm.shape:
        raise InputError("repeat", None, "must be on the same grid as the first scan")
    both = first.compared & second.compared
    if not both.any():
        raise InputError("repeat", None, "shows no part of the top that the first scan shows")
    difference = (first.deviation_mm - second.deviation_mm)[both]
    return float(np.std(difference) / math.sqrt(2.0))


def noise_of_flat(cloud: Cloud) -> float:
    """Return the noise of single points from the scan of a flat plate: the standard deviation about its plane.

    The furthest 1 % of the points are left out.

    Raises:
        InputError: The scan has fewer than 100 points.
    """
    if len(cloud) < 100:
        raise InputError("flat", cloud.source, f"has {len(cloud)} points; it must have at least 100")
    points = cloud.points_mm - cloud.points_mm.mean(axis=0)
    for _ in range(3):
        normal = np.linalg.svd(points[:: max(1, len(points) // 100_000)], full_matrices=False)[2][2]
        off = points @ normal
        kept = np.abs(off) <= np.quantile(np.abs(off), 0.99)
        points = points[kept] - points[kept].mean(axis=0)
    return float(np.std(points @ normal))
