"""Follow markers that move farther than their spacing, with some missing and some false ones."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.lookalikes import LOOKS, lattice, pressed

from tacbench_cad.extensions.markers.tracking import MarkerTracker
from tacbench_cad.util.errors import InputError


@pytest.mark.parametrize("name", ["A", "C", "E"])
@pytest.mark.parametrize("max_px", [5.0, 12.0, 23.0])
def test_every_marker_is_followed(name: str, max_px: float) -> None:
    look = LOOKS[name]
    rest = lattice(look)
    tracker = MarkerTracker(reference_px=rest)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        places = pressed(rest, look, max_px, rng)
        visible = np.flatnonzero(rng.uniform(size=len(rest)) > 0.03)
        strays = rng.uniform(-100.0, 100.0, (3, 2)) + look.centre
        order = rng.permutation(len(visible) + 3)
        centres = np.concatenate([places[visible] + rng.normal(0.0, 0.1, (len(visible), 2)), strays])[order]
        track = tracker.follow(centres)
        number = np.where(track.found, np.append(visible, [-1, -1, -1])[order][track.index], -1)
        right = number == np.arange(len(rest))
        assert np.sum(track.found & ~right) <= 1  # a false marker may be at the place of a missing one
        assert np.mean(right[visible]) > 0.98
        error = np.hypot(*(track.displacement_px - (places - rest)).T)
        assert np.median(error) < 0.2
        assert error[~track.found].max(initial=0.0) < 8.0


def test_a_shift_of_everything_is_followed() -> None:
    rest = lattice(LOOKS["C"])
    track = MarkerTracker(reference_px=rest).follow(rest[::-1] + np.array([18.0, -9.0]))
    assert track.found.all()
    assert np.allclose(track.displacement_px, (18.0, -9.0))


def test_an_empty_frame_has_no_markers() -> None:
    nothing = MarkerTracker(reference_px=lattice(LOOKS["C"])).follow(np.zeros((0, 2)))
    assert not nothing.found.any()
    assert nothing.cost == 1.0
    with pytest.raises(InputError, match="reference_px"):
        MarkerTracker(reference_px=np.zeros((5, 2)))
