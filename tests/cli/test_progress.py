"""Progress on a stream that is not a terminal: few lines, with the remaining time as soon as it can be estimated."""

from __future__ import annotations

import pytest

from tacbench_cad.cli import progress
from tacbench_cad.cli.progress import ProgressLine


def test_a_log_gets_few_lines(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clock = iter([0.0, 0.0, 4.0, 12.0, 14.0, 30.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(clock))
    with ProgressLine() as line:
        for done in (1_000, 1_100, 1_200, 1_250, 1_500):
            line.show("images", done, 2_000)
    assert capsys.readouterr().err.splitlines() == [
        "[1,200/2,000] images, 0:00:48 left",
        "[1,500/2,000] images, 0:00:30 left",
    ]
