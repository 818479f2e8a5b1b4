"""The same spec gives the same bytes: a second time, in another process, later, and in another folder."""

from __future__ import annotations

import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest

from tacbench_cad.formats import FORMATS
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.util.files import sha256

BLOCKS = {
    "plain": Block.of(2),
    "keyed": Block.of(1, key_mm=3.0, copy=2),
    "released": Block.of(5, "released"),
}


def _require_format(form: str) -> None:
    if FORMATS[form].why_missing() is not None:
        pytest.skip(f"no {form} here")


def _part(name: str) -> PrintPart:
    return block_part(BLOCKS[name])


def _jig() -> PrintPart:
    from housing.holder import Holder
    from housing.jig import Jig

    return Jig(holder=Holder(block=Block.of(1))).part()


_OTHER_PROCESS = """
import sys
from pathlib import Path
sys.path[:0] = [sys.argv[1], sys.argv[2]]
import test_reproducible
test_reproducible.write_parts(Path(sys.argv[3]))
"""


def write_parts(folder: Path) -> None:
    """Write two blocks in every available format, and a jig, because its mesh comes from its solid."""
    for name in ("plain", "keyed"):
        part = _part(name)
        for form in FORMATS.values():
            if form.why_missing() is None:
                form.write(part, folder / f"{name}{form.suffix}")
    if find_spec("build123d"):
        FORMATS["stl"].write(_jig(), folder / "jig.stl")


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the parts in another process and return the folder."""
    folder = tmp_path_factory.mktemp("there")
    arguments = [sys.executable, "-c", _OTHER_PROCESS, *map(str, Path(__file__).parents[:2]), str(folder)]
    process = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    return folder


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("name", ["plain", "keyed"])
def test_the_bytes_are_the_same_again_and_in_another_process(
    name: str, form: str, elsewhere: Path, tmp_path: Path
) -> None:
    _require_format(form)
    suffix = FORMATS[form].suffix
    # The headers of zip and STEP files can contain the time in seconds.
    time.sleep(max(0.0, (elsewhere / f"{name}{suffix}").stat().st_mtime + 2.1 - time.time()))
    (tmp_path / "elsewhere").mkdir()
    first, other, again = (tmp_path / f"{stem}{suffix}" for stem in ("first", "other", "elsewhere/again"))
    FORMATS[form].write(_part(name), first)
    FORMATS[form].write(_part("released"), other)  # a writer that numbers its files would now have a higher number
    FORMATS[form].write(_part(name), again)
    assert sha256(first) == sha256(again)
    assert sha256(first) == sha256(elsewhere / f"{name}{suffix}")
    assert sha256(first) != sha256(other)


def test_a_jig_has_the_same_bytes_in_another_process(elsewhere: Path, tmp_path: Path) -> None:
    pytest.importorskip("build123d")
    FORMATS["stl"].write(_jig(), tmp_path / "jig.stl")
    assert sha256(tmp_path / "jig.stl") == sha256(elsewhere / "jig.stl")


def test_files_contain_no_path_and_no_date(tmp_path: Path) -> None:
    for form in FORMATS.values():
        if form.why_missing() is not None:
            continue
        path = tmp_path / f"a{form.suffix}"
        form.write(_part("plain"), path)
        data = path.read_bytes()
        assert str(tmp_path).encode() not in data
        assert b"/home" not in data
        assert b"202" not in data[:80] or form.name != "stl"
