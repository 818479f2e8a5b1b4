"""The paper's protocol beside the script from its text, and the inflation of its test column."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.studies import noise_image, write_study
from sklearn.decomposition import PCA
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import train_test_split

from tacbench_cad.lab.analysis.classification.augment import Augmentation, trial_seed
from tacbench_cad.lab.analysis.classification.classify import classify
from tacbench_cad.lab.analysis.classification.features import read_features
from tacbench_cad.lab.analysis.classification.result import Result, beside_paper
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.preprocess import Preprocess
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.usefixtures("single_thread")

PAPER = ClassificationSettings(protocol="paper", resolution=1.0, components=6, epochs=20)


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(textures=(1, 2, 3), still=1)


def run(found: Collection, out: Path, settings: ClassificationSettings, trials: int = 1) -> Result:
    with workers() as executor:
        return classify(found, settings, trials, out, executor)


def test_without_noise_it_is_the_script_from_the_text(study: Collection, tmp_path: Path) -> None:
    settings = replace(PAPER, estimators=("forest",), augmentation=Augmentation(noise=None), seed=3)
    result = run(study, tmp_path, settings)
    rows = read_features(study, Preprocess()).rows.astype(float)
    seed = trial_seed(3, 1)
    outcomes = iter(result.outcomes)
    for train_on in ("bambu-p1p_pla-minus",):
        chosen = study.combination == train_on
        copies = np.concatenate([rows[chosen] + level for level in (0, 10, -10)])
        labels = np.tile(study.texture[chosen], 3)
        pca = PCA(6, svd_solver="full").fit(copies)
        train, test = train_test_split(np.arange(len(labels)), test_size=0.2, random_state=seed)
        forest = RandomForestClassifier(max_depth=50, random_state=seed)
        forest.fit(pca.transform(copies[train]), labels[train])
        for rung, images in (("train", copies[train]), ("test", copies[test]), ("unseen", rows[~chosen])):
            outcome = next(outcomes)
            assert (outcome.hold_out, outcome.train_on) == (rung, train_on)
            said = forest.predict(pca.transform(images))
            assert np.array_equal(np.array(study.textures)[outcome.predicted], said)
    assert result.settings.train_on == ("bambu-p1p_pla-minus",)


def test_the_test_column_is_far_above_chance_on_labels_of_noise(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", textures=(1, 2, 3), copies=3, still=1, image=noise_image)
    result = run(
        Collection.open([tmp_path / "runs"]), tmp_path, replace(PAPER, estimators=("forest",), components=25), 2
    )
    by_rung = {one.hold_out: one for one in result.scores}
    test, unseen = by_rung["test"], by_rung["unseen"]
    assert test.accuracy > 0.9 and test.low is not None and test.low > 2 * result.chance
    assert unseen.low is not None and unseen.high is not None and unseen.low <= result.chance <= unseen.high
    assert any("inflated" in note for note in result.notes)


def test_the_papers_figures_stand_beside_ours_and_counts_that_differ_are_named(
    study: Collection, tmp_path: Path
) -> None:
    settings = replace(PAPER, estimators=("forest", "network"), train_on=study.combinations)
    result = run(study, tmp_path, settings)
    rows = {(one.train_on, one.estimator): one for one in beside_paper(result)}
    assert rows["bambu-p1p_pla-minus", "forest"].paper == (100.0, 99.7, 63.98)
    assert rows["ender-3_pla-plus", "network"].paper == (None, None, None)
    for one in rows.values():
        mine = {
            score.hold_out: score
            for score in result.scores
            if (score.train_on, score.estimator) == (one.train_on, one.estimator)
        }
        assert one.ours == tuple(pytest.approx(100 * mine[rung].accuracy) for rung in ("train", "test", "unseen"))
    assert sum("the text says 300" in note for note in result.notes) == 2


def test_clipped_copies_are_another_computation(study: Collection, tmp_path: Path) -> None:
    names = ("train", "test", "unseen")
    settings = replace(PAPER, estimators=("forest",))
    clipped = run(study, tmp_path, replace(settings, clip=True))
    assert [one.hold_out for one in clipped.scores] == list(names)
    assert len(list((tmp_path / "trials").iterdir())) == 1
    run(study, tmp_path, settings)
    assert len(list((tmp_path / "trials").iterdir())) == 2


def test_a_combination_that_is_not_there_or_has_one_texture_is_refused(study: Collection, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="train-on = 'form-3_grey-v4': the runs have"):
        run(study, tmp_path, replace(PAPER, train_on=("form-3_grey-v4",)))
    few = study.chosen((study.combination == "ender-3_pla-plus") | (study.texture == "texture-1"))
    with pytest.raises(InputError, match="has only texture-1"):
        run(few, tmp_path, replace(PAPER, train_on=("bambu-p1p_pla-minus",)))


def test_one_combination_has_no_unseen_column(study: Collection, tmp_path: Path) -> None:
    one = study.chosen(study.combination == "bambu-p1p_pla-minus")
    result = run(one, tmp_path, replace(PAPER, estimators=("forest",)))
    assert [score.hold_out for score in result.scores] == ["train", "test"]
    assert beside_paper(result)[0].ours[2] is None
