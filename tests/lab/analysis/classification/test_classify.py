"""Test stored trials, which are read again like untrusted files."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tacbench_cad.lab.analysis.classification import settings as settings_module
from tacbench_cad.lab.analysis.classification.classify import classify
from tacbench_cad.lab.analysis.classification.result import Result
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.usefixtures("single_thread")

SETTINGS = ClassificationSettings(resolution=1.0, components=2, hold_out=("copy",), depth=3)


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(still=1)


@pytest.fixture(scope="module")
def trials_folder(study: Collection, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    run(study, folder)
    return folder


def run(study: Collection, folder: Path) -> Result:
    with workers() as executor:
        return classify(study, SETTINGS, 1, folder, executor)


def pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def link(path: Path) -> None:
    elsewhere = path.parent.parent / "elsewhere.json"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)


def a_number_of_400_digits(path: Path) -> None:
    path.write_text(path.read_text().replace('"trial":1', f'"trial":{"9" * 400}'))


def a_list_as_trial(path: Path) -> None:
    path.write_text("[1, 2]")


@pytest.mark.parametrize("damage", [pipe, link, a_number_of_400_digits, a_list_as_trial])
def test_an_unusable_stored_trial_is_computed_again(
    study: Collection, trials_folder: Path, tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    out = shutil.copytree(trials_folder, tmp_path / "out")
    (trial,) = (out / "trials").iterdir()
    good = trial.read_bytes()
    damage(trial)
    run(study, out)
    assert trial.is_file() and not trial.is_symlink() and trial.read_bytes() == good


def test_a_stored_trial_that_is_too_large_is_computed_again(
    study: Collection, trials_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = shutil.copytree(trials_folder, tmp_path / "out")
    (trial,) = (out / "trials").iterdir()
    before = trial.stat().st_mtime_ns
    run(study, out)
    assert trial.stat().st_mtime_ns == before
    monkeypatch.setattr(untrusted, "MAX_MB", {**untrusted.MAX_MB, "json": 1e-6})
    run(study, out)
    assert trial.stat().st_mtime_ns != before


def test_trials_of_an_older_algorithm_are_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    key = SETTINGS.key("data")
    assert SETTINGS.key("data") == key != SETTINGS.key("other data")
    monkeypatch.setattr(settings_module, "ALGORITHM", settings_module.ALGORITHM + 1)
    newer = SETTINGS.key("data")
    assert newer != key
    monkeypatch.setattr(settings_module, "__version__", "999")
    assert SETTINGS.key("data") not in (key, newer)


def test_the_file_of_an_estimator_must_be_a_regular_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "piped_model.py").write_text("from sklearn.dummy import DummyClassifier\n\nModel = DummyClassifier\n")
    monkeypatch.syspath_prepend(tmp_path)
    own = ClassificationSettings(estimators=("piped_model:Model",))
    assert own.key("data") == own.key("data")
    pipe(tmp_path / "piped_model.py")
    with pytest.raises(InputError, match="is a pipe, a socket or a device"):
        own.key("data")
    del sys.modules["piped_model"]


def test_a_trial_belongs_to_the_files_that_its_estimator_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    weights = tmp_path / "weights.bin"
    (tmp_path / "heavy_model.py").write_text(
        f"from sklearn.dummy import DummyClassifier\n\nFILES = [{str(weights)!r}]\nModel = DummyClassifier\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    own = ClassificationSettings(estimators=("heavy_model:Model",))
    with pytest.raises(InputError, match=r"weights\.bin"):
        own.key("data")
    weights.write_bytes(b"first")
    key = own.key("data")
    assert own.key("data") == key
    weights.write_bytes(b"other")
    assert own.key("data") != key
    del sys.modules["heavy_model"]
