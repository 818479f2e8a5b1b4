"""Test the score of predictions for a split."""

from __future__ import annotations

import csv
import json
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("scipy")

from tacbench_cad.cli import score as command
from tacbench_cad.lab.analysis.classification.score import COLUMNS, Accuracy, PredictionsError, accuracy_of, score
from tacbench_cad.lab.analysis.classification.split_files import Split, SplitFold, SplitPress, write_split
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError

Rows = list[dict[str, str]]


@pytest.fixture
def split() -> Split:
    """Return a split of two textures with two prints each and five positions; each copy is held out in turn."""
    presses = tuple(
        SplitPress(
            run=f"{texture}_copy0{copy}",
            force_level=1,
            repeat=1,
            position=position,
            texture=texture,
            image_sha256=f"{position}",
        )
        for texture in ("texture-1", "texture-2")
        for copy in (1, 2)
        for position in range(1, 6)
    )
    copies = [[i for i, press in enumerate(presses) if press.key[0].endswith(str(copy))] for copy in (1, 2)]
    folds = tuple(SplitFold(name=f"copy {i + 1}", train=tuple(copies[1 - i]), test=tuple(copies[i])) for i in range(2))
    return Split(hold_out="copy", seed=0, presses=presses, folds=folds)


def right_rows(split: Split) -> Rows:
    rows = []
    for fold in split.folds:
        for i in fold.test:
            run, level, repeat, position = split.presses[i].key
            values = (fold.name, run, str(level), str(repeat), str(position), split.presses[i].texture)
            rows.append(dict(zip(COLUMNS, values, strict=True)))
    return rows


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
    assert result.confusion.tolist() == [[7, 3], [0, 10]]
    assert (result.accuracy.right, result.accuracy.presses, result.accuracy.prints) == (17, 20, 4)
    assert result.recall["texture-1"].fraction == 0.7 and result.recall["texture-2"].fraction == 1.0
    assert result.folds["copy 1"].fraction == 0.7 and result.folds["copy 2"].fraction == 1.0
    assert result.accuracy.low is not None and result.accuracy.high is not None
    assert 0.0 < result.accuracy.low < 0.85 < result.accuracy.high < 1.0


def test_order_and_other_columns_do_not_matter(split: Split, tmp_path: Path) -> None:
    rows = [{"confidence": "0.5", **row} for row in reversed(right_rows(split))]
    result = score(write_rows(tmp_path / "p.csv", rows), split)
    assert result.accuracy.fraction == 1.0 and result.confusion.trace() == 20


def a_repeated_row(rows: Rows) -> None:
    rows.append(dict(rows[4]))


def a_missing_row(rows: Rows) -> None:
    del rows[2], rows[7]


def a_row_of_another_fold(rows: Rows) -> None:
    rows[0]["fold"] = "copy 2"


def an_unknown_fold(rows: Rows) -> None:
    rows[0]["fold"] = "copy 9"


def an_unknown_press(rows: Rows) -> None:
    rows[0]["position"] = "77"


def an_unknown_texture(rows: Rows) -> None:
    rows[0]["predicted"] = "texture-9"


def a_repeat_that_is_not_a_number(rows: Rows) -> None:
    rows[0]["repeat"] = "one"


@pytest.mark.parametrize(
    ("change", "faults"),
    [
        (a_repeated_row, [("doubled", "line 22: fold copy 1, texture-1_copy01 force level 1 repeat 1 position 5")]),
        (
            a_missing_row,
            [
                ("missing", "fold copy 1, texture-1_copy01 force level 1 repeat 1 position 3: has no prediction"),
                ("missing", "fold copy 1, texture-2_copy01 force level 1 repeat 1 position 4: has no prediction"),
            ],
        ),
        (
            a_row_of_another_fold,
            [("unknown", "not a test press of this fold"), ("missing", "position 1: has no prediction")],
        ),
        (an_unknown_fold, [("unknown", "not a test press of this fold"), ("missing", "position 1: has no prediction")]),
        (
            an_unknown_press,
            [("unknown", "not a test press of this fold"), ("missing", "position 1: has no prediction")],
        ),
        (
            an_unknown_texture,
            [("unknown", "predicted = 'texture-9' is not a texture of the split file (texture-1, texture-2)")],
        ),
        (
            a_repeat_that_is_not_a_number,
            [("unknown", "not a test press of this fold"), ("missing", "position 1: has no prediction")],
        ),
    ],
)
def test_every_fault_is_reported(
    split: Split, tmp_path: Path, change: Callable[[Rows], None], faults: list[tuple[str, str]]
) -> None:
    rows = right_rows(split)
    change(rows)
    with pytest.raises(PredictionsError) as caught:
        score(write_rows(tmp_path / "p.csv", rows), split)
    assert [fault.kind for fault in caught.value.faults] == [kind for kind, _ in faults]
    for fault, (_, words) in zip(caught.value.faults, faults, strict=True):
        assert words in fault.text
    assert caught.value.exit_code == 1
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


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


def test_one_correlation_is_used_for_all_rows_of_a_score(split: Split, tmp_path: Path) -> None:
    """Both textures have two prints with five presses: the more accurate one has the higher interval."""
    rows = right_rows(split)
    for row in rows[:2]:
        row["predicted"] = "texture-2"
    worse, better = score(write_rows(tmp_path / "p.csv", rows), split).recall.values()
    assert worse.low is not None and better.low is not None and better.low > worse.low
    assert worse.high is not None and better.high is not None and better.high >= worse.high


def test_an_accuracy_of_one_print_has_no_interval() -> None:
    assert accuracy_of([True] * 600, [0] * 600, 0.1) == Accuracy(
        fraction=1.0, low=None, high=None, right=600, presses=600, prints=1
    )


def test_the_command_prints_the_score_or_every_fault(split: Split, tmp_path: Path) -> None:
    path = write_split(tmp_path / "split.json", split)
    rows = right_rows(split)
    answer = CliRunner().invoke(command.command, [str(write_rows(tmp_path / "p.csv", rows)), str(path), "--json"])
    assert answer.exit_code == 0
    assert json.loads(answer.stdout)["accuracy"]["fraction"] == 1.0
    plain = CliRunner().invoke(command.command, [str(tmp_path / "p.csv"), str(path)])
    assert "all folds" in plain.stdout and "texture-2 (recall)" in plain.stdout and "chance is 50.0%" in plain.stdout
    a_missing_row(rows)
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
