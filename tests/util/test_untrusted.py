"""Input files that are irregular or too large, or that are not documents or tables, are refused in one line."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError

posix = pytest.mark.skipif(sys.platform == "win32", reason="no named pipes or devices")


def refusal(path: Path, kind: str = "any", within: Path | None = None) -> str:
    with pytest.raises(InputError) as caught:
        untrusted.read_bytes(path, "thing", kind, within=within)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)
    return str(caught.value)


@posix
def test_a_named_pipe_a_device_and_a_link_to_one_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    (tmp_path / "itself").symlink_to("itself")
    for name in ("pipe", "endless"):
        assert "is a pipe, a socket or a device" in refusal(tmp_path / name)
    assert "is a pipe, a socket or a device" in refusal(Path("/dev/zero"))
    assert "cannot be read" in refusal(tmp_path / "itself")


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    assert "cannot be read: No such file" in refusal(tmp_path / "gone")
    assert "is a folder" in refusal(tmp_path)
    with pytest.raises(InputError, match="cannot be read"):
        untrusted.read_bytes(Path("a\0b"))


@posix
def test_a_link_that_leads_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("x")
    inner = tmp_path / "run"
    inner.mkdir()
    (inner / "file").write_text("y")
    (inner / "out").symlink_to("../secret")
    (inner / "in").symlink_to("file")
    assert "is a link to a file outside" in refusal(inner / "out", within=inner)
    assert untrusted.read_bytes(inner / "in", within=inner) == b"y"
    assert untrusted.read_bytes(inner / "out") == b"x"


def test_the_message_about_a_size_limit_names_the_variable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "big.toml"
    with path.open("wb") as stream:
        stream.truncate(20_000_000)
    assert "has 20 MB, more than the 8 allowed; set the environment variable TACBENCH_LIMITS=3" in refusal(path, "toml")
    monkeypatch.setenv(untrusted.LIMITS_VARIABLE, "3")
    assert len(untrusted.read_bytes(path, "thing", "toml")) == 20_000_000
    for wrong in ("0", "-1", "nan", "inf", "x", ""):
        monkeypatch.setenv(untrusted.LIMITS_VARIABLE, wrong)
        with pytest.raises(InputError, match="TACBENCH_LIMITS"):
            untrusted.read_bytes(path)


def test_a_table_has_its_header_and_rows_of_equal_length(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(b'\xef\xbb\xbfa,b\r\n1,"x, y"\r\n\r\n2,z\r\n')
    assert untrusted.read_rows(path, "table", ("a", "b")) == [["1", "x, y"], ["2", "z"]]
    with pytest.raises(InputError, match=r't\.csv header = .a,b.: must be a,c; "b" is unknown'):
        untrusted.read_rows(path, "table", ("a", "c"))


@pytest.mark.parametrize(
    ("content", "needle"),
    [
        (b"", "is empty"),
        (b"a,b\n1\n", "line 2: has 1 fields, but the header has 2"),
        (b'a,b\n1,"x', "line 2: is not valid CSV"),
        (b"a,b\n1,\0\n", "null character"),
        (b"a\xff\n", "is not UTF-8 text"),
        (b"a\n" + b"x" * 1_000_001, "is not valid CSV"),
        (b"a," * 2000 + b"\n", "more than 1000 columns"),
    ],
)
def test_a_file_that_is_not_a_table_is_refused(tmp_path: Path, content: bytes, needle: str) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=needle):
        untrusted.read_table(path, "table")
