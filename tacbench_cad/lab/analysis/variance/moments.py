"""Means, variances and covariances of readings that need not all be in memory, and pictures of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.util.types import Floats

#: Numbers that are converted at a time, 1 MB of them: they stay in the processor's cache.
CHUNK = 1 << 17
#: Stationary frames in memory at a time.
FRAMES = 32
#: Longest side of a map for figures, in pixels.
MAP_SIDE = 320


@dataclass(eq=False)
class Running:
    """Count, mean and mean square sum of what was added so far, of arrays that need not be kept.

    Args:
        count: Arrays.
        mean: Their mean, shape (pixels,).
        squares: Mean over pixels of the sum of squared deviations from the mean.
        merged: The part of ``squares`` that lies between the groups that were added.
    """

    count: int = 0
    mean: Floats = field(default_factory=lambda: np.zeros(0))
    squares: float = 0.0
    merged: float = 0.0

    def add(self, count: int, mean: Floats, squares: float) -> None:
        """Add a group with its own count, mean and squares."""
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
    """Mean, variance and covariance of a few readings.

    Args:
        mean: Mean reading, shape (pixels,).
        squares: Sum of squared deviations of each pixel, shape (pixels,).
        gram: Mean over pixels of products of the readings' deviations, shape (n, n).
    """

    mean: Floats
    squares: Floats
    gram: Floats


def _pieces(readings: Sequence[NDArray[Any]]) -> Iterator[tuple[slice, Floats, Floats]]:
    """Some pixels of all readings at a time: which, their mean (p,) and the deviations from it (n, p)."""
    flat = [reading.reshape(-1) for reading in readings]
    pixels = flat[0].size
    width = min(max(1, CHUNK // len(flat)), pixels)
    buffer = np.empty((len(flat), width))
    for begin in range(0, pixels, width):
        which = slice(begin, min(begin + width, pixels))
        piece = buffer[:, : which.stop - begin]
        for row, reading in zip(piece, flat, strict=True):
            row[:] = reading[which]
        mean = piece.mean(axis=0)
        piece -= mean
        yield which, mean, piece


def moments(readings: Sequence[NDArray[Any]]) -> Moments:
    """Moments of readings of one shape, in two passes over a few thousand pixels at a time.

    Args:
        readings: n arrays of finite numbers.
    """
    n, pixels = len(readings), readings[0].size
    mean, squares, gram = np.empty(pixels), np.empty(pixels), np.zeros((n, n))
    for which, middle, piece in _pieces(readings):
        mean[which] = middle
        gram += piece @ piece.T
        np.einsum("ij,ij->j", piece, piece, out=squares[which])
    return Moments(mean=mean, squares=squares, gram=gram / pixels)


def running_moments(readings: Iterable[NDArray[Any]]) -> Running:
    """Count, mean and squares of any number of readings, of which :data:`FRAMES` are in memory at a time."""
    running, held = Running(), list[NDArray[Any]]()

    def add() -> None:
        mean, squares = np.empty(held[0].size), 0.0
        for which, middle, piece in _pieces(held):
            mean[which] = middle
            squares += float(np.einsum("ij,ij->", piece, piece))
        running.add(len(held), mean, squares / len(mean))
        held.clear()

    for reading in readings:
        held.append(reading)
        if len(held) == FRAMES:
            add()
    if held:
        add()
    return running


def small_map(values: Floats, shape: Sequence[int]) -> Floats:
    """A value for each pixel as a picture of at most :data:`MAP_SIDE` a side; channels and the like are averaged.

    Args:
        values: One value a number of the reading, in its order.
        shape: The reading's shape; one axis gives a single row.
    """
    picture = values.reshape(shape if len(shape) > 1 else (1, -1))
    if picture.ndim > 2:
        picture = picture.mean(axis=tuple(range(2, picture.ndim)))
    return _averaged(_averaged(picture).T).T


def _averaged(picture: Floats) -> Floats:
    """Means of as many neighbouring rows as leave at most :data:`MAP_SIDE`; the last one may be of fewer."""
    rows = len(picture)
    step = -(-rows // MAP_SIDE)
    means = picture[::step].copy()
    for i in range(1, step):
        part = picture[i::step]
        means[: len(part)] += part
    means /= np.diff(np.append(np.arange(0, rows, step), rows))[:, None]
    return means
