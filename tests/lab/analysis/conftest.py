"""Fixtures of the tests of the analysis: studies on disk, and a single thread for small matrices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from helpers.studies import write_study

from tacbench_cad.lab.analysis.classification.settings import one_thread
from tacbench_cad.lab.analysis.collection import Collection


@pytest.fixture(scope="session")
def make_study(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Collection]:
    """Return a function that writes a study with the given fields of :class:`studies.Plan` and opens it."""

    def make(**plan: Any) -> Collection:
        folder = tmp_path_factory.mktemp("study")
        write_study(folder, **plan)
        return Collection.open([folder])

    return make


@pytest.fixture(scope="module")
def single_thread() -> Iterator[None]:
    """Restrict the libraries for matrices to one thread, as the command does."""
    with one_thread():
        yield


@pytest.fixture(scope="module")
def few_trees() -> Iterator[None]:
    """Reduce the default number of trees of all forests in this process from 100 to 10."""
    ensemble = pytest.importorskip("sklearn.ensemble")
    defaults = ensemble.RandomForestClassifier.__init__.__defaults__
    assert defaults == (100,)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ensemble.RandomForestClassifier.__init__, "__defaults__", (10,))
        yield
