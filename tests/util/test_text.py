"""Text for counts and intervals in messages."""

from __future__ import annotations

import math

import pytest

from tacbench_cad.util.text import at_most, counted, decimal_hint, interval, short_name


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
def test_number_with_noun(number: int, what: str, text: str) -> None:
    assert counted(number, what) == text


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (1.7712, 1738.0, "1.77 to 1,740"),
        (0.001234, 0.5, "0.00123 to 0.5"),
        (999.6, 1_234_567.0, "1,000 to 1,230,000"),
        (-0.0, 2.0, "0 to 2"),
        (1.7712, math.inf, "1.77 or more"),
        (None, None, "none"),
        (math.nan, 1.0, "none"),
    ],
)
def test_interval_of_values(low: float | None, high: float | None, text: str) -> None:
    assert interval(low, high) == text


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("1,5", "; write 1.5"),
        (" -0,25 ", "; write -0.25"),
        (",5", "; write .5"),
        ("1,5,2", ""),
        ("1, 5", ""),
        ("a,5", ""),
    ],
)
def test_a_number_with_a_decimal_comma_is_written_with_a_point(text: str, hint: str) -> None:
    assert decimal_hint(text) == hint


def test_long_names_of_files_are_cut_off_and_stay_unique() -> None:
    corners = "x".join(f"{number}.25" for number in range(60))
    names = [short_name(f"texture-2_paper_x1_poly{corners}x{last}") for last in (1, 2)]
    assert names[0] != names[1]
    assert all(len(name) == 107 and name.startswith("texture-2_paper_x1_poly0.25x1.25") for name in names)


def test_a_bound_is_rounded_up() -> None:
    texts = [at_most(bound, 2) for bound in (0.00264, 0.01, 0.0100001, 0.0, 12.31, 0.000123, 9.96)]
    assert texts == ["0.0027", "0.01", "0.011", "0", "13", "0.00013", "10"]
