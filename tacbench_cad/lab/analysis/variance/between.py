"""The matrix between textures: the difference between the frames of two textures, in the unit of the variance table.

An entry belongs to two textures from one printer-filament. It is the variance of each pixel over the frames of both
textures at the same position, then the mean over pixels and positions (the paper's figure). The diagonal has the
variances of the variance table. With n_a and n_b frames, their sums of squares Q and means m, the variance of both
together is::

    (Q_a + Q_b + n_a n_b / (n_a + n_b) |m_a - m_b|^2) / (n_a + n_b - ddof)

It is computed from the sums of each texture and the distances of the means alone. Frames of one texture differ because
of prints and noise; frames of two textures also differ because of the texture. If an entry is much larger than both of
its diagonal entries, a sensor can tell the two textures apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, CellKey
from tacbench_cad.lab.analysis.variance.intervals import CellSums
from tacbench_cad.lab.analysis.variance.streaming import PlaceSums
from tacbench_cad.util.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class TextureMatrix:
    """The matrix of one printer-filament at one force level.

    Args:
        combination: The printer and the filament.
        force_level: The level from 1, or ``all`` for the mean over the levels.
        textures: The names of the textures, in the order of rows and columns.
        variance: The variance over the frames of two textures, shape (t, t). The diagonal has the variances of the
            table; unknown entries are NaN.
        presses: The number of presses used for each entry, shape (t, t).
    """

    combination: str
    force_level: int | str
    textures: tuple[str, ...]
    variance: Floats
    presses: Ints


def texture_matrices(
    places: Iterable[PlaceSums],
    variances: Mapping[tuple[int, CellKey], float],
    *,
    combinations: Sequence[str],
    textures: Sequence[str],
    ddof: int,
) -> list[TextureMatrix]:
    """Return the matrices of all combinations: for each combination those of the levels, then their mean.

    Args:
        places: The sums of each place (a force level and a position).
        variances: The variances of the table, by level and cell, for the diagonal.
        combinations: The combinations in the order of the result.
        textures: The textures in the order of rows and columns.
        ddof: The ddof of the variance table.
    """
    size = len(textures)
    at = {name: i for i, name in enumerate(textures)}
    sums: dict[tuple[str, int], tuple[Floats, Ints, Ints]] = {}
    for place in places:
        for combination, (names, distances) in place.distances.items():
            key = (combination, place.level)
            if key not in sums:
                sums[key] = (np.zeros((size, size)), np.zeros((size, size), int), np.zeros((size, size), int))
            variance, count, presses = sums[key]
            cells = [place.cells[combination, name] for name in names]
            for i, a in enumerate(cells):
                presses[at[names[i]], at[names[i]]] += a.presses
                for j in range(i):
                    b, total = cells[j], a.presses + cells[j].presses
                    squares = _squares(a) + _squares(b) + a.presses * b.presses / total * float(distances[i, j])
                    where = (at[names[i]], at[names[j]])
                    for pair in (where, where[::-1]):
                        variance[pair] += squares / (total - ddof)
                        count[pair] += 1
                        presses[pair] += total
    matrices = []
    for combination in combinations:
        of_levels = []
        for level in sorted(level for name, level in sums if name == combination):
            variance, count, presses = sums[combination, level]
            mean = np.divide(variance, count, out=np.full((size, size), np.nan), where=count > 0)
            for texture, i in at.items():
                mean[i, i] = variances.get((level, (combination, texture)), np.nan)
            of_levels.append(
                TextureMatrix(
                    combination=combination,
                    force_level=level,
                    textures=tuple(textures),
                    variance=mean,
                    presses=np.where(np.isnan(mean), 0, presses),
                )
            )
        matrices += of_levels
        if of_levels:
            matrices.append(_pooled(of_levels))
    return matrices


def _squares(cell: CellSums) -> float:
    return cell.between + cell.within


def _pooled(of_levels: Sequence[TextureMatrix]) -> TextureMatrix:
    """Return the mean over the levels, for entries that every level has."""
    counts = np.array([matrix.presses for matrix in of_levels])
    return TextureMatrix(
        combination=of_levels[0].combination,
        force_level=ALL_LEVELS,
        textures=of_levels[0].textures,
        variance=np.mean([matrix.variance for matrix in of_levels], axis=0),
        presses=np.where(np.any(counts == 0, axis=0), 0, np.sum(counts, axis=0)),
    )
