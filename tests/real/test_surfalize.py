"""Height maps from instruments: files that surfalize writes are read with their distances and heights."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.spec.images import read_heights
from tacbench_cad.util.errors import InputError

surfalize = pytest.importorskip("surfalize")
pytestmark = pytest.mark.real


@pytest.mark.parametrize("ending", ["sur", "sdf", "al3d"])
def test_files_of_instruments_are_read_in_mm(ending: str, tmp_path: Path) -> None:
    heights_um = np.random.default_rng(0).normal(size=(60, 80)) * 5.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        surfalize.Surface(heights_um, 2.0, 2.5).save(tmp_path / f"a.{ending}")
    file = read_heights(tmp_path / f"a.{ending}")
    assert file.in_mm
    assert file.mm_per_pixel == pytest.approx((0.002, 0.0025))
    np.testing.assert_allclose(file.values, heights_um / 1000.0, atol=1e-8)


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.sur").write_bytes(b"zz")
    with pytest.raises(InputError, match=r"a\.sur': cannot be read"):
        read_heights(tmp_path / "a.sur")
