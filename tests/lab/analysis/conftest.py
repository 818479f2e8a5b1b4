"""Fixtures of the tests of the analysis: studies on disk, and a single thread for small matrices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pandas as pd
import pytest
from helpers.studies import write_study

from tacbench_cad.lab.runs.press_table import read


@pytest.fixture(scope="session")
def make_study(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., pd.DataFrame]:
    """Return a function that writes a study with the given fields of :class:`studies.Plan` and reads its presses."""

    def make(**plan: Any) -> pd.DataFrame:
        folder = tmp_path_factory.mktemp("study")
        write_study(folder, **plan)
        return read(folder)

    return make


@pytest.fixture(scope="module")
def single_thread() -> Iterator[None]:
    """Restrict the libraries for matrices to one thread, as the command does."""
    with pytest.importorskip("threadpoolctl").threadpool_limits(limits=1):
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
