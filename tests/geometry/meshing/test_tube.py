"""The path with the fewest links inside a tube: it stays inside, and no path has fewer links."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tacbench_cad.geometry.meshing.tube import fewest_links
from tacbench_cad.util.types import Floats


def random_tube(seed: int) -> tuple[Floats, Floats, Floats]:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 40))
    t = np.cumsum(rng.uniform(0.05, 1.0, count))
    middle = np.cumsum(rng.normal(0.0, 0.6, count))
    half = rng.uniform(0.02, 0.8, count)
    return t, middle - half, middle + half


def links_of_any_path(t: Floats, low: Floats, high: Floats, levels: int) -> int:
    """Return the fewest links of paths with vertices at samples and a few levels of the tube, at least the optimum."""
    fractions = np.linspace(0.0, 1.0, levels)
    z = low[:, None] + fractions * (high - low)[:, None]
    best = np.full(z.shape, np.inf)
    best[0] = 0.0
    for i, j in itertools.combinations(range(len(t)), 2):
        inner = np.arange(i + 1, j)
        s = ((t[inner] - t[i]) / (t[j] - t[i]))[:, None, None]
        line = z[i][None, :, None] * (1 - s) + z[j][None, None, :] * s
        fits = np.all((line >= low[inner, None, None]) & (line <= high[inner, None, None]), axis=0)
        best[j] = np.minimum(best[j], np.where(fits, best[i][:, None] + 1, np.inf).min(axis=0))
    return int(best[-1].min())


@pytest.mark.parametrize("seed", range(60))
def test_stays_inside_with_no_more_links_than_any_path_on_the_samples(seed: int) -> None:
    t, low, high = random_tube(seed)
    at, height = fewest_links(t, low, high)
    assert (at[0], at[-1]) == (t[0], t[-1])
    assert np.all(np.diff(at) > 0.0)
    everywhere = np.union1d(t, at)
    fit = np.interp(everywhere, at, height)
    assert np.all(fit >= np.interp(everywhere, t, low) - 1e-9)
    assert np.all(fit <= np.interp(everywhere, t, high) + 1e-9)
    assert len(at) - 1 <= links_of_any_path(t, low, high, levels=9)
