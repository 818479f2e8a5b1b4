"""Compare the paper's protocols with the script from its text and with its notebooks, and show what inflates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from helpers.studies import noise_image
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import train_test_split
from sklearn.neural_network import MLPClassifier

from tacbench_cad import lab
from tacbench_cad.lab.analysis.classification.classification import Classification
from tacbench_cad.lab.analysis.classification.settings import default_settings, trial_seed
from tacbench_cad.lab.analysis.classification.training_rows import PAPER_COPIES, Augmentation
from tacbench_cad.lab.analysis.pixels import as_published
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Strings

pytestmark = pytest.mark.usefixtures("single_thread")

PAPER = lab.ClassificationSettings(protocol="paper", augmentation=PAPER_COPIES, components=6, epochs=20)
BAMBU = "bambu-p1p_pla-minus"


@pytest.fixture(scope="module")
def study(make_study: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return make_study(textures=(1, 2, 3), still=1)


def run(presses: pd.DataFrame, settings: lab.ClassificationSettings, trials: int = 1, **more: Any) -> Classification:
    quarter = as_published(0.25, edges=True) if settings.protocol == "as-published" else lab.Pixels()
    return lab.classify(presses, quarter, settings, trials=trials, **more)


def accuracy(result: Classification) -> dict[str, Any]:
    return {row.hold_out: row for row in result.whole.itertuples()}


def inside(presses: pd.DataFrame) -> pd.DataFrame:
    return presses[presses["printer"] == "bambu-p1p"]


def test_without_noise_results_equal_the_script_from_the_text(study: pd.DataFrame) -> None:
    result = run(study, replace(PAPER, augmentation=replace(PAPER_COPIES, noise=None), seed=3))
    rows, seed = lab.Pixels().fit(study).transform(study).astype(float), trial_seed(3, 1)
    chosen = (study["printer"] == "bambu-p1p").to_numpy()
    copies = np.concatenate([rows[chosen] + level for level in (0, 10, -10)])
    labels = np.tile(study["texture"][chosen], 3)
    pca = PCA(6, svd_solver="full").fit(copies)
    train, test = train_test_split(np.arange(len(labels)), test_size=0.2, random_state=seed)
    forest = RandomForestClassifier(max_depth=50, random_state=seed).fit(pca.transform(copies[train]), labels[train])
    for hold_out, images in (("train", copies[train]), ("test", copies[test]), ("unseen", rows[~chosen])):
        found = result.predictions[result.predictions["hold_out"] == hold_out]
        assert found["predicted"].tolist() == forest.predict(pca.transform(images)).tolist()
        assert set(found["augmentation"]) == ({"none"} if hold_out == "unseen" else {"none", "+10", "-10"})
    assert set(result.table["train_on"]) == {BAMBU} and result.beside_paper.empty


def test_the_test_column_is_far_above_chance_on_noise_images(make_study: Callable[..., pd.DataFrame]) -> None:
    presses = make_study(textures=(1, 2, 3), copies=3, still=1, image=noise_image)
    result = run(presses, replace(PAPER, components=25), 2)
    test, unseen = (accuracy(result)[column] for column in ("test", "unseen"))
    assert test.accuracy > 0.9 and test.low > 2 / 3 and unseen.low <= 1 / 3 <= unseen.high
    assert any("inflated" in note for note in result.notes)


def published(estimator: str = "forest", **changes: Any) -> dict[str, Any]:
    return {"protocol": "as-published", "estimators": (estimator,), "components": 6, **changes}


def plain_cell(study: pd.DataFrame, components: int) -> tuple[Floats, Floats, Strings]:
    """Prepare the data as the notebooks do, but without noise.

    These are the scores of the training rows and of all copies, and the labels of the training rows. The sign of each
    component is such that the training row with the largest absolute score has a positive score.
    """
    images = []
    for frame in lab.iter_frames(inside(study)):
        image = frame.astype(np.float64)
        size = int(0.25 * image.shape[1]), int(0.25 * image.shape[0])
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        across, down = (cv2.Sobel(small, cv2.CV_64F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
        images.append(cv2.convertScaleAbs(np.hypot(across, down)).ravel())
    rows, first = np.array(images), (inside(study)["copy"] == 1).to_numpy()
    pca = PCA(components, svd_solver="full").fit(rows[first].astype(np.float64))
    scores, others = pca.transform(rows[first]), pca.transform(rows)
    signs = np.sign(scores[np.abs(scores).argmax(axis=0), np.arange(components)])
    return signs * scores, signs * others, inside(study)["texture"].to_numpy()[first]


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning", "ignore:Got `batch_size`")
@pytest.mark.parametrize("estimator", ["forest", "network"])
def test_as_published_without_noise_equals_the_notebooks_cell(study: pd.DataFrame, estimator: str) -> None:
    how = published(estimator, seed=3, epochs=30, batch_size=64)
    result = run(study, lab.ClassificationSettings(**how))
    seed, (rows, copies, labels) = trial_seed(3, 1), plain_cell(study, 6)
    if estimator == "forest":
        train, test = train_test_split(np.arange(len(rows)), random_state=seed)
        model = RandomForestClassifier(max_depth=50, random_state=seed).fit(rows[train], labels[train])
        expected = {"train": rows[train], "test": rows[test]}
    else:
        rows, copies = ((part - part.min()) / (part.max() - part.min()) for part in (rows, copies))
        model = MLPClassifier((50, 50), alpha=0.0, batch_size=64, max_iter=30, n_iter_no_change=30, random_state=seed)
        model.set_params(tol=0.0).fit(rows, labels)
        expected = {"train": rows}
    expected |= {"all copies": copies, "other copies": copies[(inside(study)["copy"] != 1).to_numpy()]}
    assert list(result.predictions["hold_out"].unique()) == list(expected)
    for column, values in expected.items():
        found = result.predictions[result.predictions["hold_out"] == column]
        assert found["predicted"].tolist() == model.predict(values).tolist()
    paper = {"train": 100.0, "test": 99.7, "all copies": 63.98} if estimator == "forest" else {"all copies": 53.73}
    beside = result.beside_paper.set_index("hold_out")
    assert {column: beside["paper"][column] for column in paper} == paper and np.isnan(beside["paper"]["other copies"])
    assert beside["ours"]["train"] == 100.0 * accuracy(result)["train"].accuracy


def test_as_published_warns_of_leaks_and_differences_from_the_notebooks(study: pd.DataFrame) -> None:
    result = run(study, lab.ClassificationSettings(**published()))
    notes = " ".join(result.notes)
    assert '"all copies", printed in the paper as unseen prints, includes the training images' in notes
    assert "trained on 8 images of each texture (1 force level); the notebooks had 50 of each" in notes
    assert "other copies: without copy 1" in next(result.shown())[1].title


def test_testing_on_the_training_copy_raises_the_accuracy_on_noise_images(
    make_study: Callable[..., pd.DataFrame],
) -> None:
    presses = make_study(textures=(1, 2, 3), copies=2, still=1, image=noise_image)
    noisy = published(components=25, augmentation=Augmentation(noise=5.0))
    by_column = accuracy(run(presses, lab.ClassificationSettings(**noisy), 2))
    assert by_column["all copies"].accuracy > 0.5 and abs(by_column["other copies"].accuracy - 1 / 3) < 0.2


def test_the_notebooks_settings_are_those_of_the_estimator(study: pd.DataFrame) -> None:
    design = Design.of(study)
    forest, network = (default_settings(design, as_published(), "as-published", (n,)) for n in ("forest", "network"))
    assert (forest.components, forest.augmentation.names, forest.depth) == (25, ("none", "noise 5"), 50)
    assert (network.components, network.epochs, network.batch_size) == (45, 15_000, 64)
    with pytest.raises(InputError, match="must be a single name, because the saved cells"):
        replace(forest, estimators=("forest", "network"))
    with pytest.raises(InputError, match="clip"):
        replace(forest, clip=True)


def test_clipped_copies_give_other_results(study: pd.DataFrame, tmp_path: Path) -> None:
    for count, clip in ((1, True), (2, False)):
        result = run(study, replace(PAPER, clip=clip), folder=tmp_path)
        assert result.whole["hold_out"].tolist() == ["train", "test", "unseen"]
        assert len(list((tmp_path / "trials").iterdir())) == count


def test_data_that_a_protocol_cannot_use_are_refused(
    study: pd.DataFrame, make_study: Callable[..., pd.DataFrame]
) -> None:
    with pytest.raises(InputError, match="must be one for the protocol as-published"):
        run(make_study(levels=(1, 2), still=0), lab.ClassificationSettings(**published()))
    with pytest.raises(InputError, match="train-on = 'form-3_grey-v4': must be a combination of the runs"):
        run(study, replace(PAPER, train_on=("form-3_grey-v4",)))
    few = study[(study["printer"] == "ender-3") | (study["texture"] == "texture-1")]
    with pytest.raises(InputError, match="has only texture-1"):
        run(few, replace(PAPER, train_on=(BAMBU,)))


def test_one_combination_has_no_unseen_column(study: pd.DataFrame) -> None:
    assert run(inside(study), PAPER).whole["hold_out"].tolist() == ["train", "test"]
    first = inside(study)[inside(study)["copy"] == 1]
    assert "other copies" not in set(run(first, lab.ClassificationSettings(**published())).table["hold_out"])
