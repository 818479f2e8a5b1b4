"""The search for intervals against bisection."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.spec.lookup import Intervals
from tacbench_cad.util.types import Floats

RANDOM = np.random.default_rng(0)
EDGES = {
    "even": np.linspace(-3.0, 30.0, 1024),
    "uneven": np.unique(np.concatenate([np.linspace(0.0, 30.0, 100), RANDOM.uniform(0.0, 30.0, 9)])),
    "very uneven": np.array([0.0, 1e-9, 2e-9, 1.0, 30.0]),
    "one": np.array([2.0, 5.0]),
}


@pytest.mark.parametrize("edges", EDGES.values(), ids=EDGES)
def test_the_same_interval_as_by_bisection(edges: Floats) -> None:
    inside = RANDOM.uniform(edges[0], edges[-1], 20_000)
    t = np.concatenate([inside, edges, np.nextafter(edges, -99.0), np.nextafter(edges, 99.0), [-50.0, 50.0]])
    assert np.array_equal(Intervals(edges).index(t), np.searchsorted(edges[1:-1], t, "right"))
