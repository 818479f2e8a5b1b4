"""Test tables of results: CSV files, JSON records and texts for people."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from tacbench_cad.lab.analysis.tables import Column, Table, percent, shown, truth
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import interval


@dataclass(frozen=True)
class Score:
    where: SimpleNamespace
    accuracy: float | None
    low: float | None
    high: float | None
    images: int
    paired: bool


COLUMNS = (
    Column("printer", source="where.printer"),
    Column("accuracy", float, "accuracy (%)", text=percent),
    Column("low", float),
    Column("high", float),
    Column("images", int),
    Column("paired", truth),
    Column("interval", head="95 % interval", derived=lambda row: interval(row["low"], row["high"]), right=True),
)
SCORES = (
    Score(SimpleNamespace(printer='a, "b"'), 2 / 3, 0.1, 1.0, 12_345, True),
    Score(SimpleNamespace(printer="c"), None, None, None, 0, False),
)
TABLE = Table.of(COLUMNS, SCORES, "scores")


def test_a_table_read_again_has_the_same_rows(tmp_path: Path) -> None:
    path = TABLE.write(tmp_path / "scores.csv")
    assert path.read_text(encoding="utf-8").splitlines() == [
        "printer,accuracy,low,high,images,paired",
        '"a, ""b""",0.6666666666666666,0.1,1.0,12345,true',
        "c,,,,0,false",
    ]
    assert Table.read(path, COLUMNS, "scores") == TABLE
    assert Table.read(path, COLUMNS[2:3]).rows == ({"low": 0.1}, {"low": None})


@pytest.mark.parametrize(("simulated", "text"), [((), "false"), (("sensor: a formula",), "true")])
def test_each_row_contains_whether_the_data_are_simulated(
    simulated: tuple[str, ...], text: str, tmp_path: Path
) -> None:
    lines = TABLE.write(tmp_path / "scores.csv", simulated).read_text(encoding="utf-8").splitlines()
    assert [line.rsplit(",", 1)[1] for line in lines] == ["simulated", text, text]
    assert Table.read(tmp_path / "scores.csv", COLUMNS, "scores") == TABLE


def test_the_records_are_stored() -> None:
    assert TABLE.records()[0] == {
        "printer": 'a, "b"',
        "accuracy": 2 / 3,
        "low": 0.1,
        "high": 1.0,
        "images": 12_345,
        "paired": True,
    }
    assert Table.of(COLUMNS, TABLE.records()) == Table.of(COLUMNS, SCORES)


def test_the_text_shows_chosen_columns_of_chosen_rows() -> None:
    table = TABLE.select("printer", "accuracy", "interval", "images", "paired", title="chosen")
    assert table.title == "chosen"
    assert table.heads == ["printer", "accuracy (%)", "95 % interval", "images", "paired"]
    assert table.right == [False, True, True, True, True]
    assert list(table.texts("-")) == [
        ['a, "b"', "66.7", "0.1 to 1", "12,345", "yes"],
        ["c", "-", "none", "0", "no"],
    ]
    assert [row["printer"] for row in table.where(lambda row: row["images"] == 0).rows] == ["c"]


@pytest.mark.parametrize(
    ("value", "text"), [(True, "yes"), (1234, "1,234"), (0.123456, "0.1235"), (12345.6, "12,346"), ("x", "x")]
)
def test_values_in_texts_are_short(value: object, text: str) -> None:
    assert shown(value) == text


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read: No such file"),
        (b"printer,accuracy\nx,0.5\n", "has no column low"),
        (b"", "is empty; it needs a header line"),
        (b"printer,accuracy,low,high,images,paired\nx,much,,,1,true\n", "could not convert string to float: 'much'"),
        (b"printer,accuracy,low,high,images,paired\nx,0.5,,,1,maybe\n", "'maybe' is neither true nor false"),
        (b"printer\xff", "not UTF-8|not valid UTF-8"),
    ],
)
def test_a_damaged_file_is_refused_by_name(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "scores.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        Table.read(path, COLUMNS)
    assert str(path) in str(error.value)


def test_values_that_are_not_numbers_are_empty(tmp_path: Path) -> None:
    path = Table.of((Column("x", float),), [{"x": math.nan}, {"x": None}, {"x": 1e-300}]).write(tmp_path / "x.csv")
    assert path.read_text(encoding="utf-8") == 'x\n""\n""\n1e-300\n'
