"""Means, variances and covariances of frames that need not all be in memory, and small maps of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.types import Floats

#: The number of values that are converted at a time: 1 MB, which fits into the processor's cache.
CHUNK = 1 << 17
#: The longest side of a map for figures, in pixels.
MAP_SIDE = 320


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments:
    """The mean, variance and covariance of a few frames.

    Args:
        mean: The mean frame, shape (pixels,).
        squares: The sum of squared deviations of each pixel, shape (pixels,).
        gram: The products of the frames' deviations, mean over pixels, shape (n, n).
    """

    mean: Floats
    squares: Floats
    gram: Floats


def moments(frames: Sequence[NDArray[Any]]) -> Moments:
    """Compute the moments of n frames of one shape, in two passes over a few thousand pixels at a time."""
    flat = [frame.reshape(-1) for frame in frames]
    n, pixels = len(flat), flat[0].size
    mean, squares, gram = np.empty(pixels), np.empty(pixels), np.zeros((n, n))
    width = max(1, CHUNK // n)
    for which in (slice(begin, min(begin + width, pixels)) for begin in range(0, pixels, width)):
        piece = np.array([frame[which] for frame in flat], dtype=np.float64)
        mean[which] = piece.mean(axis=0)
        piece -= mean[which]
        gram += piece @ piece.T
        np.einsum("ij,ij->j", piece, piece, out=squares[which])
    return Moments(mean=mean, squares=squares, gram=gram / pixels)


def sum_of_squares(frames: Iterable[NDArray[Any]]) -> tuple[int, float]:
    """Return the number of frames, and the sum of squared deviations from their mean, mean over pixels.

    Only the sum and the sum of squares are in memory. They are taken from the first frame, so that they stay small.
    """
    count, first, total, squares = 0, np.zeros(0), np.zeros(0), 0.0
    for frame in frames:
        values = frame.reshape(-1).astype(np.float64)
        if not count:
            first, total = values, np.zeros_like(values)
        step = values - first
        count, total, squares = count + 1, total + step, squares + float(step @ step)
    return count, (squares - float(total @ total) / count) / len(first) if count else 0.0


def small_map(values: Floats, shape: Sequence[int]) -> Floats:
    """Arrange one value for each pixel as a map of at most :data:`MAP_SIDE` pixels a side.

    Channels and further axes are averaged.

    Args:
        values: One value for each number of the frame, in the frame's order.
        shape: The shape of the frame; a frame with one axis gives a single row.
    """
    picture = values.reshape(shape if len(shape) > 1 else (1, -1))
    if picture.ndim > 2:
        picture = picture.mean(axis=tuple(range(2, picture.ndim)))
    return _averaged(_averaged(picture).T).T


def _averaged(picture: Floats) -> Floats:
    """Average neighbouring rows so that at most :data:`MAP_SIDE` rows remain; the last mean may have fewer rows."""
    rows = len(picture)
    step = -(-rows // MAP_SIDE)
    means = picture[::step].copy()
    for i in range(1, step):
        part = picture[i::step]
        means[: len(part)] += part
    means /= np.diff(np.append(np.arange(0, rows, step), rows))[:, None]
    return means
