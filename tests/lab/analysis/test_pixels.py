"""Test the variance and classification of regions of interest against NumPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.studies import write_study

from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import fitted
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.lab.runs.region import parse_region, store_region
from tacbench_cad.lab.runs.region_search import region_of
from tacbench_cad.util.errors import InputError


@pytest.mark.parametrize("colour", [False, True])
def test_variance_of_a_region_equals_numpys_of_its_pixels(tmp_path: Path, colour: bool) -> None:
    shape = (24, 32, 3) if colour else (24, 32)
    write_study(
        tmp_path, shape=shape, image=lambda printed, press, rng: rng.integers(0, 256, shape, dtype=np.uint8), still=2
    )
    collection = Collection.open([tmp_path])
    feature = fitted(collection, roi="circle:15,11,7", colour=colour)
    result = variance_table(collection, feature)
    y, x = np.mgrid[:24, :32]
    mask = (x - 15) ** 2 + (y - 11) ** 2 <= 49
    for cell in result.cells[:-4]:
        parts = []
        for position in np.unique(collection.position):
            here = (collection.texture == cell.texture) & (collection.combination == cell.combination)
            frames = [collection.frame(i) for i in np.flatnonzero(here & (collection.position == position))]
            parts.append(np.var([frame[mask] for frame in frames], axis=0).mean())
        assert cell.variance == pytest.approx(np.mean(parts), rel=1e-9)
    picture = next(iter(result.maps.values()))
    assert picture.shape == (24, 32)
    assert np.array_equal(np.isfinite(picture), mask)
    assert not any(cell.published for cell in result.cells)


def test_a_stored_region_is_used_unless_another_is_chosen(tmp_path: Path) -> None:
    folders = write_study(tmp_path)
    runs = Collection.open([tmp_path]).runs
    for folder in folders[:-1]:
        store_region(folder, parse_region("rect:2,2,20,20", 24, 32))
    assert region_of(runs) is None
    store_region(folders[-1], parse_region("rect:10,2,28,20", 24, 32))
    region = region_of(runs)
    assert region is not None
    assert region.mask.sum() == 11 * 19
    assert region_of(runs, "none") is None
    store_region(folders[-1], parse_region("rect:10,2,28,20", 48, 64))
    with pytest.raises(InputError, match="different sizes"):
        region_of(runs)
