"""An unexpected exception gives a message of one line, and its traceback is written to a log file."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from tacbench_cad import __version__
from tacbench_cad.cli import main
from tacbench_cad.cli.unexpected import LOG_VARIABLE, report_unexpected

Capture = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


def broken(path: Path, *_: object, **__: object) -> object:
    return [][len(path.name)]


@pytest.fixture
def log(tmp_path: Path, monkeypatch: Patch) -> Path:
    path = tmp_path / "tacbench.log"
    monkeypatch.setenv(LOG_VARIABLE, str(path))
    return path


def test_the_file_that_cannot_be_read_is_named(tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.setattr("tacbench_cad.checks.identify.examine", broken)
    good, bad = tmp_path / "good.stl", tmp_path / "bad.stl"
    bad.write_text("solid")
    assert main(["check-part", str(bad), str(good)]) == 2
    error = capsys.readouterr().err
    assert error == f"error: {bad}: unexpected IndexError: list index out of range; the traceback is in {log}\n"
    assert "Traceback" in log.read_text() and "in broken" in log.read_text()
    assert log.read_text().startswith(f"tacbench {__version__}: tacbench check-part {bad} {good}\n")


def test_a_file_in_an_input_folder_is_named(tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture) -> None:
    (tmp_path / "runs" / "a").mkdir(parents=True)
    inner = tmp_path / "runs" / "a" / "run.json"
    inner.write_text("{}")
    monkeypatch.setattr("tacbench_cad.lab.analysis.collection.Collection.open", lambda _: broken(inner))
    assert main(["split", str(tmp_path / "runs"), "-o", str(tmp_path / "out")]) == 2
    assert f"error: {inner}: unexpected IndexError" in capsys.readouterr().err


def test_an_error_without_an_input_file_names_no_file(
    tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    out = tmp_path / "out.html"
    out.write_text("an earlier page")
    monkeypatch.setattr("tacbench_cad.render.viewing.page.require_page", broken)
    assert main(["view", "4", "-o", str(out)]) == 1
    assert capsys.readouterr().err.startswith("error: unexpected IndexError: ")


def test_the_default_log_is_a_new_temporary_file(tmp_path: Path, monkeypatch: Patch, capsys: Capture) -> None:
    monkeypatch.delenv(LOG_VARIABLE, raising=False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("tacbench_cad.util.doctor.diagnose", lambda: broken(tmp_path))
    assert main(["doctor"]) == 1
    (log,) = tmp_path.glob("tacbench-*.log")
    assert str(log) in capsys.readouterr().err and "Traceback" in log.read_text()


def test_a_log_that_cannot_be_written_causes_no_second_error(
    tmp_path: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.setenv(LOG_VARIABLE, str(tmp_path / "missing" / "log"))
    monkeypatch.setattr("tacbench_cad.util.doctor.diagnose", lambda: broken(tmp_path))
    assert main(["doctor"]) == 1
    error = capsys.readouterr().err
    assert "the log file cannot be written" in error and error.count("\n") == 1


@pytest.mark.skipif(sys.platform == "win32", reason="pipes of POSIX")
def test_a_closed_pipe_ends_the_command_without_a_message() -> None:
    code = "import sys; from tacbench_cad.cli import main; sys.exit(main(['textures', '--json']))"
    read, write = os.pipe()
    os.close(read)
    try:
        process = subprocess.run(
            [sys.executable, "-c", code], stdout=write, stderr=subprocess.PIPE, text=True, timeout=60
        )
    finally:
        os.close(write)
    assert (process.returncode, process.stderr) == (1, "")


def _no_permission(path: Path) -> bool:
    raise PermissionError(13, "Permission denied", str(path))


@pytest.mark.parametrize(
    "word",
    ["x" * 5000, "a\0b.stl", "loop/part.stl", "~nobody/part.stl", "a/../" * 2000 + "part.stl"],
    ids=["too long", "null", "loop", "user", "long way"],
)
def test_a_path_that_cannot_be_read_causes_no_second_error(
    word: str, tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    monkeypatch.chdir(tmp_path)
    error = IndexError("list index out of range")
    try:
        broken(Path(word))
    except IndexError as raised:
        error = raised
    assert report_unexpected(error, ["check-part", word]) in (1, 2)
    message = capsys.readouterr().err
    assert "unexpected IndexError" in message and message.count("\n") == 1


def test_a_path_that_may_not_be_read_is_named(tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture) -> None:
    locked = tmp_path / "locked" / "part.stl"
    monkeypatch.setattr(Path, "exists", _no_permission)
    monkeypatch.setattr(Path, "is_file", _no_permission)
    error = PermissionError(13, "Permission denied", str(locked))
    assert report_unexpected(error, ["check-part", str(locked)]) == 2
    assert capsys.readouterr().err.startswith(f"error: {locked}: unexpected PermissionError: ")


def test_a_current_folder_that_was_removed_causes_no_second_error(
    tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    try:
        assert report_unexpected(OSError(5, "Input/output error", "part.stl"), ["check-part", "part.stl"]) == 1
    finally:
        os.chdir(tmp_path)
    assert capsys.readouterr().err.count("\n") == 1
