"""Test tables of results: CSV files, JSON records and texts for people."""

from __future__ import annotations

import math
from pathlib import Path

import pandas as pd
import pytest

from tacbench_cad.lab.analysis.tables import Shown, frame_of, intervals, percent, records, shown, write_csv

TABLE = pd.DataFrame(
    {
        "printer": ['a, "b"', "007"],
        "accuracy": [2 / 3, math.nan],
        "low": [0.1, math.nan],
        "high": [1.0, math.nan],
        "images": [12_345, 0],
        "paired": [True, False],
    }
)


def test_a_table_is_written_with_all_digits(tmp_path: Path) -> None:
    path = write_csv(tmp_path / "scores.csv", TABLE)
    assert path.read_text(encoding="utf-8").splitlines() == [
        "printer,accuracy,low,high,images,paired",
        '"a, ""b""",0.6666666666666666,0.1,1.0,12345,true',
        "007,,,,0,false",
    ]


@pytest.mark.parametrize(("simulated", "text"), [((), "false"), (("sensor: a formula",), "true")])
def test_each_row_contains_whether_the_data_are_simulated(
    simulated: tuple[str, ...], text: str, tmp_path: Path
) -> None:
    lines = write_csv(tmp_path / "scores.csv", TABLE, simulated).read_text(encoding="utf-8").splitlines()
    assert [line.rsplit(",", 1)[1] for line in lines] == ["simulated", text, text]


def test_records_are_plain_values() -> None:
    first, second = records(TABLE)
    assert first == {
        "printer": 'a, "b"',
        "accuracy": 2 / 3,
        "low": 0.1,
        "high": 1.0,
        "images": 12_345,
        "paired": True,
    }
    assert second["accuracy"] is None and type(first["images"]) is int and type(first["paired"]) is bool
    assert list(frame_of([], ("a", "b")).columns) == ["a", "b"]


def test_shown_texts_and_alignment() -> None:
    frame = TABLE[["printer", "images", "paired"]].assign(accuracy=TABLE["accuracy"].map(percent))
    table = Shown("chosen", frame.assign(ends=intervals(TABLE, signed=True)))
    assert table.heads == ["printer", "images", "paired", "accuracy", "ends"]
    assert table.texts == [['a, "b"', "12,345", "yes", "66.7", "+10 to +100"], ["007", "0", "no", "", "none"]]
    assert table.right == [False, True, False, True, True]
    assert Shown("empty", frame.head(0)).texts == []


@pytest.mark.parametrize(
    ("value", "text"),
    [(True, "yes"), (1234, "1,234"), (0.123456, "0.1235"), (12345.6, "12,346"), ("x", "x"), (None, ""), (math.nan, "")],
)
def test_values_in_texts_are_short(value: object, text: str) -> None:
    assert shown(value) == text
