"""Means, variances and covariances of frames that need not all be in memory, and small maps of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.types import Floats

#: The number of values that are converted at a time: 1 MB, which fits into the processor's cache.
CHUNK = 1 << 17
#: The number of stationary frames in memory at a time.
FRAMES = 32
#: The longest side of a map for figures, in pixels.
MAP_SIDE = 320


@dataclass(eq=False)
class Running:
    """The count, mean and sum of squares of all arrays added so far. The arrays themselves are not kept.

    Args:
        count: The number of arrays.
        mean: The mean of the arrays, shape (pixels,).
        squares: The sum of squared deviations from the mean, mean over pixels.
        merged: The part of ``squares`` that comes from differences between the added groups.
    """

    count: int = 0
    mean: Floats = field(default_factory=lambda: np.zeros(0))
    squares: float = 0.0
    merged: float = 0.0

    def add(self, count: int, mean: Floats, squares: float) -> None:
        """Add a group of arrays with its count, mean and squares."""
        if not self.count:
            self.count, self.mean, self.squares = count, mean.copy(), squares
            return
        total = self.count + count
        squared = 0.0
        for begin in range(0, len(mean), CHUNK // 4):
            which = slice(begin, begin + CHUNK // 4)
            step = mean[which] - self.mean[which]
            squared += float(step @ step)
            step *= count / total
            self.mean[which] += step
        between = self.count * count / total * squared / len(mean)
        self.merged += between
        self.squares += squares + between
        self.count = total


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


def _pieces(frames: Sequence[NDArray[Any]]) -> Iterator[tuple[slice, Floats, Floats]]:
    """Yield a range of pixels of all frames at a time: the slice, its mean (p,) and the deviations from it (n, p)."""
    flat = [frame.reshape(-1) for frame in frames]
    pixels = flat[0].size
    width = min(max(1, CHUNK // len(flat)), pixels)
    buffer = np.empty((len(flat), width))
    for begin in range(0, pixels, width):
        which = slice(begin, min(begin + width, pixels))
        piece = buffer[:, : which.stop - begin]
        for row, frame in zip(piece, flat, strict=True):
            row[:] = frame[which]
        mean = piece.mean(axis=0)
        piece -= mean
        yield which, mean, piece


def moments(frames: Sequence[NDArray[Any]]) -> Moments:
    """Compute the moments of frames of one shape, in two passes over a few thousand pixels at a time.

    Args:
        frames: A list of n arrays of finite numbers.
    """
    n, pixels = len(frames), frames[0].size
    mean, squares, gram = np.empty(pixels), np.empty(pixels), np.zeros((n, n))
    for which, middle, piece in _pieces(frames):
        mean[which] = middle
        gram += piece @ piece.T
        np.einsum("ij,ij->j", piece, piece, out=squares[which])
    return Moments(mean=mean, squares=squares, gram=gram / pixels)


def running_moments(frames: Iterable[NDArray[Any]]) -> Running:
    """Compute count, mean and squares of any number of frames, with at most :data:`FRAMES` in memory at a time."""
    running, held = Running(), list[NDArray[Any]]()

    def add() -> None:
        mean, squares = np.empty(held[0].size), 0.0
        for which, middle, piece in _pieces(held):
            mean[which] = middle
            squares += float(np.einsum("ij,ij->", piece, piece))
        running.add(len(held), mean, squares / len(mean))
        held.clear()

    for frame in frames:
        held.append(frame)
        if len(held) == FRAMES:
            add()
    if held:
        add()
    return running


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
