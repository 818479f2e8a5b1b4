"""What tests of classification share: studies on disk, opened, and one thread for matrices too small for several."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from helpers.studies import write_study

from tacbench_cad.lab.analysis.classification.settings import one_thread
from tacbench_cad.lab.analysis.collection import Collection


@pytest.fixture(scope="session")
def make_study(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Collection]:
    """Writes a study, by the fields of :class:`studies.Plan`, and opens it."""

    def make(**plan: Any) -> Collection:
        folder = tmp_path_factory.mktemp("study")
        write_study(folder, **plan)
        return Collection.open([folder])

    return make


@pytest.fixture(scope="module")
def single_thread() -> Iterator[None]:
    """Keep the matrices' libraries to one thread, as the command does."""
    with one_thread():
        yield
