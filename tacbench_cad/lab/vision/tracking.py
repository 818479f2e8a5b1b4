"""Following markers from a reference frame, where they may move farther than they lie apart.

The nearest marker of another frame is the wrong one as soon as markers move by half their spacing. But the skin is
continuous: a marker moves nearly as its neighbours do. So the displacements are written as few smooth functions over
the reference, and fitted to all markers of the frame at once: each marker of the reference is drawn towards a mean of
those near its prediction, at first over more than a spacing, then over less and less (softassign with annealing: Chui
and Rangarajan 2003, "A new point matching algorithm for non-rigid registration"). In the end the markers are assigned
one to one by SciPy (``linear_sum_assignment``) to predictions from their neighbours, and what contradicts these is left
out. Where many markers stay without a partner, the whole is tried again from shifts of the whole field.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Ints

#: Neighbours that a displacement is predicted from.
NEIGHBOURS = 10
#: The smooth functions: Gaussians of this width, as a fraction of the field's radius, and how many of them.
_WIDTH, _FUNCTIONS = 0.4, 40
#: The annealing: width of the assignment in spacings, from the first (quick, then thorough) to the last, and the ratio
#: of one step to the next.
_QUICK, _THOROUGH, _LAST, _STEP = 0.4, 1.5, 0.2, 0.87
#: The penalty of functions at a width of one spacing, and the weight of "no partner" against that of a perfect one.
_STIFFNESS, _NO_PARTNER = 0.05, np.float32(0.1)
#: A marker may lie so far from the prediction by its neighbours, in spacings; and in the end, if no other is as near.
_REACH, _LAST_REACH = 0.4, 0.75
#: The cost of a marker and a spot of the frame that both have no partner (each alone may be hidden, or a reflection),
#: of a motion by one spacing (rings look the same when each turns by one marker).
_UNPAIRED_COST, _MOTION_COST = 2.0, 0.03
#: A cost that is not questioned of the quick start, and of the others.
_GOOD_COST, _FAIR_COST = 0.06, 0.1
#: The farthest shift of the whole field that is tried, in spacings, and how many shifts are.
_MAX_SHIFT, _SHIFTS = 3.0, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """Where the markers of the reference are in a frame.

    Args:
        displacement_px: Column and row that each marker moved, shape (n, 2); predicted from its neighbours where
            ``found`` is false.
        found: Which markers were found in the frame, shape (n,).
        index: The number of each in the frame's markers, -1 where it was not found, shape (n,).
        cost: How little the displacements are those of one continuous skin: up to 0.1 for a good track, at most 1.
    """

    displacement_px: Floats
    found: Bools
    index: Ints
    cost: float

    def displacement_mm(self, mm_per_px: float) -> Floats:
        """The displacements in millimetres.

        Args:
            mm_per_px: The calibration: millimetres at the skin for each pixel.

        Raises:
            InputError: It is not a positive number.
        """
        if not 0.0 < mm_per_px < np.inf:
            raise InputError("mm_per_px", mm_per_px, "must be a positive number")
        return self.displacement_px * mm_per_px


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerTracker:
    """Follows the markers of a reference frame.

    Args:
        reference_px: Their centres in the reference, shape (n, 2), more than 10.
    """

    reference_px: Floats

    def __post_init__(self) -> None:
        shape = self.reference_px.shape
        if len(shape) != 2 or shape[1] != 2 or shape[0] <= NEIGHBOURS:
            raise InputError("reference_px", shape, f"must be (n, 2), columns and rows, with n above {NEIGHBOURS}")

    def follow(self, centres_px: Floats, start_px: Floats | None = None) -> Track:
        """Find the reference's markers among those of a frame.

        Args:
            centres_px: The centres in the frame, shape (m, 2), in any order.
            start_px: About how far each marker moved, shape (n, 2): in a video, as in the frame before.
        """
        zero = np.zeros_like(self.reference_px)
        best = Track(displacement_px=zero, found=zero[:, 0] > 0.0, index=np.full(len(zero), -1), cost=1.0)
        if len(centres_px):
            for start, width in self._starts(centres_px, zero if start_px is None else start_px):
                track = self._assigned(centres_px, self._annealed(centres_px, start, width))
                best = min(best, track, key=lambda each: each.cost)
                if best.cost < (_GOOD_COST if width == _QUICK else _FAIR_COST):
                    break
        return best

    def _starts(self, centres: Floats, start: Floats) -> Iterator[tuple[Floats, float]]:
        """Where to begin, and how wide: as given, then wider, then from shifts that give many markers a partner."""
        yield start, _QUICK
        yield start, _THOROUGH
        most, size = _MAX_SHIFT * self.spacing_px, 0.3 * self.spacing_px
        between = (centres[None] - self.reference_px[:, None]).reshape(-1, 2)
        bins = np.rint(between[np.max(np.abs(between), axis=1) <= most] / size).astype(np.int64)
        shifts, counts = np.unique(bins, axis=0, return_counts=True)
        for shift in shifts[np.argsort(-counts)[:_SHIFTS]] * size:
            yield np.zeros_like(self.reference_px) + shift, 0.5 * _THOROUGH

    @cached_property
    def spacing_px(self) -> float:
        """The usual distance of a marker from its nearest neighbours."""
        return float(np.median(self._near[1][:, :3]))

    @cached_property
    def _near(self) -> tuple[Ints, Floats]:
        from scipy.spatial import cKDTree

        distance, index = cKDTree(self.reference_px).query(self.reference_px, NEIGHBOURS + 1)
        return index[:, 1:], distance[:, 1:]

    @cached_property
    def _functions(self) -> Floats:
        """The smooth functions at the markers, shape (n, k), scaled so that all have the same penalty."""
        from scipy.spatial.distance import cdist

        radius = float(np.max(np.hypot(*(self.reference_px - self.reference_px.mean(axis=0)).T)))
        kernel = np.exp(-0.5 * cdist(self.reference_px, self.reference_px, "sqeuclidean") / (_WIDTH * radius) ** 2)
        values, vectors = np.linalg.eigh(kernel)
        return np.asarray(vectors[:, -_FUNCTIONS:] * np.sqrt(np.maximum(values[-_FUNCTIONS:], 0.0)))

    def _annealed(self, centres: Floats, start: Floats, width: float) -> Floats:
        """Smooth displacements that lead the reference to the centres, shape (n, 2)."""
        from scipy.spatial.distance import cdist

        functions, moved = self._functions, start
        while width > _LAST:
            square = cdist(self.reference_px + moved, centres, "sqeuclidean")
            pull = np.exp((square / (-2.0 * (width * self.spacing_px) ** 2)).astype(np.float32))
            for _ in range(3):
                pull /= pull.sum(axis=1, keepdims=True) + _NO_PARTNER
                pull /= pull.sum(axis=0, keepdims=True) + _NO_PARTNER
            weight = pull.sum(axis=1, keepdims=True)
            normal = (functions * weight).T @ functions + _STIFFNESS * width**2 * np.eye(functions.shape[1])
            target = pull.astype(np.float64) @ centres - weight * (self.reference_px + start)
            moved = start + functions @ np.linalg.solve(normal, functions.T @ target)
            width *= _STEP
        return moved

    @cached_property
    def _design(self) -> tuple[Floats, Floats]:
        """Of each marker the design of a linear fit over its neighbours, (n, k, 3), and their weights, (n, k)."""
        near, distance = self._near
        offset = (self.reference_px[near] - self.reference_px[:, None]) / self.spacing_px
        width = np.maximum(distance[:, 3:4], self.spacing_px)
        return np.concatenate([np.ones((*near.shape, 1)), offset], axis=2), np.exp(-0.5 * (distance / width) ** 2)

    def _predicted(self, moved: Floats, known: Bools) -> Floats:
        """Each displacement by those of its known neighbours; as it is where none is known."""
        near = self._near[0]
        design, weights = self._design
        weights = weights * known[near]
        weighted = design * weights[:, :, None]
        # Slopes are held back: where few neighbours are known, these say little of them.
        normal = weighted.transpose(0, 2, 1) @ design + np.diag([1e-9, 0.15, 0.15])
        solution = np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ moved[near])[:, 0]
        return np.where(weights.sum(axis=1)[:, None] > 0.0, solution, moved)

    def _assigned(self, centres: Floats, moved: Floats) -> Track:
        """The markers assigned one to one, at first by displacements that are about right, then by the neighbours'.

        In the end what is left of both goes together over a longer way: relief moves single markers far.
        """
        from scipy.spatial.distance import cdist

        found, reach = np.ones(len(moved), dtype=bool), _REACH * self.spacing_px
        for _ in range(3):
            predicted = self._predicted(moved, found)
            square = (cdist(self.reference_px + predicted, centres) / reach) ** 2
            index = _pairs(square, 1.0)
            found = index >= 0
            moved = np.where(found[:, None], centres[index] - self.reference_px, predicted)
        count = int(found.sum())
        total = float(np.sum(square[found, index[found]])) + _UNPAIRED_COST * (min(square.shape) - count)
        total = total / len(index) + _MOTION_COST * float(np.mean(np.hypot(*moved.T))) / self.spacing_px
        left, free = np.flatnonzero(~found), np.setdiff1d(np.arange(len(centres)), index)
        partner = _pairs(square[np.ix_(left, free)], (_LAST_REACH / _REACH) ** 2)
        index[left[partner >= 0]] = free[partner[partner >= 0]]
        moved = np.where(index[:, None] >= 0, centres[index] - self.reference_px, moved)
        cost = min(1.0, total) if 2 * count > len(index) else 1.0
        return Track(displacement_px=moved, found=index >= 0, index=index, cost=cost)


def _pairs(square: Floats, limit: float) -> Ints:
    """For each row the column that it is assigned to, -1 where that would cost the limit or more, shape (rows,)."""
    from scipy.optimize import linear_sum_assignment

    index = np.full(len(square), -1)
    rows, columns = linear_sum_assignment(np.minimum(square, limit))
    good = square[rows, columns] < limit
    index[rows[good]] = columns[good]
    return index
