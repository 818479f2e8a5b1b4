"""Test classifications against plain scikit-learn, on noise, on series and on faulty data; and stored trials."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.studies import SHAPE, noise_image, write_study
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import cross_val_score
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from tacbench_cad import lab
from tacbench_cad.lab.analysis.classification import classify as module
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.classification.settings import default_settings, trial_seed
from tacbench_cad.lab.analysis.classification.training_rows import Augmentation
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.errors import CheckFailedError, InputError

pytestmark = pytest.mark.usefixtures("single_thread", "few_trees")

HALF = lab.Pixels(resolution=0.5)
LEVELS = ["press", "position", "force", "copy", "printer-filament"]


def settings(**changes: Any) -> lab.ClassificationSettings:
    return lab.ClassificationSettings(**{"components": 5, "hold_out": ("copy",), **changes})


@pytest.fixture(scope="module")
def study(make_study: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return make_study(textures=(1, 2, 3), levels=(1, 2), still=1)


class SignedPCA(PCA):  # type: ignore[misc]
    """scikit-learn's PCA with the sign of each component such that the largest training score is positive."""

    def fit_transform(self, rows: np.ndarray, labels: object = None) -> np.ndarray:
        scores = self.fit(rows.astype(float)).transform(rows)
        signs = np.sign(scores[np.argmax(np.abs(scores), axis=0), np.arange(scores.shape[1])])
        self.components_ *= signs[:, None]
        return np.asarray(scores * signs)


@pytest.mark.parametrize("level", LEVELS)
def test_accuracies_are_those_of_a_plain_pipeline_on_the_same_folds(study: pd.DataFrame, level: str) -> None:
    result = lab.classify(study, HALF, settings(hold_out=(level,), components=12, seed=4))
    forest = RandomForestClassifier(max_depth=50, random_state=trial_seed(4, 1))
    pipeline = make_pipeline(HALF, SignedPCA(12, svd_solver="full"), StandardScaler(), forest)
    cv = lab.HoldOut(level, seed=trial_seed(4, 1))
    scores = cross_val_score(pipeline, study, study["texture"], cv=cv)
    right = result.predictions["texture"] == result.predictions["predicted"]
    tests = [len(test) for _, test in cv.split(study)]
    assert scores == pytest.approx([of.mean() for of in np.split(right.to_numpy(), np.cumsum(tests)[:-1])])
    assert result.whole["accuracy"].tolist() == pytest.approx([np.average(scores, weights=tests)])


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning", "ignore:Got `batch_size`")
def test_copies_and_both_estimators_equal_plain_scikit_learn(study: pd.DataFrame) -> None:
    how = settings(estimators=("forest", "network"), augmentation=Augmentation(brightness=(10.0, -10.0)), epochs=15)
    predictions = lab.classify(study, HALF, how).predictions
    rows, texture, seed = HALF.fit(study).transform(study).astype(float), study["texture"].to_numpy(), trial_seed(0, 1)
    network = MLPClassifier((50,), max_iter=15, n_iter_no_change=15, tol=0, random_state=seed)
    for name, model in (("forest", RandomForestClassifier(max_depth=50, random_state=seed)), ("network", network)):
        expected = []
        for train, test in lab.HoldOut("copy").split(study):
            pipeline = make_pipeline(SignedPCA(5, svd_solver="full"), StandardScaler(), model)
            copies = np.concatenate([rows[train], rows[train] + 10, rows[train] - 10])
            expected += pipeline.fit(copies, np.tile(texture[train], 3)).predict(rows[test]).tolist()
        assert predictions["predicted"][predictions["estimator"] == name].tolist() == expected


def test_noise_images_are_predicted_at_chance_at_every_level(make_study: Callable[..., pd.DataFrame]) -> None:
    presses = make_study(textures=(1, 2, 3), levels=(1, 2), still=1, image=noise_image)
    result = lab.classify(presses, lab.Pixels(), settings(hold_out=(), components=10), trials=2)
    assert result.whole["hold_out"].tolist() == LEVELS
    for row in result.whole.itertuples():
        assert abs(row.accuracy - 1 / 3) < 0.12
        few = row.hold_out in ("force", "printer-filament")  # there are two of each
        assert np.isnan(row.low) if few else row.low <= 1 / 3 <= row.high, row


def test_a_saved_classification_is_opened_with_the_same_tables(study: pd.DataFrame, tmp_path: Path) -> None:
    result = lab.classify(study, HALF, settings(hold_out=("force", "copy")), trials=2)
    result.save(tmp_path)
    again = Classification.open(tmp_path, Design.of(study))
    assert again.record == result.record and list(again.tables) == list(result.tables)
    for name, table in result.tables.items():
        pd.testing.assert_frame_equal(again.tables[name], table, check_dtype=False)
    assert again.document() == result.document()
    for folder in (tmp_path / "other", tmp_path):
        with pytest.raises(InputError, match="settings" if folder.name == "other" else "of all presses of these runs"):
            Classification.open(folder, Design.of(study[study["copy"] == 1]))
    (tmp_path / "predictions.csv").write_text("run,press\na,1\n")
    with pytest.raises(InputError, match=r"predictions\.csv': cannot be read: "):
        Classification.open(tmp_path)


def test_default_settings_follow_the_data(study: pd.DataFrame) -> None:
    few, forces = study[study["copy"] == 1].iloc[:40], lab.Forces()
    assert default_settings(Design.of(study), HALF) == lab.ClassificationSettings()
    assert default_settings(Design.of(few), HALF).components == 10
    assert default_settings(Design.of(few), forces).components is None
    assert default_settings(Design.of(few), HALF, "leak-free", ("own:model",)).components is None
    paper = default_settings(Design.of(study), HALF, "paper", noise=None)
    assert paper.estimators == ("forest", "network") and paper.augmentation == Augmentation(brightness=(10.0, -10.0))


def test_constant_images_are_refused(make_study: Callable[..., pd.DataFrame]) -> None:
    presses = make_study(still=1, image=lambda *_: np.full(SHAPE, 7, np.uint8))
    with pytest.raises(InputError, match="are all equal"):
        lab.classify(presses, lab.Pixels(), settings())


def test_all_damaged_frames_are_counted(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", still=1)
    for number, image in ((3, 5), (3, 6), (5, 2)):
        (folders[number] / "sensor_images" / f"image_{image}.png").write_bytes(b"torn")
    with pytest.raises(CheckFailedError, match=r"sensor_images/image_[25]\.png.*2 more of 64"):
        lab.classify(lab.read(tmp_path / "runs"), lab.Pixels(), settings())


def test_frames_of_other_sensors_are_accepted_and_nan_is_reported(tmp_path: Path) -> None:
    def taxels(printed: Any, press: Any, rng: np.random.Generator) -> np.ndarray:
        return rng.normal(int(printed.object_label) * np.arange(16.0), 1.0).reshape(4, 4)

    def broken(printed: Any, press: Any, rng: np.random.Generator) -> np.ndarray:
        return np.where(press.number == 3, np.nan, taxels(printed, press, rng))

    for name, image in (("good", taxels), ("broken", broken)):
        write_study(tmp_path / name, still=1, image=image, shape=(4, 4), units="kPa")
    presses = lab.read(tmp_path / "good")
    result = lab.classify(presses, None, settings())
    assert result.table["accuracy"].min() > 0.95 and result.record.units == "kPa"
    with pytest.raises(InputError, match="is for images"):
        lab.classify(presses, None, lab.ClassificationSettings(protocol="paper"))
    with pytest.raises(CheckFailedError, match="contains NaN"):
        lab.classify(lab.read(tmp_path / "broken"), None, settings())


def test_more_components_than_a_training_set_has_are_refused(study: pd.DataFrame) -> None:
    with pytest.raises(InputError, match="components = 800: must be from 1 to"):
        lab.classify(study, lab.Pixels(), settings(components=800))


def test_one_print_of_each_texture_allows_two_hold_out_levels(study: pd.DataFrame) -> None:
    one = study[(study["copy"] == 1) & (study["printer"] == "ender-3") & (study["force_level"] == 1)]
    result = lab.classify(one, lab.Pixels(), settings(hold_out=()))
    assert set(result.table["hold_out"]) == {"press", "position"}
    assert sum("is left out" in note for note in result.notes) == 3 and "only force level 1 of 3" in str(result.notes)
    assert "cannot be said: hold-out level copy is left out" in result.answers["answer"][0]


def test_worker_processes_give_the_same_results(study: pd.DataFrame) -> None:
    one, two = (lab.classify(study, HALF, settings(hold_out=("copy", "press")), jobs=jobs).table for jobs in (1, 2))
    pd.testing.assert_frame_equal(one, two)


@pytest.fixture(scope="module")
def slides(make_study: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    """Return series whose stripes move at the speed of the texture, after presses of noise."""

    def moving(printed: Any, press: Any, step: int, rng: np.random.Generator) -> np.ndarray:
        phase = int(printed.object_label) * step + 0.02 * press.position
        image = 120.0 + 30.0 * np.sin(0.8 * np.arange(SHAPE[1]) + phase) + rng.normal(0.0, 2.0, SHAPE)
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)

    def force(printed: Any, press: Any, step: int) -> float:
        return 1.0 + 0.1 * int(printed.object_label) * step + 0.001 * press.number

    presses = make_study(still=1, image=noise_image, moving=moving, moving_force=force)
    return lab.read(presses["folder"].unique(), series=True)


def test_a_press_is_classified_by_all_frames_of_its_series(slides: pd.DataFrame, tmp_path: Path) -> None:
    result = lab.classify(slides, HALF, settings())
    rows = HALF.fit(slides).transform(slides).reshape(len(slides) // 4, -1).astype(float)
    presses = slides[slides["step"] == 1].reset_index(drop=True)
    expected = []
    for train, test in lab.HoldOut("copy").split(presses.drop(columns="step")):
        forest = RandomForestClassifier(max_depth=50, random_state=trial_seed(0, 1))
        pipeline = make_pipeline(SignedPCA(5, svd_solver="full"), StandardScaler(), forest)
        expected += pipeline.fit(rows[train], presses["texture"][train]).predict(rows[test]).tolist()
    assert result.predictions["predicted"].tolist() == expected and result.record.steps == 4
    assert result.table["accuracy"][0] > 0.9
    result.save(tmp_path)
    design = Design.of(lab.read(presses["folder"].unique()))
    assert Classification.open(tmp_path, design).record == result.record
    forces = lab.classify(slides, lab.Forces(), settings(components=None))
    assert forces.table["accuracy"][0] > 0.9 and forces.record.units == "N"


def link(path: Path) -> None:
    path.rename(path.parent.parent / "elsewhere.json")
    path.symlink_to(path.parent.parent / "elsewhere.json")


@pytest.mark.parametrize(
    "damage",
    [
        link,
        lambda path: (path.unlink(), os.mkfifo(path)),
        lambda path: path.write_text(path.read_text().replace("    1,", f"    {'9' * 400},", 1)),
        lambda path: path.write_text("[1, 2]"),
    ],
)
def test_an_unusable_stored_trial_is_computed_again(
    study: pd.DataFrame, tmp_path: Path, damage: Callable[[Path], object]
) -> None:
    how = settings(components=2, depth=3)
    lab.classify(study, HALF, how, folder=tmp_path)
    (trial,) = (tmp_path / "trials").iterdir()
    good = trial.read_bytes()
    stamp = trial.stat().st_mtime_ns
    lab.classify(study, HALF, how, folder=tmp_path)
    assert trial.stat().st_mtime_ns == stamp
    damage(trial)
    lab.classify(study, HALF, how, folder=tmp_path)
    assert trial.is_file() and not trial.is_symlink() and trial.read_bytes() == good


def test_a_stored_trial_belongs_to_data_settings_programs_and_sources(
    study: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights, code = tmp_path / "weights.bin", tmp_path / "heavy_model.py"
    code.write_text(f"from sklearn.dummy import DummyClassifier\nFILES = [{str(weights)!r}]\nModel = DummyClassifier\n")
    monkeypatch.syspath_prepend(tmp_path)
    own = settings(estimators=("heavy_model:Model",))

    def stored(feature: lab.Feature = HALF, how: lab.ClassificationSettings = own) -> int:
        lab.classify(study, feature, how, folder=tmp_path)
        return len(list((tmp_path / "trials").iterdir()))

    with pytest.raises(InputError, match=r"weights\.bin"):
        stored()
    weights.write_bytes(b"first")
    assert stored() == stored() == 1
    weights.write_bytes(b"other")
    assert stored() == 2
    assert stored(lab.Pixels(resolution=0.25)) == 3 and stored(how=replace(own, seed=1)) == 4
    monkeypatch.setattr(module, "ALGORITHM", module.ALGORITHM + 1)
    assert stored() == 5
    monkeypatch.setattr(module, "__version__", "999")
    assert stored() == 6
    code.unlink()
    os.mkfifo(code)
    with pytest.raises(InputError, match="is a pipe, a socket or a device"):
        stored()
    del sys.modules["heavy_model"]  # Hypothesis would read the pipe as the source of a module
