"""An unexpected exception gives a message of one line, and its traceback is written to a log file."""

from __future__ import annotations

import os
import subprocess
import sys
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


def test_the_message_names_the_command_and_the_log(
    tmp_path: Path, log: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.setattr("tacbench_cad.checks.identify.examine", broken)
    part = tmp_path / "part.stl"
    part.write_text("solid")
    assert main(["check-part", str(part)]) == 1
    expected = f"error: unexpected IndexError in tacbench check-part {part}: list index out of range; the traceback is"
    assert capsys.readouterr().err == f"{expected} in {log}\n"
    assert "Traceback" in log.read_text() and "in broken" in log.read_text()
    assert log.read_text().startswith(f"tacbench {__version__}: tacbench check-part {part}\n")


def test_a_log_that_cannot_be_written_causes_no_second_error(
    tmp_path: Path, monkeypatch: Patch, capsys: Capture
) -> None:
    monkeypatch.setenv(LOG_VARIABLE, str(tmp_path / "missing" / "log"))
    monkeypatch.setattr("tacbench_cad.cli.diagnosis.diagnose", lambda: broken(tmp_path))
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


@pytest.mark.parametrize("word", ["x" * 5000, "a\0b.stl", "two\nlines"], ids=["too long", "null", "two lines"])
def test_any_command_gives_a_message_of_one_line(word: str, log: Path, capsys: Capture) -> None:
    report_unexpected(IndexError("list index out of range"), ["check-part", word])
    message = capsys.readouterr().err
    assert message.startswith("error: unexpected IndexError in tacbench check-part") and message.count("\n") == 1
    assert len(message) < 1000
