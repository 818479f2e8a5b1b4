"""Conversion between dataclasses and plain values: every kind of field, strictness, and error messages."""

from __future__ import annotations

import datetime
import enum
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from annotated_types import Interval, Len

from tacbench_cad.util.convert import NOT_STORED, from_plain, read_json, read_toml, to_plain
from tacbench_cad.util.errors import InputError


class Side(enum.Enum):
    LEFT = "left"
    RIGHT = "right"


@dataclass(frozen=True, kw_only=True)
class Protocol:
    forces_n: Annotated[tuple[float, ...], Len(1)] = (1.0, 2.0)
    depth_mm: Annotated[float, Interval(ge=0.0, le=10.0)] | None = None
    repeats: Annotated[int, Interval(ge=1, le=99)] = 3
    order: Literal["paper", "random"] = "paper"
    home: bool = True

    def __post_init__(self) -> None:
        if self.repeats == 13:
            raise InputError("repeats", self.repeats, "must not be 13")


@dataclass(frozen=True, kw_only=True)
class Wave:
    amplitude: float
    f: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Own:
    x_mm: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Document:
    protocol: Protocol
    wave: tuple[Wave, ...] = ()
    textures: tuple[str | int, ...] = ()
    size_mm: tuple[float, float] | None = None
    limits_mm: tuple[tuple[float, float], ...] = ()
    terms: int | None = field(default=None, metadata={"alias": "N"})
    side: Side = Side.LEFT
    out: Path | None = None
    began: Annotated[datetime.date, Interval(ge=datetime.date(1970, 1, 1), le=datetime.date(2200, 1, 1))] | None = None
    grid: Literal["even", "1mm"] | Own = "even"
    printer: Mapping[str, Wave] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    note: str = ""
    cached: int = field(default=0, metadata=NOT_STORED)


GOOD: dict[str, Any] = {
    "protocol": {"forces_n": [1, 2.5], "depth_mm": 3, "repeats": 2, "order": "random", "home": False},
    "wave": [{"amplitude": 1}, {"amplitude": 2.0, "f": 3.0}],
    "textures": [1, "waves.toml"],
    "size_mm": [40, 50.5],
    "limits_mm": [[0, 1], [2, 3]],
    "N": 25,
    "side": "right",
    "out": "runs",
    "began": "2026-01-31",
    "grid": {"x_mm": [1, 2]},
    "printer": {"a1": {"amplitude": 1.0}},
    "options": {"speed": [1, {"any": None}]},
    "note": "x",
}


def test_a_document_becomes_a_dataclass_and_is_restored_from_it() -> None:
    document = from_plain(Document, GOOD)
    assert document == Document(
        protocol=Protocol(forces_n=(1.0, 2.5), depth_mm=3.0, repeats=2, order="random", home=False),
        wave=(Wave(amplitude=1.0), Wave(amplitude=2.0, f=3.0)),
        textures=(1, "waves.toml"),
        size_mm=(40.0, 50.5),
        limits_mm=((0.0, 1.0), (2.0, 3.0)),
        terms=25,
        side=Side.RIGHT,
        out=Path("runs"),
        began=datetime.date(2026, 1, 31),
        grid=Own(x_mm=(1.0, 2.0)),
        printer={"a1": Wave(amplitude=1.0)},
        options={"speed": [1, {"any": None}]},
        note="x",
    )
    assert type(document.protocol.depth_mm) is float and type(document.wave[0].amplitude) is float
    plain = to_plain(document)
    assert from_plain(Document, json.loads(json.dumps(plain))) == document
    assert plain["N"] == 25 and plain["side"] == "right" and "terms" not in plain and "cached" not in plain


def changed(**values: Any) -> dict[str, Any]:
    return {**GOOD, **values}


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (changed(protocol={"depth_mm": "x"}), "f: [protocol] depth_mm = 'x': must be a finite number"),
        (changed(protocol={"depth_mm": "1,5"}), "f: [protocol] depth_mm = '1,5': must be a finite number"),
        (changed(protocol={"depth_mm": True}), "f: [protocol] depth_mm = True: must be a finite number"),
        (changed(protocol={"depth_mm": math.nan}), "f: [protocol] depth_mm = nan: must be a finite number"),
        (changed(protocol={"depth_mm": 11}), "f: [protocol] depth_mm = 11: must be at most 10"),
        (changed(protocol={"repeats": 0}), "f: [protocol] repeats = 0: must be at least 1"),
        (changed(protocol={"repeats": 2.0}), "f: [protocol] repeats = 2.0: must be a whole number"),
        (changed(protocol={"repeats": 13}), "f: [protocol] repeats = 13: must not be 13"),
        (changed(protocol={"order": "papr"}), "f: [protocol] order = 'papr': must be 'paper' or 'random'"),
        (changed(protocol={"order": 1}), "f: [protocol] order = 1: must be 'paper' or 'random'"),
        (changed(protocol={"home": 1}), "f: [protocol] home = 1: must be true or false"),
        (changed(protocol={"forces_n": []}), "f: [protocol] forces_n = []: must have at least 1 items"),
        (changed(protocol={"forces_n": 1}), "f: [protocol] forces_n = 1: must be a list"),
        (changed(protocol={"forces_n": [1, "a"]}), "f: [protocol] forces_n = 'a': must be a finite number"),
        (changed(protocol=[{}]), "f: [protocol]: must be a table"),
        ({}, "f: protocol: is missing"),
        (changed(wave=[{"amplitude": 1}, {}]), "f: [wave 2] amplitude: is missing"),
        (changed(wave=[1]), "f: [wave 1]: must be a table"),
        (changed(size_mm=[1, 2, 3]), "f: size_mm = [1, 2, 3]: may have at most 2 items"),
        (changed(limits_mm=[[1, 2], [1]]), "f: limits_mm = [1]: has too few items"),
        (changed(limits_mm=[1]), "f: limits_mm = 1: must be a list"),
        (changed(N="25"), "f: N = '25': must be a whole number"),
        (changed(terms=3), 'f: terms: unknown key; did you mean "textures"?'),
        (changed(side="up"), "f: side = 'up': must be 'left' or 'right'"),
        (changed(out=1), "f: out = 1: must be a path"),
        (changed(textures=[1.5]), "f: textures = 1.5: must be a string"),
        (changed(began="0001-01-01"), "f: began = '0001-01-01': must be at least 1970-01-01"),
        (changed(began="9999-12-31"), "f: began = '9999-12-31': must be at most 2200-01-01"),
        (changed(began="soon"), "f: began = 'soon': must be a valid date"),
        (changed(grid="odd"), "f: grid = 'odd'"),
        (changed(grid={"x": [1]}), "f: [grid] x: unknown key"),
        (changed(side="left", x_mm=[1]), "f: x_mm: is a key of another table"),
        (changed(printer={"a1": {"f": 1}}), "f: [printer.a1] amplitude: is missing"),
        (changed(printer=1), "f: [printer] = 1: must be a table"),
        (changed(note=["x"]), "f: note = ['x']: must be a string"),
    ],
)
def test_a_mistake_names_file_table_key_and_value(document: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        from_plain(Document, document, "f: ")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("N = " + "9" * 400, "N: must be a whole number"),
        ("N = " + "9" * 5000, "is not valid TOML"),
        ("N = 0x" + "f" * 5000, "N: must be a whole number"),
        ("note = " + "[" * 10_000, "nested deeper than"),
        (".".join(["a"] * 10_000) + " = 1", "nested deeper than"),
        ("[protocol]\ndepth_mm = nan", "[protocol] depth_mm = nan: must be a finite number"),
        ("[options]\nx = [{y = inf}]", "inf: must be a finite number"),
        ("N = 2026-13-01", "is not valid TOML"),
        ("protocol = 2026-01-01", "[protocol]: must be a table"),
    ],
)
def test_a_hostile_toml_file_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text + "\n")
    with pytest.raises(InputError) as caught:
        read_toml(path, Document, "study")
    assert message in str(caught.value) and str(path) in str(caught.value) and len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"N": ' + "9" * 400 + "}", "N: must be a whole number"),
        ('{"N": ' + "9" * 5000 + "}", "is not valid JSON"),
        ('{"note": ' + "[" * 10_000 + "]" * 10_000 + "}", "recursion limit exceeded"),
        ('{"note": ' + "[" * 200 + "]" * 200 + "}", "nested deeper than"),
        ('{"protocol": {"depth_mm": NaN}}', "is not valid JSON"),
        ('{"protocol": {"depth_mm": 1e999}}', "[protocol] depth_mm = inf: must be a finite number"),
        ('{"note": "\\ud800"}', "hex escape"),
        ('{"\\udfff": 1}', "lone leading surrogate"),
        ("[]", "must be a table"),
        ("", "is not valid JSON"),
    ],
)
def test_a_hostile_json_file_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_json(path, Document, "run")
    assert message in str(caught.value) and str(path) in str(caught.value) and len(str(caught.value)) < 500


def test_a_byte_order_mark_and_windows_line_ends_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "x.toml"
    path.write_bytes(b"\xef\xbb\xbfN = 3 # terms\r\n[protocol]\r\nrepeats = 5\r\n")
    assert read_toml(path, Document, "study") == Document(terms=3, protocol=Protocol(repeats=5))
