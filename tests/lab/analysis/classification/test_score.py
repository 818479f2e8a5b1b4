"""Test the score of predictions for a split."""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("scipy")

from tacbench_cad.cli import score as command
from tacbench_cad.lab.analysis.classification.score import COLUMNS, PredictionsError, score
from tacbench_cad.lab.analysis.classification.split_files import Split, SplitFold, SplitPress, write_split
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError

Rows = list[dict[str, str]]


@pytest.fixture
def split() -> Split:
    """Return a split of two textures with two prints each and five positions; each copy is held out in turn."""
    presses = tuple(
        SplitPress(f"{texture}_copy0{copy}", 1, 1, position, texture, f"{position}")
        for texture in ("texture-1", "texture-2")
        for copy in (1, 2)
        for position in range(1, 6)
    )
    copies = [[i for i, press in enumerate(presses) if press.run.endswith(str(copy))] for copy in (1, 2)]
    folds = tuple(SplitFold(f"copy {i + 1}", tuple(copies[1 - i]), tuple(copies[i])) for i in range(2))
    return Split(hold_out="copy", seed=0, presses=presses, folds=folds)


def right_rows(split: Split) -> Rows:
    tests = [(fold.name, split.presses[i]) for fold in split.folds for i in fold.test]
    return [dict(zip(COLUMNS, map(str, (name, *press[:5])), strict=True)) for name, press in tests]


def write_rows(path: Path, rows: Rows) -> Path:
    with path.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_accuracy_recall_and_confusion_of_known_answers(split: Split, tmp_path: Path) -> None:
    rows = right_rows(split)
    for row in rows[:3]:  # three presses of texture-1, copy 1
        row["predicted"] = "texture-2"
    result = score(write_rows(tmp_path / "p.csv", rows), split)
    assert result.confusion.to_numpy().tolist() == [[7, 3], [0, 10]]
    names = ["all", "copy 1", "copy 2", "texture-1 (recall)", "texture-2 (recall)"]
    fractions = dict(zip(names, [0.85, 0.7, 1, 0.7, 1], strict=True))
    assert result.table.set_index("tested_on")["accuracy"].to_dict() == pytest.approx(fractions)
    whole, _, _, worse, better = result.table.itertuples()
    assert (whole.images, whole.units) == (20, "4 prints") and 0.0 < whole.low < 0.85 < whole.high < 1.0
    assert worse.low < better.low and worse.high < better.high  # one correlation is used for all rows


def test_order_and_other_columns_do_not_matter(split: Split, tmp_path: Path) -> None:
    rows = [{"confidence": "0.5", **row} for row in reversed(right_rows(split))]
    result = score(write_rows(tmp_path / "p.csv", rows), split)
    assert result.table["accuracy"][0] == 1.0 and result.confusion.to_numpy().trace() == 20


OTHER = ["unknown: line 2: fold .* is not a test press of this fold", "missing: .* position 1: has no prediction"]
TEXTURE = r"unknown: line 2: .* predicted = 'texture-9' is not a texture of the split file \(texture-1, texture-2\)"


@pytest.mark.parametrize(
    ("change", "faults"),
    [
        (lambda rows: rows.append(dict(rows[4])), ["doubled: line 22: fold copy 1, texture-1_copy01 .* position 5"]),
        (
            lambda rows: (rows.pop(2), rows.pop(7)),
            ["missing: .* position 3: has no", "missing: .*texture-2.* position 4"],
        ),
        (lambda rows: rows[0].update(fold="copy 2"), OTHER),
        (lambda rows: rows[0].update(fold="copy 9"), OTHER),
        (lambda rows: rows[0].update(position="77"), OTHER),
        (lambda rows: rows[0].update(repeat="one"), OTHER),
        (lambda rows: rows[0].update(predicted="texture-9"), [TEXTURE]),
    ],
)
def test_every_fault_is_reported(
    split: Split, tmp_path: Path, change: Callable[[Rows], object], faults: list[str]
) -> None:
    rows = right_rows(split)
    change(rows)
    with pytest.raises(PredictionsError) as caught:
        score(write_rows(tmp_path / "p.csv", rows), split)
    assert len(caught.value.faults) == len(faults) and caught.value.exit_code == 1
    for pattern in faults:
        assert any(re.match(pattern, fault) for fault in caught.value.faults), caught.value.faults


@pytest.mark.parametrize(("text", "words"), [(None, "cannot be read"), ("a,b\n1,2\n", "has no column fold")])
def test_a_file_without_predictions_is_refused(split: Split, tmp_path: Path, text: str | None, words: str) -> None:
    path = tmp_path / "p.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=words):
        score(path, split)


def test_bytes_that_are_not_text_are_refused(split: Split, tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(b"fold,run\n\xff\xfe\x00")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        score(path, split)


def test_the_command_prints_the_score_or_every_fault(split: Split, tmp_path: Path) -> None:
    path = write_split(tmp_path / "split.json", split)
    rows = right_rows(split)
    answer = CliRunner().invoke(command.command, [str(write_rows(tmp_path / "p.csv", rows)), str(path), "--json"])
    assert answer.exit_code == 0
    assert json.loads(answer.stdout)["accuracies"][0]["accuracy"] == 1.0
    plain = CliRunner().invoke(command.command, [str(tmp_path / "p.csv"), str(path)])
    assert "tested on" in plain.stdout and "texture-2 (recall)" in plain.stdout and "chance is 50.0%" in plain.stdout
    del rows[2], rows[7]
    bad = CliRunner().invoke(command.command, [str(write_rows(tmp_path / "p.csv", rows)), str(path)])
    assert isinstance(bad.exception, PredictionsError)
    assert bad.stderr.count("missing: ") == 2


def test_invalid_prediction_files_are_refused(split: Split, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = write_rows(tmp_path / "p.csv", right_rows(split))
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(InputError, match="is a pipe, a socket or a device"):
        score(tmp_path / "pipe.csv", split)
    (tmp_path / "short.csv").write_text(good.read_text() + "copy 1,texture-1_copy01\n")
    with pytest.raises(InputError, match="line 22: has 2 fields, but the header has 6"):
        score(tmp_path / "short.csv", split)
    monkeypatch.setattr(untrusted, "MAX_MB", {**untrusted.MAX_MB, "table": 1e-6})
    with pytest.raises(InputError, match="more than the 1e-06 allowed"):
        score(good, split)
