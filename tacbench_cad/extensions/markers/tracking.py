"""Tracking of markers from a reference frame, even if they move farther than the distance between two markers.

If markers move by more than half their spacing, the nearest marker in another frame is often a different marker. But
the skin is continuous, so a marker moves nearly like its neighbours. Tracking uses this in three steps:

1. The displacements are written as a sum of a few smooth functions over the reference, and fitted to all markers of the
   frame at once. Each marker of the reference is drawn towards a mean of the markers near its predicted position. These
   are at first the markers within more than a spacing, then within shorter and shorter distances. This is softassign
   with annealing (Chui and Rangarajan 2003, "A new point matching algorithm for non-rigid registration").
2. SciPy (``linear_sum_assignment``) assigns the markers one to one to the positions that their neighbours predict.
   Markers that contradict the prediction are left out.
3. If many markers have no partner, the first two steps are repeated, starting from shifts of the whole field.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Ints

#: The number of neighbours that predict a displacement.
NEIGHBOURS = 10
#: The width of the smooth functions, which are Gaussians, as a fraction of the field's radius; and their number.
_WIDTH, _FUNCTIONS = 0.4, 40
#: The width of the assignment during annealing, in spacings: at the quick start, at the thorough start, and at the end;
#: and the ratio of the width of a step to that of the step before.
_QUICK, _THOROUGH, _LAST, _STEP = 0.4, 1.5, 0.2, 0.87
#: The penalty of the functions at a width of one spacing, and the weight of "no partner" relative to a perfect partner.
_STIFFNESS, _NO_PARTNER = 0.05, np.float32(0.1)
#: The largest distance of a marker from the position that its neighbours predict, in spacings; and the same at the end,
#: for markers without another partner.
_REACH, _LAST_REACH = 0.4, 0.75
#: The cost of a marker and a spot of the frame that both have no partner, and the cost of a motion by one spacing. A
#: single marker without a partner may be hidden, and a single spot may be a reflection. The motion has a cost because a
#: ring of markers looks the same when it turns by one marker.
_UNPAIRED_COST, _MOTION_COST = 2.0, 0.03
#: The cost below which a track is accepted: from the quick start, and from the other starts.
_GOOD_COST, _FAIR_COST = 0.06, 0.1
#: The largest shift of the whole field that is tried, in spacings, and the number of shifts.
_MAX_SHIFT, _SHIFTS = 3.0, 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Track:
    """The reference's markers in a frame.

    Args:
        displacement_px: The displacement of each marker as column and row, shape (n, 2). If the marker was not found,
            it is predicted from the neighbours.
        found: Whether each marker was found in the frame, shape (n,).
        index: The index of each marker among the frame's markers, or -1 if it was not found, shape (n,).
        cost: A measure of how much the displacements differ from those of a continuous skin: up to 0.1 for a good
            track, at most 1.
    """

    displacement_px: Floats
    found: Bools
    index: Ints
    cost: float


@dataclass(frozen=True, kw_only=True, eq=False)
class MarkerTracker:
    """A tracker of the markers of a reference frame.

    Args:
        reference_px: The centres of the markers in the reference, shape (n, 2), with n above 10.
    """

    reference_px: Floats

    def __post_init__(self) -> None:
        shape = self.reference_px.shape
        if len(shape) != 2 or shape[1] != 2 or shape[0] <= NEIGHBOURS:
            raise InputError("reference_px", shape, f"must be (n, 2), columns and rows, with n above {NEIGHBOURS}")

    def follow(self, centres_px: Floats) -> Track:
        """Find the reference's markers among the markers of a frame.

        Args:
            centres_px: The centres in the frame, shape (m, 2), in any order.
        """
        zero = np.zeros_like(self.reference_px)
        best = Track(displacement_px=zero, found=zero[:, 0] > 0.0, index=np.full(len(zero), -1), cost=1.0)
        if len(centres_px):
            for start, width in self._starts(centres_px):
                track = self._assigned(centres_px, self._annealed(centres_px, start, width))
                best = min(best, track, key=lambda each: each.cost)
                if best.cost < (_GOOD_COST if width == _QUICK else _FAIR_COST):
                    break
        return best

    def _starts(self, centres: Floats) -> Iterator[tuple[Floats, float]]:
        """Yield the displacements and the width to start from.

        The first two start from no displacement. The others are shifts of the whole field that give many markers a
        partner.
        """
        zero = np.zeros_like(self.reference_px)
        yield zero, _QUICK
        yield zero, _THOROUGH
        most, size = _MAX_SHIFT * self.spacing_px, 0.3 * self.spacing_px
        between = (centres[None] - self.reference_px[:, None]).reshape(-1, 2)
        bins = np.rint(between[np.max(np.abs(between), axis=1) <= most] / size).astype(np.int64)
        shifts, counts = np.unique(bins, axis=0, return_counts=True)
        for shift in shifts[np.argsort(-counts)[:_SHIFTS]] * size:
            yield zero + shift, 0.5 * _THOROUGH

    @cached_property
    def spacing_px(self) -> float:
        """The median distance of a marker from its three nearest neighbours, in pixels."""
        return float(np.median(self._near[1][:, :3]))

    @cached_property
    def _near(self) -> tuple[Ints, Floats]:
        from scipy.spatial import cKDTree

        distance, index = cKDTree(self.reference_px).query(self.reference_px, NEIGHBOURS + 1)
        return index[:, 1:], distance[:, 1:]

    @cached_property
    def _functions(self) -> Floats:
        """The values of the smooth functions at the markers, shape (n, k), scaled so that all have the same penalty."""
        from scipy.spatial.distance import cdist

        radius = float(np.max(np.hypot(*(self.reference_px - self.reference_px.mean(axis=0)).T)))
        kernel = np.exp(-0.5 * cdist(self.reference_px, self.reference_px, "sqeuclidean") / (_WIDTH * radius) ** 2)
        values, vectors = np.linalg.eigh(kernel)
        return np.asarray(vectors[:, -_FUNCTIONS:] * np.sqrt(np.maximum(values[-_FUNCTIONS:], 0.0)))

    def _annealed(self, centres: Floats, start: Floats, width: float) -> Floats:
        """Fit smooth displacements that move the reference to the centres, shape (n, 2)."""
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
        """The design matrices of each marker's linear fit over its neighbours, (n, k, 3), and the weights, (n, k)."""
        near, distance = self._near
        offset = (self.reference_px[near] - self.reference_px[:, None]) / self.spacing_px
        width = np.maximum(distance[:, 3:4], self.spacing_px)
        return np.concatenate([np.ones((*near.shape, 1)), offset], axis=2), np.exp(-0.5 * (distance / width) ** 2)

    def _predicted(self, moved: Floats, known: Bools) -> Floats:
        """Predict each displacement from the known neighbours. Without known neighbours, it is not changed."""
        near = self._near[0]
        design, weights = self._design
        weights = weights * known[near]
        weighted = design * weights[:, :, None]
        # The slopes are regularised, because few known neighbours do not determine them well.
        normal = weighted.transpose(0, 2, 1) @ design + np.diag([1e-9, 0.15, 0.15])
        solution = np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ moved[near])[:, 0]
        return np.where(weights.sum(axis=1)[:, None] > 0.0, solution, moved)

    def _assigned(self, centres: Floats, moved: Floats) -> Track:
        """Assign the markers one to one, starting from approximate displacements and then from the neighbours.

        At the end, the remaining markers and spots are assigned over a longer distance, because a relief can move a
        single marker far.
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
    """Return the column assigned to each row, shape (rows,); -1 if the cost would be ``limit`` or more."""
    from scipy.optimize import linear_sum_assignment

    index = np.full(len(square), -1)
    rows, columns = linear_sum_assignment(np.minimum(square, limit))
    good = square[rows, columns] < limit
    index[rows[good]] = columns[good]
    return index
