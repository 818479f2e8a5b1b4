"""A fast search for the interval of a sequence in which each of many numbers lies."""

from __future__ import annotations

import math

import numpy as np

from tacbench_cad.util.types import Floats, Ints

#: The largest number of buckets for each interval. A sequence that needs more is searched by bisection.
_MAX_BUCKETS = 64


class Intervals:
    """Neighbouring intervals, for example the spans between knots or the cells between lines.

    Equal buckets that are shorter than every interval point to their intervals. This is several times as fast as
    bisection.

    Args:
        edges: The ends of the intervals, ascending and all different, shape (n + 1,).
    """

    def __init__(self, edges: Floats) -> None:
        self._edges = edges
        self._last = len(edges) - 2
        length = float(edges[-1] - edges[0])
        count = math.ceil(1.01 * length / float(np.diff(edges).min()))
        self._first: Ints | None = None
        if count <= _MAX_BUCKETS * len(edges):
            self._scale = count / length
            starts = edges[0] + np.arange(count) / self._scale
            self._first = np.searchsorted(edges[1:-1], starts, "right")

    def index(self, t: Floats) -> Ints:
        """Return the number of the interval of each coordinate; at an inner end, that of the interval on its right.

        Coordinates outside belong to the first or the last interval.
        """
        if self._first is None:
            return np.asarray(np.searchsorted(self._edges[1:-1], t, "right"), dtype=np.int64)
        i = self._first.take(((t - self._edges[0]) * self._scale).astype(np.int64), mode="clip")
        # From here on, all indices are valid. NumPy is faster if it need not check them.
        # The bucket may begin in the interval before, or by rounding in the interval after
        after = np.minimum(i + 1, self._last)
        i = np.where(t >= self._edges.take(after, mode="clip"), after, i)
        index: Ints = np.maximum(i - (t < self._edges.take(i, mode="clip")), 0)
        return index
