"""Compare the paper's protocols with the script from its text and with its notebooks, and show what inflates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from helpers.studies import noise_image, write_study
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import train_test_split
from sklearn.neural_network import MLPClassifier

from tacbench_cad.lab.analysis.classification.augment import PAPER_COPIES, Augmentation, trial_seed
from tacbench_cad.lab.analysis.classification.classify import classify
from tacbench_cad.lab.analysis.classification.features import read_features
from tacbench_cad.lab.analysis.classification.result import Result, beside_paper
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings, usual
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Strings

pytestmark = pytest.mark.usefixtures("single_thread")

PAPER = ClassificationSettings(protocol="paper", augmentation=PAPER_COPIES, resolution=1.0, components=6, epochs=20)


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(textures=(1, 2, 3), still=1)


def run(collection: Collection, out: Path, settings: ClassificationSettings, trials: int = 1) -> Result:
    with workers() as executor:
        return classify(collection, settings, trials, out, executor)


def test_without_noise_results_equal_the_script_from_the_text(study: Collection, tmp_path: Path) -> None:
    settings = replace(PAPER, estimators=("forest",), augmentation=replace(PAPER_COPIES, noise=None), seed=3)
    result = run(study, tmp_path, settings)
    rows = read_features(study, Pixels()).rows.astype(float)
    seed = trial_seed(3, 1)
    for train_on in ("bambu-p1p_pla-minus",):
        chosen = study.combination == train_on
        copies = np.concatenate([rows[chosen] + level for level in (0, 10, -10)])
        labels = np.tile(study.texture[chosen], 3)
        pca = PCA(6, svd_solver="full").fit(copies)
        train, test = train_test_split(np.arange(len(labels)), test_size=0.2, random_state=seed)
        forest = RandomForestClassifier(max_depth=50, random_state=seed)
        forest.fit(pca.transform(copies[train]), labels[train])
        for hold_out, images in (("train", copies[train]), ("test", copies[test]), ("unseen", rows[~chosen])):
            found = result.outcomes
            outcome = found[(found["hold_out"] == hold_out) & (found["train_on"] == train_on)]
            predicted = forest.predict(pca.transform(images))
            assert np.array_equal(outcome["predicted"], predicted)
    assert result.settings.train_on == ("bambu-p1p_pla-minus",)


def test_the_test_column_is_far_above_chance_on_noise_images(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", textures=(1, 2, 3), copies=3, still=1, image=noise_image)
    result = run(
        Collection.open([tmp_path / "runs"]), tmp_path, replace(PAPER, estimators=("forest",), components=25), 2
    )
    by_rung = {score.hold_out: score for score in result.scores}
    test, unseen = by_rung["test"], by_rung["unseen"]
    assert test.accuracy > 0.9 and test.low is not None and test.low > 2 * result.chance
    assert unseen.low is not None and unseen.high is not None and unseen.low <= result.chance <= unseen.high
    assert any("inflated" in note for note in result.notes)


def test_the_printed_accuracies_are_not_shown_for_the_texts_protocol(study: Collection, tmp_path: Path) -> None:
    settings = replace(PAPER, estimators=("forest", "network"), train_on=study.combinations)
    result = run(study, tmp_path, settings)
    assert beside_paper(result) == []
    assert sum("the text says 300" in note for note in result.notes) == 2


def published(estimator: str = "forest", **changes: Any) -> ClassificationSettings:
    return ClassificationSettings(**{**usual("as-published", (estimator,)), **changes})


def plain_cell(study: Collection, train_on: str, components: int) -> tuple[Floats, Floats, Strings, Bools]:
    """Prepare the data as the notebooks do, but without noise.

    These are the scores of the training rows and of all copies, the labels, and which of the copies are new.

    The sign of each component is such that the training row with the largest absolute score has a positive score.
    """
    images = []
    for i in range(len(study)):
        image = study.frame(i).astype(np.float64)
        small = cv2.resize(
            image, (int(0.25 * image.shape[1]), int(0.25 * image.shape[0])), interpolation=cv2.INTER_AREA
        )
        across, down = (cv2.Sobel(small, cv2.CV_64F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
        images.append(cv2.convertScaleAbs(np.hypot(across, down)).ravel())
    rows, mine = np.array(images), study.combination == train_on
    trained = rows[mine & (study.copy == 1)].astype(np.float64)
    pca = PCA(components, svd_solver="full").fit(trained)
    scores, others = pca.transform(trained), pca.transform(rows[mine])
    signs = np.sign(scores[np.abs(scores).argmax(axis=0), np.arange(components)])
    labels = study.texture[mine & (study.copy == 1)]
    return signs * scores, signs * others, labels, study.copy[mine] != 1


@pytest.mark.parametrize("estimator", ["forest", "network"])
def test_as_published_without_noise_equals_the_notebooks_cell(
    study: Collection, tmp_path: Path, estimator: str
) -> None:
    train_on = "bambu-p1p_pla-minus"
    settings = published(
        estimator,
        resolution=0.25,
        components=6,
        seed=3,
        augmentation=Augmentation(),
        **{"epochs": 30} if estimator == "network" else {},
    )
    result = run(study, tmp_path, settings)
    seed = trial_seed(3, 1)
    rows, copies, labels, others = plain_cell(study, train_on, 6)
    texture = study.texture[study.combination == train_on]
    if estimator == "forest":
        train, test = train_test_split(np.arange(len(rows)), random_state=seed)
        model = RandomForestClassifier(max_depth=50, random_state=seed).fit(rows[train], labels[train])
        expected = {"train": (rows[train], labels[train]), "test": (rows[test], labels[test])}
    else:
        rows, copies = ((part - part.min()) / (part.max() - part.min()) for part in (rows, copies))
        model = MLPClassifier((50, 50), alpha=0.0, batch_size=64, max_iter=30, n_iter_no_change=30, random_state=seed)
        with pytest.warns(match="batch_size|Maximum iterations"):
            model.set_params(tol=0.0).fit(rows, labels)
        expected = {"train": (rows, labels)}
    expected |= {"all copies": (copies, texture), "other copies": (copies[others], texture[others])}
    assert list(dict.fromkeys(result.outcomes["hold_out"])) == list(expected)
    for column, (values, truth) in expected.items():
        outcome = result.outcomes[result.outcomes["hold_out"] == column]
        predicted = outcome["predicted"]
        assert np.array_equal(predicted, model.predict(values))
        assert np.array_equal(study.texture[outcome["press"]], truth)
    (beside,) = beside_paper(result)
    accuracies = {score.hold_out: 100.0 * score.accuracy for score in result.scores}
    columns = ("train", "test", "all copies", "other copies")
    assert beside.ours == tuple(accuracies.get(column) for column in columns)
    assert beside.paper == (100.0, *((99.7, 63.98) if estimator == "forest" else (99.8, 53.73)), None)


def test_as_published_warns_of_leaks_and_differences_from_the_notebooks(study: Collection, tmp_path: Path) -> None:
    result = run(study, tmp_path, published(resolution=0.25, components=6))
    notes = " ".join(result.notes)
    assert '"all copies", printed in the paper as unseen prints, includes the training images' in notes
    assert "trained on 8 images of each texture (1 force level); the notebooks had 50 of each" in notes
    titles = [table.title for table in result.shown]
    assert "other copies: without copy 1" in titles[0]


def test_testing_on_the_training_copy_raises_the_accuracy_on_noise_images(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", textures=(1, 2, 3), copies=2, still=1, image=noise_image)
    result = run(Collection.open([tmp_path / "runs"]), tmp_path, published(components=25), 2)
    by_column = {score.hold_out: score for score in result.scores}
    assert by_column["all copies"].accuracy > 0.5
    assert abs(by_column["other copies"].accuracy - result.chance) < 0.2


def test_the_notebooks_settings_are_those_of_the_estimator() -> None:
    forest, network = published(), published("network")
    assert (forest.components, forest.augmentation.names, forest.depth) == (25, ("none", "noise 5"), 50)
    assert (network.components, network.epochs, network.batch_size) == (45, 15_000, 64)
    with pytest.raises(InputError, match="must be a single name, because the saved cells"):
        replace(forest, estimators=("forest", "network"))
    with pytest.raises(InputError, match="clip"):
        replace(forest, clip=True)


def test_as_published_refuses_several_forces(make_study: Callable[..., Collection], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be one for the protocol as-published"):
        run(make_study(levels=(1, 2), still=0), tmp_path, published(resolution=0.25, components=6))


def test_clipped_copies_give_other_results(study: Collection, tmp_path: Path) -> None:
    names = ("train", "test", "unseen")
    settings = replace(PAPER, estimators=("forest",))
    clipped = run(study, tmp_path, replace(settings, clip=True))
    assert [score.hold_out for score in clipped.scores] == list(names)
    assert len(list((tmp_path / "trials").iterdir())) == 1
    run(study, tmp_path, settings)
    assert len(list((tmp_path / "trials").iterdir())) == 2


def test_an_unknown_combination_or_one_with_a_single_texture_is_refused(study: Collection, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="train-on = 'form-3_grey-v4': must be a combination of the runs"):
        run(study, tmp_path, replace(PAPER, train_on=("form-3_grey-v4",)))
    few = study.chosen((study.combination == "ender-3_pla-plus") | (study.texture == "texture-1"))
    with pytest.raises(InputError, match="has only texture-1"):
        run(few, tmp_path, replace(PAPER, train_on=("bambu-p1p_pla-minus",)))


def test_one_combination_has_no_unseen_column(study: Collection, tmp_path: Path) -> None:
    subset = study.chosen(study.combination == "bambu-p1p_pla-minus")
    result = run(subset, tmp_path, replace(PAPER, estimators=("forest",)))
    assert [score.hold_out for score in result.scores] == ["train", "test"]
    published_result = run(subset.chosen(subset.copy == 1), tmp_path, published(resolution=0.25, components=6))
    assert beside_paper(published_result)[0].ours[3] is None
