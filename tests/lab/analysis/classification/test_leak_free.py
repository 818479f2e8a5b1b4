"""Test the leak-free protocol against plain scikit-learn, on noise and on faulty data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import noise_image, write_study
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from tacbench_cad.lab.analysis.classification.accuracy import scores
from tacbench_cad.lab.analysis.classification.augment import PAPER_COPIES, Augmentation, trial_seed
from tacbench_cad.lab.analysis.classification.classify import classify
from tacbench_cad.lab.analysis.classification.features import read_features
from tacbench_cad.lab.analysis.classification.leak_free import leak_free_trial, trial_folds
from tacbench_cad.lab.analysis.classification.outcomes import ClassifiedStudy
from tacbench_cad.lab.analysis.classification.principal import Products
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.splits import HOLD_OUT_LEVELS, PressTable
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.parallel import Executor, workers
from tacbench_cad.util.errors import CheckFailedError, InputError

pytestmark = pytest.mark.usefixtures("single_thread", "few_trees")


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(textures=(1, 2, 3), levels=(1, 2), still=1)


class SignedPCA(PCA):  # type: ignore[misc]
    """scikit-learn's PCA with the sign of each component such that the largest training score is positive."""

    def fit_transform(self, rows: np.ndarray, labels: object = None) -> np.ndarray:
        scores = self.fit(rows).transform(rows)
        signs = np.sign(scores[np.argmax(np.abs(scores), axis=0), np.arange(scores.shape[1])])
        self.components_ *= signs[:, None]
        return np.asarray(scores * signs)


def plain_rows(frames: np.ndarray, seed: int) -> np.ndarray:
    """Return an augmented training set in the plainest way: original, with noise, brighter, darker."""
    rows = frames.astype(float)
    noise = 5.0 * np.random.default_rng(seed).standard_normal(rows.shape)
    return np.concatenate([rows, rows + noise, rows + 10, rows - 10])


def test_predictions_are_those_of_plain_scikit_learn(study: Collection) -> None:
    presses = PressTable.of(study)
    copies = replace(PAPER_COPIES, noise=None)
    settings = ClassificationSettings(
        estimators=("forest", "network"), augmentation=copies, resolution=1.0, components=12, epochs=15, seed=4
    )
    features = read_features(study, Pixels(resolution=0.5))
    task = ClassifiedStudy(features=features, presses=presses, settings=settings)
    every = outcomes = leak_free_trial(task, Products.of(features.rows), 1)
    seed = trial_seed(4, 1)
    folds = trial_folds(presses, settings, 1).folds
    assert {fold.hold_out for fold in folds} == set(HOLD_OUT_LEVELS)
    pairs = [(fold, name) for fold in folds for name in ("forest", "network")]
    for fold, name in pairs:
        estimator = (
            RandomForestClassifier(max_depth=50, random_state=seed)
            if name == "forest"
            else MLPClassifier((50,), max_iter=15, n_iter_no_change=15, tol=0, random_state=seed)
        )
        pipeline = make_pipeline(SignedPCA(12, svd_solver="full"), StandardScaler(), estimator)
        with pytest.warns() if name == "network" else _nothing():
            rows = features.rows[fold.train].astype(float)
            pipeline.fit(np.concatenate([rows, rows + 10, rows - 10]), np.tile(presses.texture[fold.train], 3))
        expected = pipeline.predict(features.rows[fold.test].astype(float))
        outcome, outcomes = outcomes.iloc[: len(fold.test)], outcomes.iloc[len(fold.test) :]
        assert set(outcome["hold_out"]) == {fold.hold_out} and set(outcome["estimator"]) == {name}
        assert np.array_equal(outcome["press"], fold.test)
        assert np.array_equal(outcome["predicted"], expected), (fold.hold_out, fold.group, name)
    assert outcomes.empty
    accuracies = [score.accuracy for score in scores(every, presses, "leak-free") if score.tested_on == "all"]
    assert max(accuracies) > 0.9 and min(accuracies) < 1.0


class _nothing:  # noqa: N801
    def __enter__(self) -> None: ...

    def __exit__(self, *_: object) -> None: ...


def test_augmentation_makes_the_named_copies(study: Collection) -> None:
    frames = read_features(study, Pixels()).rows[3:40]
    assert PAPER_COPIES.names == ("none", "noise 5", "+10", "-10")
    rows = PAPER_COPIES.rows(frames, 9)
    assert np.array_equal(rows, plain_rows(frames, 9))
    noise = rows[37:74] - rows[:37]
    assert abs(noise.mean()) < 0.15 and abs(noise.std() - 5) < 0.15


def test_noise_images_are_predicted_at_chance_at_every_level(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", textures=(1, 2, 3), levels=(1, 2), still=1, image=noise_image)
    collection = Collection.open([tmp_path / "runs"])
    with workers() as executor:
        settings = ClassificationSettings(resolution=1.0, components=10, epochs=200)
        result = classify(collection, settings, 2, tmp_path, executor)
    overall = [score for score in result.scores if score.tested_on == "all"]
    assert [score.hold_out for score in overall] == list(HOLD_OUT_LEVELS)
    for score in overall:
        if score.hold_out in ("force", "printer-filament"):  # there are two of each
            assert (score.low, score.high) == (None, None)
            continue
        assert score.low is not None and score.high is not None
        assert score.low <= result.chance <= score.high, (score.estimator, score.hold_out, score.low, score.high)
        assert abs(score.accuracy - result.chance) < 0.12


def run(collection: Collection, out: Path, **changes: object) -> None:
    with workers() as executor:
        classify(
            collection, ClassificationSettings(**{"resolution": 1.0, "components": 5, **changes}), 1, out, executor
        )  # type: ignore[arg-type]


def test_constant_images_are_refused(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", still=1, image=lambda *_: np.full((24, 32), 7, np.uint8))
    with pytest.raises(InputError, match="are all equal"):
        run(Collection.open([tmp_path / "runs"]), tmp_path)


def test_a_damaged_image_is_reported_and_finished_trials_are_kept(tmp_path: Path) -> None:
    folders = write_study(tmp_path / "runs", still=1)
    collection = Collection.open([tmp_path / "runs"])
    run(collection, tmp_path, hold_out=("copy",))
    before = sorted((tmp_path / "trials").iterdir())
    (folders[3] / "sensor_images" / "image_5.png").write_bytes(b"torn")
    (folders[5] / "sensor_images" / "image_2.png").write_bytes(b"torn")
    with workers() as executor, pytest.raises(CheckFailedError, match=r"sensor_images/image_[25]\.png.*1 more of 64"):
        classify(
            collection, ClassificationSettings(resolution=1.0, components=5, hold_out=("copy",)), 2, tmp_path, executor
        )
    assert len(before) == 1 and sorted((tmp_path / "trials").iterdir()) == before
    run(collection, tmp_path, hold_out=("copy",))


def test_frames_of_other_sensors_are_accepted_and_nan_is_reported(tmp_path: Path) -> None:
    def taxels(printed: object, press: object, rng: np.random.Generator) -> np.ndarray:
        number = int(printed.object_label)  # type: ignore[attr-defined]
        return rng.normal(number * np.arange(16.0), 1.0).reshape(4, 4)

    write_study(tmp_path / "runs", still=1, image=taxels, shape=(4, 4), units="kPa")
    collection = Collection.open([tmp_path / "runs"])
    settings = ClassificationSettings(components=5, augmentation=Augmentation(), hold_out=("copy",))
    with workers() as executor:
        result = classify(collection, settings, 1, tmp_path, executor)
        assert result.scores[0].accuracy > 0.95
        with pytest.raises(InputError, match="is for images"):
            classify(collection, ClassificationSettings(protocol="paper"), 1, tmp_path, executor)

    def broken(printed: object, press: object, rng: np.random.Generator) -> np.ndarray:
        values = taxels(printed, press, rng)
        values[0, 0] = np.nan if press.number == 3 else 0.0  # type: ignore[attr-defined]
        return values

    write_study(tmp_path / "nan", still=1, image=broken, shape=(4, 4), units="kPa")
    with workers() as executor, pytest.raises(CheckFailedError, match="contains NaN"):
        classify(Collection.open([tmp_path / "nan"]), settings, 1, tmp_path, executor)


def test_more_components_than_a_training_set_has_are_refused(study: Collection, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="components = 800: must be from 1 to"):
        run(study, tmp_path, components=800)


def test_one_print_of_each_texture_allows_two_hold_out_levels(study: Collection, tmp_path: Path) -> None:
    subset = study.chosen((study.copy == 1) & (study.combination == study.combinations[0]) & (study.level == 1))
    with workers() as executor:
        result = classify(subset, ClassificationSettings(resolution=1.0, components=5), 1, tmp_path, executor)
    assert {score.hold_out for score in result.scores} == {"press", "position"}
    assert sum("is left out" in note for note in result.notes) == 3


def test_worker_processes_give_the_same_results(study: Collection, tmp_path: Path) -> None:
    settings = ClassificationSettings(resolution=0.5, components=5, hold_out=("copy", "press"))

    def accuracies(jobs: int, out: Path) -> list[float]:
        with workers(jobs) as executor:
            assert isinstance(executor, Executor)
            return [score.accuracy for score in classify(study, settings, 2, out, executor).scores]

    assert accuracies(1, tmp_path / "one") == accuracies(2, tmp_path / "two")
