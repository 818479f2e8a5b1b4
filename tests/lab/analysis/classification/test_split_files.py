"""Test split files: their contents, their hashes, and files that are refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from helpers.studies import write_study

from tacbench_cad.cli import split as command
from tacbench_cad.lab.analysis.classification.split_files import (
    Split,
    SplitFold,
    SplitPress,
    make_splits,
    read_split,
    write_split,
)
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.press_table import read
from tacbench_cad.util.errors import InputError


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("split") / "runs"
    write_study(folder, levels=(1, 2), simulated="a formula")
    return folder


@pytest.fixture(scope="module")
def splits(runs: Path) -> dict[str, Split]:
    result, notes = make_splits(read(runs), seed=3, folds=2)
    assert not notes
    return {split.hold_out: split for split in result}


def test_every_level_has_a_split_that_lists_its_presses(splits: dict[str, Split], runs: Path) -> None:
    assert list(splits) == ["press", "position", "force", "copy", "printer-filament"]
    copy = splits["copy"]
    assert [fold.name for fold in copy.folds] == ["copy 1", "copy 2"]
    assert len(copy.presses) == 8 * 2 * 2 * 4 and copy.simulated == ("sensor: a formula",)
    row = (runs / copy.presses[0].run / schema.TARGETS_FILE).read_text().splitlines()[1]
    assert copy.presses[0].image_sha256 in row
    for fold in copy.folds:
        held = {copy.presses[i].run[-6:] for i in fold.test}
        assert held == {fold.name.replace("copy ", "copy0")}
        assert not held & {copy.presses[i].run[-6:] for i in fold.train}


def test_a_split_file_round_trips_and_is_reproducible(splits: dict[str, Split], tmp_path: Path) -> None:
    for split in splits.values():
        first, second = write_split(tmp_path / "a.json", split), write_split(tmp_path / "b.json", split)
        assert first.read_bytes() == second.read_bytes()
        assert read_split(first) == split
        document = json.loads(first.read_bytes())
        assert document["protocol"] == f"tacbench-split/1:{split.hold_out}:{split.design_sha256[:12]}"


def test_another_sensor_on_the_same_prints_has_the_same_protocol_and_other_data(
    splits: dict[str, Split], tmp_path: Path
) -> None:
    from helpers.studies import noise_image

    write_study(tmp_path, levels=(1, 2), image=noise_image)
    others = {split.hold_out: split for split in make_splits(read(tmp_path), seed=3, folds=2)[0]}
    for level, split in splits.items():
        assert others[level].protocol == split.protocol
        assert others[level].data_sha256 != split.data_sha256
    reseeded = {split.hold_out: split for split in make_splits(read(tmp_path), seed=4, folds=2)[0]}
    assert reseeded["press"].protocol != splits["press"].protocol


def test_a_level_that_the_data_do_not_support_is_left_out_with_a_reason(tmp_path: Path) -> None:
    write_study(tmp_path, prints=[("ender-3", "pla-plus")], copies=1)
    result, notes = make_splits(read(tmp_path))
    assert [split.hold_out for split in result] == ["press", "position"]
    assert len(notes) == 3 and all("is left out: " in note for note in notes)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(schema="other"), "is not a split file"),
        (lambda d: d.update(version=2), "has version 2, but this program reads version 1"),
        (lambda d: d["folds"][0]["test"].pop(), "does not match the contents of the file"),
        (lambda d: d["presses"][0].__setitem__(5, "0" * 64), "data_sha256"),
        (lambda d: d["folds"][0]["test"].append(10**6), "must be whole numbers from 0 to"),
        (lambda d: d["folds"][0]["test"].append(d["folds"][0]["train"][0]), "must not be twice in train and test"),
        (lambda d: d["folds"][0]["train"].append(d["folds"][0]["train"][0]), "must not be twice in train and test"),
        (lambda d: d["folds"].append(d["folds"][0]), "occurs twice"),
        (lambda d: d["presses"][0].pop(), "presses"),
        (lambda d: d["folds"][0]["train"].append("1"), "must be a whole number"),
        (lambda d: d["folds"].clear(), "must have at least one fold"),
        (lambda d: d["presses"].append(d["presses"][0]), "occurs twice"),
        (lambda d: d.pop("seed"), "seed: is missing"),
    ],
)
def test_a_file_that_was_changed_is_refused(
    splits: dict[str, Split], tmp_path: Path, change: Callable[[dict[str, Any]], object], words: str
) -> None:
    path = write_split(tmp_path / "split.json", splits["copy"])
    document = json.loads(path.read_bytes())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=words) as caught:
        read_split(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("text", [None, "{", "[]", "3"])
def test_other_files_are_refused(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "split.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match="split"):
        read_split(path)


def test_a_fold_must_train_and_test() -> None:
    press = SplitPress("a", 1, 1, 1, "texture-1", "")
    with pytest.raises(InputError, match="fold one: must have presses both in train and in test"):
        Split(hold_out="copy", seed=0, presses=(press,), folds=(SplitFold("one", (), (0,)),))


def test_images_that_were_not_imported_have_checksums(tmp_path: Path) -> None:
    for texture in "ab":
        (tmp_path / texture).mkdir()
        for number in range(4):
            image = np.random.default_rng(number).integers(0, 256, (8, 8), dtype=np.uint8)
            cv2.imwrite(str(tmp_path / texture / f"{number}.png"), image)
    (split,), _ = make_splits(read(tmp_path))
    assert {len(press.image_sha256) for press in split.presses} == {64} and split.unknown_groups == (
        "prints",
        "sessions",
    )


def test_the_command_writes_and_describes_the_files(runs: Path, tmp_path: Path) -> None:

    out = tmp_path / "splits"
    answer = CliRunner().invoke(command.command, [str(runs), "-o", str(out), "--hold-out", "copy,force", "--json"])
    assert answer.exit_code == 0, answer.output
    document = json.loads(answer.stdout)
    assert sorted(path.name for path in out.glob("*.json")) == ["split_copy.json", "split_force.json"]
    assert [entry["hold_out"] for entry in document["splits"]] == ["force", "copy"]
    for entry in document["splits"]:
        assert read_split(Path(entry["file"])).protocol == entry["protocol"]
