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

from collections.abc import Sequence
from itertools import combinations_with_replacement

import pandas as pd

from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, parts_of
from tacbench_cad.lab.analysis.variance.streaming import PlaceSums

_PAIR = ["combination", "force_level", "texture", "other_texture"]


def between_textures(places: Sequence[PlaceSums], combinations: Sequence[str], ddof: int) -> pd.DataFrame:
    """Return ``between_textures.csv``: each pair of textures once, and each texture with itself.

    The rows of each combination are by force level; the mean over the levels is last, for pairs that every level has.

    Args:
        places: The sums of each place (a force level and a position).
        combinations: The combinations in the order of the result.
        ddof: The ddof of the variance table.
    """
    rows = []
    for place in places:
        for (i, key), (j, other) in combinations_with_replacement(enumerate(place.cells), 2):
            first, second = place.cells[key], place.cells[other]
            if key[0] != other[0]:
                continue
            presses = first.presses if i == j else first.presses + second.presses
            squares = first.between + first.within
            if i != j:
                apart = first.presses * second.presses / presses * place.distances[i, j]
                squares += second.between + second.within + apart
            if presses > 1:
                rows.append((key[0], place.level, key[1], other[1], squares / (presses - ddof), presses))
    table = pd.DataFrame(rows, columns=[*_PAIR, "variance", "presses"])
    of_levels = table.groupby(_PAIR, sort=False, as_index=False).agg({"variance": "mean", "presses": "sum"})
    pairs = of_levels.groupby(["combination", "texture", "other_texture"], sort=False)
    pooled = pairs.agg(variance=("variance", "mean"), presses=("presses", "sum"), levels=("force_level", "size"))
    complete = of_levels.groupby("combination")["force_level"].nunique()
    pooled = pooled.reset_index().assign(force_level=ALL_LEVELS)
    pooled = pooled[pooled["levels"] == pooled["combination"].map(complete)].drop(columns="levels")
    result = pd.concat([of_levels.astype({"force_level": object}), pooled])
    result = result.sort_values("combination", key=lambda names: names.map(list(combinations).index), kind="stable")
    parts = pd.DataFrame(list(map(parts_of, result["combination"])), index=result.index)
    return pd.concat([parts, result.drop(columns="combination")], axis=1).reset_index(drop=True)
