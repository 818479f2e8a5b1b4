"""Output that several commands share."""

from __future__ import annotations

import pytest

from tacbench_cad.cli import common

Capture = pytest.CaptureFixture[str]


MATERIALS = ("hammer", "screwdriver", *(f"material_{number}" for number in range(1, 13)))


@pytest.mark.parametrize("width", [160, 80, 50])
def test_no_word_of_a_wide_table_is_broken(width: int, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(common, "PLAIN_WIDTH", width)
    heads = ("estimator", "held out", *(f">{name}" for name in MATERIALS))
    rows = [("forest", "press", *range(100, 114)), ("network", "whole print", *range(200, 214))]
    common.print_table("recall", heads, rows)
    out = capsys.readouterr().out
    words = out.replace("─", " ").split()
    assert set(words) == {
        *("recall", "(continued)", "estimator", "held", "out", "forest", "network", "press", "whole", "print"),
        *MATERIALS,
        *map(str, range(100, 114)),
        *map(str, range(200, 214)),
    }
    assert max(map(len, out.splitlines())) <= width
    for name in MATERIALS:  # each column is printed once, below its head
        assert words.count(name) == 1
    parts = out.count("recall")
    assert words.count("forest") == parts > 1
