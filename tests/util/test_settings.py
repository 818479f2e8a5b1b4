"""Strict reading of TOML tables: every kind of value, its bounds, and what a mistake is called."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.settings import Table, read_toml

TABLE = Table({"n": 2, "x": 1.5, "s": "word", "b": True, "l": [1, 2], "r": [[1, 2], [3, 4]], "t": ["a", 1]}, "[t] ")


@pytest.mark.parametrize(
    ("read", "value"),
    [
        (lambda t: t.whole("n"), 2),
        (lambda t: t.number("n"), 2.0),
        (lambda t: t.number("x", least=1.5, most=1.5), 1.5),
        (lambda t: t.text("s", allowed=("word", "other")), "word"),
        (lambda t: t.flag("b"), True),
        (lambda t: t.numbers("l", 2), (1.0, 2.0)),
        (lambda t: t.numbers("l", None), (1.0, 2.0)),
        (lambda t: t.rows("r", 2, 2), ((1.0, 2.0), (3.0, 4.0))),
        (lambda t: t.texts("t"), ("a", "1")),
        (lambda t: t.number("nothing", None), None),
        (lambda t: t.whole("nothing", 7), 7),
    ],
)
def test_a_value_comes_out_typed(read: Callable[[Table], Any], value: Any) -> None:
    assert read(TABLE) == value


@pytest.mark.parametrize(
    ("read", "needles"),
    [
        (lambda t: t.whole("x"), ["[t] x", "1.5", "whole number"]),
        (lambda t: t.whole("b"), ["[t] b", "whole number"]),
        (lambda t: t.whole("n", most=1), ["[t] n", "from 0 to 1"]),
        (lambda t: t.number("s"), ["[t] s", "word", "finite number"]),
        (lambda t: t.number("b"), ["[t] b", "finite number"]),
        (lambda t: t.number("x", least=2.0), ["[t] x", "at least 2"]),
        (lambda t: t.number("x", least=2.0, most=3.0), ["[t] x", "from 2 to 3"]),
        (lambda t: t.text("n"), ["[t] n", "text"]),
        (lambda t: t.text("s", allowed=("wort",)), ["[t] s", "word", 'did you mean "wort"?']),
        (lambda t: t.flag("n"), ["[t] n", "true or false"]),
        (lambda t: t.numbers("l", 3), ["[t] l", "3 numbers"]),
        (lambda t: t.numbers("t", 2), ["[t] t", "'a'"]),
        (lambda t: t.rows("r", 3, 2), ["[t] r", "3 lists of 2"]),
        (lambda t: t.rows("r", 2, 3), ["[t] r", "3 numbers"]),
        (lambda t: t.texts("s"), ["[t] s", "list of texts"]),
        (lambda t: t.number("gone"), ["[t] gone", "is missing"]),
        (lambda t: t.table("n"), ["[n]", "must be a table"]),
        (lambda t: t.table("gone"), ["[gone]", "needed"]),
        (lambda t: t.tables("l"), ["[[l]]", "at least one"]),
        (lambda t: t.only("n", "x", "s", "b", "l", "r"), ["[t] t", "unknown key"]),
    ],
)
def test_a_mistake_names_table_key_and_value(read: Callable[[Table], Any], needles: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        read(TABLE)
    for needle in needles:
        assert needle in str(caught.value)


def test_not_a_number_is_no_number() -> None:
    for value in (float("nan"), float("inf")):
        with pytest.raises(InputError, match="finite"):
            Table({"x": value}).number("x")


@pytest.mark.parametrize(
    ("content", "needle"), [(b"\xff", "not UTF-8"), (b"[", "not valid TOML"), (None, "cannot be read")]
)
def test_a_file_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None, needle: str) -> None:
    path = tmp_path / "some.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=needle) as caught:
        read_toml(path, "thing", lambda table: table)
    assert "some.toml" in str(caught.value)
    with pytest.raises(InputError, match="is a folder"):
        read_toml(tmp_path, "thing", lambda table: table)


def test_a_readers_error_comes_out_with_the_files_name(tmp_path: Path) -> None:
    path = tmp_path / "some.toml"
    path.write_text("x = 1\n")
    with pytest.raises(InputError, match=r"some\.toml: x"):
        read_toml(path, "thing", lambda table: table.only("y"))
