"""Test that classes are listed as people count, 2 before 10, and that every number belongs to its class."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tacbench_cad.cli import main
from tacbench_cad.lab import import_samples
from tacbench_cad.lab.analysis.classification.score import COLUMNS
from tacbench_cad.util.text import natural, natural_unique

Capture = pytest.CaptureFixture[str]
CLASSES = [f"material_{number}" for number in range(1, 13)]
#: These two look alike, so that they are confused with each other and with nothing else.
ALIKE = ("material_2", "material_10")


def test_the_order_is_that_of_people() -> None:
    names = ["a10", "a9", "a1b2", "a1b10", "2", "10", "1", "a01", "a1", "", "9" * 5000]
    assert sorted(names, key=natural)[:4] == ["", "1", "2", "10"]
    assert sorted(names, key=natural)[5:] == ["a01", "a1", "a1b2", "a1b10", "a9", "a10"]
    values, index = natural_unique(np.array(["b", "a10", "a9", "b"]))
    assert values.tolist() == ["a9", "a10", "b"] and values[index].tolist() == ["b", "a10", "a9", "b"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Import six images of each of twelve classes, told apart by the place of a bright square."""
    pytest.importorskip("sklearn")
    out = tmp_path_factory.mktemp("classes")
    for number, name in enumerate(CLASSES):
        place = 8 * (CLASSES.index(ALIKE[1]) if name == ALIKE[0] else number)
        (out / "classes" / name).mkdir(parents=True)
        for image in range(6):
            pixels = np.random.default_rng(10 * number + image).integers(0, 30, (16, 96), dtype=np.uint8)
            pixels[:, place : place + 8] += 200
            Image.fromarray(pixels).save(out / "classes" / name / f"{image}.png")
    assert import_samples([out / "classes"], out / "runs").ok
    return out / "runs"


@pytest.mark.usefixtures("no_figures")
def test_tables_and_confusion_matrices_are_in_natural_order(runs: Path, tmp_path: Path, capsys: Capture) -> None:
    words = ("--trials", "1", "--hold-out", "press", "--components", "12", "--jobs", "1", "--resolution", "1")
    assert main(["classify", str(runs), "-o", str(tmp_path / "out"), *words, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["textures"] == CLASSES
    table = pd.read_csv(tmp_path / "out" / "confusion.csv").set_index(["texture", "predicted"])["count"]
    counts, predictions = table.unstack(sort=False), pd.read_csv(tmp_path / "out" / "predictions.csv")
    assert list(counts.index) == list(counts.columns) == CLASSES
    for texture, row in counts.iterrows():
        assert set(row.index[row > 0]) <= (set(ALIKE) if texture in ALIKE else {texture})
    there = table[table > 0].to_dict()
    assert predictions[["texture", "predicted"]].value_counts().to_dict() == there


def test_predictions_of_others_are_scored_for_their_class(runs: Path, tmp_path: Path, capsys: Capture) -> None:
    assert main(["split", str(runs), "-o", str(tmp_path / "splits"), "--hold-out", "press"]) == 0
    path = tmp_path / "splits" / "split_press.json"
    split = json.loads(path.read_text())
    assert split["textures"] == CLASSES
    lines = [",".join(COLUMNS)]
    for fold in split["folds"]:
        for index in fold["test"]:
            run, level, repeat, position, texture, _ = split["presses"][index]
            predicted = ALIKE[1] if texture == ALIKE[0] else texture
            lines.append(",".join(map(str, (fold["name"], run, level, repeat, position, predicted))))
    (tmp_path / "predictions.csv").write_text("\n".join(lines) + "\n")
    capsys.readouterr()
    assert main(["score", str(tmp_path / "predictions.csv"), str(path), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    recall = {row["tested_on"]: row["accuracy"] for row in document["accuracies"]}
    assert list(recall)[-12:] == [f"{name} (recall)" for name in CLASSES]
    assert [recall[f"{name} (recall)"] for name in CLASSES] == [float(name != ALIKE[0]) for name in CLASSES]
    assert document["confusion"][1][9] == 6 and np.trace(document["confusion"]) == 66
