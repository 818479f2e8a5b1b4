"""Test the import of HDF5 files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.array_frames import frames, read_endlessly, write_hdf5

from tacbench_cad.extensions.exchange.importing import hdf5
from tacbench_cad.lab import import_samples
from tacbench_cad.util.errors import InputError


def test_hdf5_with_external_links_is_left_out(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    (tmp_path / "secret").write_bytes(bytes(12 * 16 * 24))
    with h5py.File(tmp_path / "X.h5", "w") as file:
        where = [(str(tmp_path / "secret"), 0, h5py.h5f.UNLIMITED)]
        file.create_dataset("X", (12, 16, 24), dtype=np.uint8, external=where)
        file["other"] = h5py.ExternalLink("other.h5", "/X")
    (left_out,) = import_samples([tmp_path / "X.h5"], tmp_path / "out").left_out
    assert "is stored in other files" in left_out.reason


def test_an_hdf5_file_that_takes_too_long_is_read_no_further(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_hdf5(tmp_path / "X.h5", X=frames())
    source = hdf5._opened(tmp_path / "X.h5", "")
    assert np.array_equal(source.frame(3), frames()[3])
    with monkeypatch.context() as patch:
        patch.setattr(hdf5, "LIMITS_S", (0.1, 0.0))
        patch.setattr(hdf5, "_frame", read_endlessly)
        patch.setattr(hdf5, "_content", read_endlessly)
        for read in (lambda: source.frame(4), lambda: hdf5._opened(tmp_path / "X.h5", "")):
            with pytest.raises(InputError, match=r"X\.h5.*takes the HDF5 library longer than 0 s; .*TACBENCH_LIMITS=2"):
                read()
    with pytest.raises(InputError, match="takes the HDF5 library longer"):
        source.frame(3)
