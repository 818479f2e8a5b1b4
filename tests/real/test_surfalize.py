"""Height maps from instruments: files that surfalize writes are read with their distances and heights."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from tacbench_cad.spec import images
from tacbench_cad.spec.images import read_heights
from tacbench_cad.util.errors import InputError

surfalize = pytest.importorskip("surfalize")
pytestmark = pytest.mark.real


def test_a_damaged_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.sur").write_bytes(b"zz")
    with pytest.raises(InputError, match=r"a\.sur': cannot be read"):
        read_heights(tmp_path / "a.sur")


def test_a_file_that_blocks_surfalize_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = b"GWYPGwyContainer\0" + struct.pack("<I", 10**6) + b"a\0S" + struct.pack("<I", 2**31)  # 2**31 texts
    (tmp_path / "a.gwy").write_bytes(content)
    monkeypatch.setattr(images, "INSTRUMENT_LIMITS_S", (2.0, 0.0))
    with pytest.raises(InputError, match=r"a\.gwy': takes the package surfalize longer than 2 s; export it again"):
        read_heights(tmp_path / "a.gwy")
