"""Test ``tacbench classify``: files, resuming, an interruption, users' estimators and bad input."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest
from helpers.studies import write_study

from tacbench_cad.cli import main

pytestmark = pytest.mark.usefixtures("single_thread", "few_trees")

Capture = pytest.CaptureFixture[str]
#: Settings for a short computation.
QUICK = ("--resolution", "1", "--components", "4", "--jobs", "1", "--trials", "2", "--epochs", "200")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study") / "runs"
    write_study(folder, levels=(1, 2), still=1, simulated="simulated TacTip")
    return folder


def test_leak_free_tables_and_figures_agree(runs: Path, tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "out"
    assert main(["classify", str(runs), "-o", str(out), *QUICK]) == 0
    output = capsys.readouterr().out
    assert output.endswith(f"\nNext: tacbench report {runs} --classify {out}\n")
    assert "simulated: sensor (see run.json)\n" in output and "chance is 50.0" in output
    table, confusion, predictions = (
        pd.read_csv(out / f"{name}.csv") for name in ("classification", "confusion", "predictions")
    )
    assert all(of["simulated"].all() for of in (table, confusion, predictions)) and set(predictions["trial"]) == {1, 2}
    for row in table.itertuples():
        mine = predictions[predictions["hold_out"] == row.hold_out]
        mine = mine if row.tested_on == "all" else mine[mine["tested_on"] == row.tested_on]
        right = mine["texture"] == mine["predicted"]
        assert row.accuracy == pytest.approx(right.mean(), abs=1e-12) and row.images * 2 == len(mine)
        assert row.standard_deviation == pytest.approx(right.groupby(mine["trial"]).mean().std())
        if row.tested_on == "all":
            cells = confusion[confusion["hold_out"] == row.hold_out]
            assert cells["count"].sum() == len(mine)
            assert cells["count"][cells["texture"] == cells["predicted"]].sum() == right.sum()
    for stem in ("hold_out_levels", "confusion_forest"):
        assert (out / f"{stem}.png").read_bytes().startswith(b"\x89PNG")
        assert (out / f"{stem}.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.usefixtures("no_figures")
def test_finished_trials_are_kept_and_results_depend_on_the_seed_only(runs: Path, tmp_path: Path) -> None:
    out, other = tmp_path / "out", tmp_path / "other"
    command = ["classify", str(runs), *QUICK, "--hold-out", "press", "--folds", "2"]
    assert main([*command, "-o", str(out)]) == 0
    first, trials = (out / "predictions.csv").read_bytes(), sorted((out / "trials").iterdir())
    stamps = [path.stat().st_mtime_ns for path in trials]
    trials[1].write_bytes(trials[1].read_bytes()[:100])
    assert main([*command, "-o", str(out)]) == 0
    assert [path.stat().st_mtime_ns == stamp for path, stamp in zip(trials, stamps, strict=True)] == [True, False]
    assert main([*command, "-o", str(other)]) == 0
    assert (out / "predictions.csv").read_bytes() == first == (other / "predictions.csv").read_bytes()
    for count, more in ((4, ["--seed", "1"]), (5, ["--trials", "3"])):
        assert main([*command, "-o", str(out), *more]) == 0
        assert len(list((out / "trials").iterdir())) == count and (out / "predictions.csv").read_bytes() != first


def test_paper_prints_the_warning_and_not_the_papers_figures(runs: Path, tmp_path: Path, capsys: Capture) -> None:
    assert main(["classify", str(runs), "-o", str(tmp_path), *QUICK, "--protocol", "paper"]) == 0
    output = capsys.readouterr().out
    assert "63.98" not in output and "inflated" in output and "the text says 300" in output
    tested = pd.read_csv(tmp_path / "predictions.csv").groupby("hold_out")["augmentation"].unique().map(set)
    assert tested["train"] == tested["test"] == {"none", "noise 5", "+10", "-10"} and tested["unseen"] == {"none"}
    assert (tmp_path / "paper_table.png").is_file()
    assert (tmp_path / "confusion_network_bambu-p1p_pla-minus.pdf").is_file()


def test_as_published_prints_the_papers_figures_next_to_the_results(
    runs: Path, tmp_path: Path, capsys: Capture, request: pytest.FixtureRequest
) -> None:
    command = ["classify", str(runs), "-o", str(tmp_path), "--trials", "1", "--components", "3", "--protocol"]
    command += ["as-published", "--train-on", "bambu-p1p_pla-minus"]
    assert main(command) == 0
    output = capsys.readouterr().out
    assert "63.98" in output and "includes the training images" in output and "only force level 1 of" in output
    request.getfixturevalue("no_figures")
    assert main([*command, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    paper = {row["hold_out"]: row["paper"] for row in document["beside_paper"]}
    assert paper == {"train": 100.0, "test": 99.7, "all copies": 63.98, "other copies": None}
    assert document["settings"]["augmentation"] == {"noise": 5.0, "brightness": []}
    assert (tmp_path / "published_table.png").is_file()


OWN = """
import os, time
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.decomposition import PCA
from sklearn.pipeline import make_pipeline

pipeline = make_pipeline(PCA(3), LinearDiscriminantAnalysis())

def build():
    return make_pipeline(PCA(3), LinearDiscriminantAnalysis())

class Slow(LinearDiscriminantAnalysis):
    def fit(self, X, y):
        time.sleep(float(os.environ.get("SLOW_S", "0")))
        return super().fit(X, y)

class Broken(ClassifierMixin, BaseEstimator):
    def fit(self, X, y):
        raise RuntimeError("out of luck")
    def predict(self, X):
        return [0] * len(X)

class Shaped(LinearDiscriminantAnalysis):
    def __init__(self, frame_shape=None, random_state=None):
        super().__init__()
        self.frame_shape, self.random_state = frame_shape, random_state
    def fit(self, X, y):
        with open("shapes.txt", "a") as file:
            print(self.frame_shape, X.shape[1], self.random_state is not None, file=file)
        return super().fit(X, y)

shaped = make_pipeline(PCA(3), Shaped())

class Numbers(Broken):
    def fit(self, X, y):
        return self

class NoEstimator:
    pass
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "own_model.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_model", raising=False)
    return tmp_path


@pytest.mark.usefixtures("no_figures")
def test_a_users_estimator_gets_the_frames(runs: Path, own: Path) -> None:
    command = ["classify", str(runs), "--jobs", "1", "--trials", "1", "--resolution", "1", "--hold-out", "copy"]
    assert main([*command, "-o", "a", "--estimator", "own_model:pipeline"]) == 0
    assert main([*command, "-o", "b", "--estimator", "own_model:build"]) == 0
    first, second = (pd.read_csv(Path(name) / "classification.csv")["accuracy"] for name in "ab")
    assert first[0] == second[0] > 0.5
    assert main([*command, "-o", "a", "--estimator", "own_model:Slow", "--components", "3"]) == 0


@pytest.mark.parametrize(
    ("words", "shape"),
    [
        (["--estimator", "own_model:Shaped"], "(12, 16) 192"),
        (["--estimator", "own_model:shaped"], "(12, 16) 3"),
        (["--estimator", "own_model:Shaped", "--roi", "rect:0,0,16,24"], "(108,) 108"),
        (["--estimator", "own_model:Shaped", "--components", "3"], "None 3"),
    ],
)
def test_a_users_estimator_gets_the_frame_shape(runs: Path, own: Path, words: list[str], shape: str) -> None:
    command = ["classify", str(runs), "--jobs", "1", "--trials", "1", "--resolution", "0.5", "--hold-out", "copy"]
    assert main([*command, *words]) == 0
    assert set((own / "shapes.txt").read_text().splitlines()) == {f"{shape} True"}


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--estimator", "own_model:Broken"], "RuntimeError: out of luck in trial 1, hold-out level press"),
        (["--estimator", "own_model:Numbers"], "must be one of the textures"),
        (["--estimator", "own_model:NoEstimator"], "must be a scikit-learn estimator"),
        (["--estimator", "own_model:Absent"], "estimator = 'own_model:Absent'"),
        (["--estimator", "forrest"], 'did you mean "forest"'),
        (["--protocol", "fair"], "protocol = 'fair'"),
        (["--components", "9999"], "components = 9999: must be from 1 to"),
        (["--components", "few"], "must be a whole number"),
        (["--resolution", "2"], "resolution = 2.0"),
        (["--trials", "0"], "trials = 0"),
        (["--jobs", "0"], "jobs = 0"),
        (["--hold-out", "finger"], "hold-out = 'finger'"),
        (["--hold-out", "copy", "--protocol", "paper"], "is only for --protocol leak-free"),
        (["--train-on", "x"], "is only for --protocol paper"),
        (["--force-level", "3"], "force-level = 3: must be a level of the runs: 1, 2"),
        (["--noise", "-1"], "noise = -1.0"),
        (["--brightness", "0"], "brightness"),
        (["--protocol", "as-published", "--roi", "none"], "leave out --series, --features and --roi"),
        (["--clip"], "clip"),
        (["--sweep", "speed=1:2"], "sweep = 'speed'"),
        (["--dask", "tcp://127.0.0.1:9"], "dask"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    runs: Path, own: Path, capsys: Capture, words: list[str], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tacbench_cad.lab.parallel.ANSWER_S", 0.5)
    base = {"--jobs": "1", "--trials": "1", "--resolution": "0.5"}
    remaining = {key: value for key, value in base.items() if key not in words}
    command = ["classify", str(runs), "-o", "out", *[word for pair in remaining.items() for word in pair], *words]
    assert main(command) == 2
    output = capsys.readouterr().err.strip().splitlines()
    assert len([line for line in output if line.startswith("error:")]) == 1 and named in output[-1]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGINT for one process")
@pytest.mark.usefixtures("no_figures")
def test_an_interruption_ends_with_130_and_the_same_command_resumes(runs: Path, own: Path) -> None:
    words = ["classify", str(runs), "-o", "out", "--estimator", "own_model:Slow", "--hold-out", "copy"]
    words += ["--trials", "3", "--jobs", "1", "--resolution", "0.1"]
    command = [sys.executable, "-c", "import sys; from tacbench_cad.cli import main; sys.exit(main())", *words]
    trials = own / "out" / "trials"
    process = subprocess.Popen(command, cwd=own, env={**os.environ, "SLOW_S": "0.8"}, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not list(trials.glob("leak-free-*.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, output = process.communicate(timeout=30)
    assert process.returncode == 130 and "interrupted" in output and "Traceback" not in output
    kept = {path: path.stat().st_mtime_ns for path in trials.glob("leak-free-*.json")}
    assert 1 <= len(kept) < 3 and {path.suffix for path in trials.iterdir()} == {".json"}
    assert not (own / "out" / "classification.csv").exists()
    assert main(words) == 0
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in kept.items())
    assert len(list(trials.iterdir())) == 3 and (own / "out" / "classification.csv").exists()


@pytest.mark.usefixtures("no_figures")
def test_a_sweep_writes_its_table_and_curve(runs: Path, tmp_path: Path, capsys: Capture) -> None:
    command = ["classify", str(runs), "-o", str(tmp_path), *QUICK, "--hold-out", "copy", "--sweep", "components=2:6:3"]
    assert main(command) == 0
    assert "components" in capsys.readouterr().out
    assert pd.read_csv(tmp_path / "sweep.csv")["value"].tolist() == [2, 4, 6]
    assert (tmp_path / "sweep_components.png").is_file() and (tmp_path / "sweep_components.pdf").is_file()
