"""Test reports on images whose prints or sessions are unknown: a random split of them leaks, and every place says so.

The images have no trace of their class. Each class was recorded in each of five sessions, and each of these recordings
has its own background. A random split recognises the background; a held-out session cannot.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest

pytest.importorskip("sklearn")
pytest.importorskip("matplotlib")

from tacbench_cad.cli import main
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.classification.hold_out import MAY_LEAK
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.runs.importing.importer import import_samples
from tacbench_cad.lab.runs.importing.sources import ImportOptions
from tacbench_cad.lab.runs.press_table import read

pytestmark = pytest.mark.usefixtures("single_thread", "few_trees", "no_figures")

CLASSES, SESSIONS, EACH = ("felt", "rubber"), 5, 10
Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write 100 images in a folder for each class, and a table with the session of each."""
    folder = tmp_path_factory.mktemp("photographs")
    rng = np.random.default_rng(3)
    rows = ["image,label,session"]
    for label in CLASSES:
        (folder / "images" / label).mkdir(parents=True)
        for session in range(SESSIONS):
            background = 128.0 + cv2.resize(rng.normal(0.0, 40.0, (4, 6)), (48, 32), interpolation=cv2.INTER_CUBIC)
            for number in range(EACH):
                image = np.clip(background + rng.normal(0.0, 4.0, (32, 48)), 0, 255).astype(np.uint8)
                name = f"{label}/{session}_{number}.png"
                cv2.imwrite(str(folder / "images" / name), image)
                rows.append(f"{name},{label},{session}")
    (folder / "labels.csv").write_text("\n".join(rows))
    return folder


def reported(runs: Path, out: Path, capsys: Capture) -> tuple[str, dict[str, Any], str]:
    """Classify and report; return what classify prints, the report's document, and the text of its page and tables."""
    assert main(["classify", str(runs), "--trials", "1", "--jobs", "1", "-o", str(out / "classified")]) == 0
    printed = capsys.readouterr().out
    words = ["report", str(runs), "--classify", str(out / "classified"), "-o", str(out / "report.html")]
    assert main(words) == 0
    capsys.readouterr()
    files = out / "report_files"
    page = re.sub(r"data:image/png;base64,[^\"]*", "", (out / "report.html").read_text())
    texts = [page, *(path.read_text() for path in files.rglob("*.csv"))]
    return printed, json.loads((files / "report.json").read_text()), "\n".join(texts)


def test_a_random_split_is_not_called_leak_free(images: Path, tmp_path: Path, capsys: Capture) -> None:
    assert import_samples([images / "images"], tmp_path / "runs", ImportOptions()).ok
    assert Design.of(read(tmp_path / "runs")).unknown_groups == ("prints", "sessions")
    printed, document, text = reported(tmp_path / "runs", tmp_path, capsys)
    for words in (printed, text, json.dumps(document)):
        assert "leak-free" not in words
    sentence = document["summary"]["Telling apart"]
    assert f"correctly, {MAY_LEAK} (chance" in sentence
    assert float(re.findall(r"predicts ([\d.]+) %", sentence)[0]) > 95.0
    assert "This is too high if similar samples are on both sides" in sentence
    assert f"predicted correctly, {MAY_LEAK} (%)" in text
    assert {row["hold_out"] for row in document["textures"]} == {MAY_LEAK}
    assert MAY_LEAK in printed and "prints and sessions are unknown" in printed
    assert "the session, print, printer" in next(iter(document["summary"].values()))
    assert "The hold-out levels were press (" in text  # and no level that was not computed


def test_the_json_document_does_not_call_a_random_split_leak_free(
    images: Path, tmp_path: Path, capsys: Capture
) -> None:
    assert import_samples([images / "images"], tmp_path / "runs", ImportOptions()).ok
    words = ["classify", str(tmp_path / "runs"), "--trials", "1", "--jobs", "1", "-o", str(tmp_path / "out"), "--json"]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "leak-free" not in text and json.loads(text)["settings"]["protocol"] == "hold-out"
    assert Classification.open(tmp_path / "out").settings.protocol == "leak-free"  # the option, to repeat the command


def test_a_split_and_its_score_say_that_a_random_split_may_leak(images: Path, tmp_path: Path, capsys: Capture) -> None:
    assert import_samples([images / "images"], tmp_path / "runs", ImportOptions()).ok
    split = tmp_path / "splits" / "split_press.json"
    assert main(["split", str(tmp_path / "runs"), "-o", str(tmp_path / "splits")]) == 0
    warning = "prints and sessions are unknown: if samples of one object or one session are similar"
    assert warning in " ".join(capsys.readouterr().err.split())
    document = json.loads(split.read_text())
    assert document["unknown_groups"] == ["prints", "sessions"]
    rows = ["fold,run,force_level,repeat,position,predicted"]
    for fold in document["folds"]:
        for run, *key, texture, _ in (document["presses"][i] for i in fold["test"]):
            rows.append(",".join(map(str, (fold["name"], run, *key, texture))))
    (tmp_path / "predictions.csv").write_text("\n".join(rows))
    assert main(["score", str(tmp_path / "predictions.csv"), str(split)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert f"{MAY_LEAK}: accuracy (%)" in printed and warning in printed and "prints" not in printed.split("note:")[0]
    assert main(["score", str(tmp_path / "predictions.csv"), str(split), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unknown_groups"] == ["prints", "sessions"]


def test_unknown_sessions_stand_beside_the_number_to_quote(images: Path, tmp_path: Path, capsys: Capture) -> None:
    """The five backgrounds are imported as five prints of each class; their sessions are unknown."""
    table = tmp_path / "labels.csv"
    table.write_text((images / "labels.csv").read_text().replace("session", "print", 1))
    assert import_samples([images / "images", table], tmp_path / "runs", ImportOptions()).ok
    _, document, text = reported(tmp_path / "runs", tmp_path, capsys)
    assert "predicted correctly, on unseen prints, sessions unknown (%)" in text
    assert {row["hold_out"] for row in document["textures"]} == {"copy, sessions unknown"}
    assert "leak-free" not in text and MAY_LEAK in text


def test_with_sessions_the_held_out_session_is_quoted(images: Path, tmp_path: Path, capsys: Capture) -> None:
    sources = [images / "images", images / "labels.csv"]
    assert import_samples(sources, tmp_path / "runs", ImportOptions()).ok
    assert Design.of(read(tmp_path / "runs")).unknown_groups == ("prints",)
    _, document, text = reported(tmp_path / "runs", tmp_path, capsys)
    sentence = document["summary"]["Telling apart"]
    assert "correctly, held out: session, prints unknown (chance" in sentence
    assert "predicted correctly, held out: session, prints unknown (%)" in text
    assert float(re.findall(r"predicts ([\d.]+) %", sentence)[0]) < 75.0
    assert "leak-free" not in text and MAY_LEAK in text  # the level press is below, with its name


def test_a_planned_study_is_leak_free(make_study: Callable[..., pd.DataFrame]) -> None:
    assert Design.of(make_study(still=0)).unknown_groups == ()
