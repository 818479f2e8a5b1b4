"""Test that a feature of another package is analysed like our own."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.devices import install_package
from helpers.studies import write_study
from sklearn.base import clone

from tacbench_cad import lab
from tacbench_cad.cli import main
from tacbench_cad.lab.analysis.feature import GROUP, feature_of
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.util.entries import groups
from tacbench_cad.util.errors import CheckFailedError, InputError, MissingToolError

DOCS = (Path(__file__).parents[3] / "docs" / "extending.md").read_text(encoding="utf-8")


@pytest.fixture
def brightness(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Install the feature of the manual, and one whose module is missing."""
    (source,) = re.findall(r"write=brightness.py\n(.*?)```", DOCS, re.S)
    points = f"[{GROUP}]\nbrightness = brightness:Brightness\ngone = gone_extension:Gone\n"
    install_package(tmp_path / "site", monkeypatch, points, brightness=source)
    yield
    groups.cache_clear()


@pytest.mark.usefixtures("brightness", "no_figures")
def test_a_feature_of_another_package_is_analysed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_study(tmp_path / "runs", levels=(1,))
    presses = lab.read(tmp_path / "runs")
    result = lab.variance(presses, feature_of("brightness:strips=3"))
    cell = result.table.iloc[0]
    names = ["printer", "filament", "texture"]
    here = presses[(presses[names] == cell[names]).all(axis=1)]
    expected = []
    for _, of_position in here.groupby("position"):
        frames = [read_frame(path) for path in of_position["frame"]]
        means = [[strip.mean() for strip in np.array_split(frame, 3)] for frame in frames]
        expected.append(np.var(means, axis=0).mean())
    assert cell["variance"] == pytest.approx(np.mean(expected))
    words = [str(tmp_path / "runs"), "--features", "brightness", "--jobs", "1", "--json", "-o"]
    assert main(["variance", *words, str(tmp_path / "table")]) == 0
    assert json.loads(capsys.readouterr().out)["features"] == "brightness"
    assert main(["classify", *words, str(tmp_path / "classes"), "--hold-out", "copy", "--trials", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["features"] == "Brightness()"


@pytest.mark.usefixtures("brightness")
def test_an_unknown_or_missing_feature_is_refused() -> None:
    with pytest.raises(InputError, match="brightness"):
        feature_of("brightnes")
    with pytest.raises(InputError, match="strips"):
        feature_of("brightness:strip=3")
    with pytest.raises(MissingToolError, match="gone needs gone_extension, which is not installed"):
        feature_of("gone")


def test_features_are_transformers_of_scikit_learn(tmp_path: Path) -> None:
    write_study(tmp_path, textures=(1,), copies=1)
    presses = lab.read(tmp_path)
    for feature, count in ((lab.Pixels(size=(8, 6)), 48), (lab.Pixels(roi="rect:0,0,9,9"), 100)):
        numbers = feature.fit_transform(presses)
        assert numbers.shape == (len(presses), count)
        assert np.array_equal(pickle.loads(pickle.dumps(feature)).transform(presses), numbers)
        assert not hasattr(clone(feature), "shape_") and clone(feature).get_params() == feature.get_params()
        assert feature.get_feature_names_out().tolist()[:: count - 1] == ["pixels_0", f"pixels_{count - 1}"]


def test_a_damaged_frame_of_a_table_is_named(tmp_path: Path) -> None:
    (folder, *_) = write_study(tmp_path, textures=(1,), copies=1)
    presses = lab.read(folder)
    (folder / "sensor_images" / "image_3.png").write_bytes(b"no picture")
    with pytest.raises(CheckFailedError, match=r"image_3\.png"):
        lab.Pixels().fit_transform(presses)
