"""The matrix between textures: how far the readings of two textures lie apart, in the unit of the variance table.

For two textures that one printer-filament printed: the variance of each pixel over both textures' readings at the same
position, then the mean over pixels and positions (the paper's figure). On the diagonal stands the table's own variance.
With n_a and n_b readings, their sums of squares Q and means m, the union's variance is::

    (Q_a + Q_b + n_a n_b / (n_a + n_b) |m_a - m_b|^2) / (n_a + n_b - ddof)

so that nothing but the sums of each texture and the distances of the means is needed. Readings of one texture differ
by print and noise, those of two by the texture as well: an entry well above both of its diagonal entries is a pair that
a sensor can tell apart.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS
from tacbench_cad.lab.analysis.variance.intervals import CellSums
from tacbench_cad.lab.analysis.variance.streaming import CellKey, PlaceSums
from tacbench_cad.util.types import Floats, Ints


@dataclass(frozen=True, kw_only=True, eq=False)
class TextureMatrix:
    """The matrix of one printer-filament at one force level.

    Args:
        combination: Printer and filament.
        force_level: Level from 1, or ``all`` for the mean over the levels.
        textures: Names, in the order of rows and columns.
        variance: Variance over two textures' readings, the table's own on the diagonal, NaN where there is none,
            shape (t, t).
        presses: Presses behind each entry, shape (t, t).
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
    """The matrices of all combinations, for each level, then for all levels.

    Args:
        places: Sums of each place.
        variances: The table's variance by level and cell: the diagonal.
        combinations: Their order.
        textures: Their order.
        ddof: As for the table.
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
    """The mean over levels, where every level has an entry."""
    counts = np.array([matrix.presses for matrix in of_levels])
    return TextureMatrix(
        combination=of_levels[0].combination,
        force_level=ALL_LEVELS,
        textures=of_levels[0].textures,
        variance=np.mean([matrix.variance for matrix in of_levels], axis=0),
        presses=np.where(np.any(counts == 0, axis=0), 0, np.sum(counts, axis=0)),
    )
