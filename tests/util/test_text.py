"""How counts stand in messages."""

from __future__ import annotations

import pytest

from tacbench_cad.util.text import counted


@pytest.mark.parametrize(
    ("number", "what", "text"),
    [
        (0, "run", "0 runs"),
        (1, "run", "1 run"),
        (2, "force level", "2 force levels"),
        (1, "press", "1 press"),
        (2400, "press", "2,400 presses"),
    ],
)
def test_counted(number: int, what: str, text: str) -> None:
    assert counted(number, what) == text
