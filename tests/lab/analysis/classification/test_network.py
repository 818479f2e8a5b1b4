"""Compare the batched network with scikit-learn's MLPClassifier."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("sklearn")

from sklearn.base import clone
from sklearn.neural_network import MLPClassifier

from tacbench_cad.lab.analysis.classification import network as module
from tacbench_cad.lab.analysis.classification.network import NetworkClassifier, fit_together
from tacbench_cad.util.types import Floats, Ints

#: The settings of the paper's network.
PAPER: dict[str, Any] = {"hidden_layer_sizes": (50,), "batch_size": 200}

pytestmark = pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning", "ignore:Got `batch_size`")


def clusters(
    rows: int, features: int, classes: int, seed: int = 0, noise: float = 1.0, scale: float = 1.0
) -> tuple[Floats, Ints]:
    """Return rows around a centre for each class; with much noise the classes cannot be distinguished."""
    random = np.random.default_rng(seed)
    labels = random.permutation(np.arange(rows) % classes)
    centres = random.normal(size=(classes, features))
    return scale * (centres[labels] + noise * random.normal(size=(rows, features))), labels


def scikit_network(network: NetworkClassifier) -> MLPClassifier:
    """Return scikit-learn's network with the same settings."""
    return MLPClassifier(**{**network.get_params(), "n_iter_no_change": network.max_iter, "tol": 0})


@pytest.mark.parametrize(
    ("rows", "features", "classes", "noise", "scale", "options"),
    [
        pytest.param(620, 25, 6, 1.0, 1.0, {}, id="as-the-paper-last-batch-short"),
        pytest.param(600, 25, 6, 1.0, 500.0, {}, id="scores-of-images-unscaled"),
        pytest.param(601, 25, 6, 30.0, 1.0, {}, id="noise-last-batch-of-one"),
        pytest.param(150, 4, 3, 1.0, 1.0, {}, id="fewer-rows-than-a-batch"),
        pytest.param(300, 5, 2, 1.0, 1.0, {}, id="two-classes-one-output"),
        pytest.param(300, 5, 3, 1.0, 1.0, {"shuffle": False}, id="unshuffled"),
        pytest.param(300, 5, 3, 1.0, 1.0, {"alpha": 0.0}, id="no-penalty"),
        pytest.param(
            300, 5, 3, 1.0, 1.0, {"alpha": 2.0, "hidden_layer_sizes": (1,), "batch_size": 7}, id="one-unit-much-penalty"
        ),
    ],
)
def test_the_loss_curve_and_weights_are_those_of_scikit_learn(
    rows: int, features: int, classes: int, noise: float, scale: float, options: dict[str, Any]
) -> None:
    values, labels = clusters(rows, features, classes, noise=noise, scale=scale)
    ours = NetworkClassifier(**{**PAPER, "max_iter": 60, "random_state": 7, **options})
    theirs = scikit_network(ours).fit(values, labels)
    ours.fit(values, labels)
    assert len(ours.loss_curve_) == ours.n_iter_ == 60
    np.testing.assert_allclose(ours.loss_curve_, theirs.loss_curve_, rtol=1e-9, atol=1e-9)
    for mine, other in zip(ours.coefs_ + ours.intercepts_, theirs.coefs_ + theirs.intercepts_, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-6, atol=1e-8)
    fresh = clusters(200, features, classes, seed=3, scale=scale)[0]
    np.testing.assert_allclose(ours.predict_proba(fresh), theirs.predict_proba(fresh), atol=1e-8)
    np.testing.assert_array_equal(ours.predict(fresh), theirs.predict(fresh))


@pytest.mark.long
@pytest.mark.parametrize(("noise", "scale"), [(1.0, 1.0), (1.0, 500.0), (30.0, 1.0)])
def test_the_loss_curve_follows_through_all_epochs_of_the_paper(noise: float, scale: float) -> None:
    values, labels = clusters(5760, 25, 6, noise=noise, scale=scale)
    ours = NetworkClassifier(**PAPER, max_iter=1500, random_state=1)
    theirs = scikit_network(ours).fit(values, labels)
    ours.fit(values, labels)
    assert len(ours.loss_curve_) == 1500
    # With values in the hundreds late training is chaotic: scikit-learn's own curve changes if the data change in the
    # last digit. The curves are compared up to the epoch where that happens.
    nudged = scikit_network(ours).fit(np.nextafter(values, np.inf), labels)
    apart = np.flatnonzero(np.abs(np.subtract(nudged.loss_curve_, theirs.loss_curve_)) > 1e-7)
    until = int(apart[0]) if apart.size else 1500
    assert until >= 500 and (until == 1500 or scale > 1.0)
    np.testing.assert_allclose(ours.loss_curve_[:until], theirs.loss_curve_[:until], rtol=0, atol=1e-6)
    if until == 1500:
        np.testing.assert_array_equal(ours.predict(values), theirs.predict(values))


def test_float32_stays_float32_as_in_scikit_learn() -> None:
    values, labels = clusters(400, 10, 6)
    narrow = values.astype(np.float32)
    ours = NetworkClassifier(**PAPER, max_iter=20, random_state=3).fit(narrow, labels)
    theirs = scikit_network(ours).fit(narrow, labels)
    assert {array.dtype for array in ours.coefs_ + ours.intercepts_} == {np.dtype(np.float32)}
    assert ours.predict_proba(narrow).dtype == np.float32
    np.testing.assert_allclose(ours.loss_curve_, theirs.loss_curve_, rtol=1e-4)


def test_training_together_or_separately_gives_the_same_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "TOGETHER", 3)
    sizes = [(300, 6), (300, 6), (300, 6), (300, 6), (260, 6), (300, 2)]
    data = [clusters(rows, 8, classes, seed=i) for i, (rows, classes) in enumerate(sizes)]
    networks = [NetworkClassifier(**PAPER, max_iter=15, random_state=i) for i in range(len(data))]
    networks[1].set_params(hidden_layer_sizes=(20,))
    fitted = fit_together(networks, data)
    assert [a is b for a, b in zip(fitted, networks, strict=True)] == [True] * len(data)
    for network, (values, labels) in zip(networks, data, strict=True):
        alone = clone(network).fit(values, labels)
        np.testing.assert_allclose(network.loss_curve_, alone.loss_curve_, rtol=1e-12)
        np.testing.assert_array_equal(network.predict(values), alone.predict(values))


def test_labels_may_be_words_and_results_depend_on_the_seed_only() -> None:
    values, labels = clusters(300, 5, 3, noise=0.2)
    words = np.array(["texture-1", "texture-2", "texture-6"])[labels]
    first, second, other = (
        NetworkClassifier(**PAPER, max_iter=80, random_state=s).fit(values, words) for s in (1, 1, 2)
    )
    assert list(first.classes_) == ["texture-1", "texture-2", "texture-6"]
    assert first.loss_curve_ == second.loss_curve_ != other.loss_curve_
    assert first.score(values, words) > 0.95
    np.testing.assert_allclose(first.predict_proba(values).sum(axis=1), 1)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ("nan", {}, "NaN"),
        ("lengths", {}, "inconsistent numbers of samples"),
        ("huge", {"learning_rate_init": 1e200}, "finite"),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_bad_data_raise_as_in_scikit_learn(change: str, options: dict[str, Any], message: str) -> None:
    values, labels = clusters(60, 4, 3)
    if change == "nan":
        values[3, 2] = np.nan
    elif change == "lengths":
        labels = labels[:-1]
    elif change == "huge":
        values *= 1e200
    with pytest.raises(ValueError, match=message):
        NetworkClassifier(**{**PAPER, "max_iter": 5, "random_state": 0, **options}).fit(values, labels)


@pytest.mark.parametrize(
    "options", [{"max_iter": 0}, {"batch_size": 2.5}, {"alpha": -1.0}, {"learning_rate_init": 0.0}]
)
def test_parameters_that_are_not_allowed_are_refused_by_scikit_learn(options: dict[str, Any]) -> None:
    network = NetworkClassifier(**{**PAPER, **options})
    with pytest.raises(ValueError, match=f"The '{next(iter(options))}' parameter of"):
        network.fit(*clusters(60, 4, 3))
    assert network.get_params()[next(iter(options))] == next(iter(options.values()))
