"""Lost crests and filled valleys of a printed surface."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.spec.crest_errors import peaks, valleys
from tacbench_cad.util.types import Floats

X, Y = np.arange(0.0, 10.0, 0.1), np.arange(0.0, 8.0, 0.1)
#: Crests at x = 1, 3, 5, 7 and 9, and valleys between them.
WAVE = np.repeat(np.cos(np.pi * (X[:, None] - 1.0)), len(Y), axis=1)
INSIDE = np.ones(WAVE.shape, dtype=bool)


def lowered(x: float, by: float) -> Floats:
    """Return the wave with the crest or valley at an x lowered."""
    printed = WAVE.copy()
    printed[np.abs(X - x) < 0.5] -= by
    return printed


def test_a_crest_that_is_too_low_by_more_than_a_layer_is_missed() -> None:
    result = peaks(WAVE, lowered(5.0, 0.3), INSIDE, X, Y, 0.2)
    assert (result.count, result.missed) == (5, 1)
    assert result.worst_mm == pytest.approx(0.3)
    assert result.mean_mm == pytest.approx(0.3 / 5)
    assert result.missed_mm[0, 0] == pytest.approx(5.0)
    assert peaks(WAVE, lowered(5.0, 0.1), INSIDE, X, Y, 0.2).missed == 0


def test_a_valley_that_is_too_high_is_filled() -> None:
    result = valleys(WAVE, lowered(4.0, -0.5), INSIDE, X, Y, 0.2)
    assert (result.count, result.missed) == (6, 1)  # also the valleys at both sides
    assert result.worst_mm == pytest.approx(0.5)
