"""Test that a feature of another package is analysed like our own."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from helpers.devices import install_package
from helpers.studies import write_study

from tacbench_cad.cli import main
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import GROUP, feature_of, fitted
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.util.entries import groups
from tacbench_cad.util.errors import InputError, MissingToolError

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
    collection = Collection.open([tmp_path / "runs"])
    result = variance_table(collection, fitted(collection, "brightness:strips=3"))
    cell = result.cells[0]
    here = (collection.combination == f"{cell.printer}_{cell.filament}") & (collection.texture == cell.texture)
    expected = []
    for position in np.unique(collection.position):
        frames = [collection.frame(i) for i in np.flatnonzero(here & (collection.position == position))]
        means = [[strip.mean() for strip in np.array_split(frame, 3)] for frame in frames]
        expected.append(np.var(means, axis=0).mean())
    assert cell.variance == pytest.approx(np.mean(expected))
    words = [str(tmp_path / "runs"), "--features", "brightness", "--jobs", "1", "--json", "-o"]
    assert main(["variance", *words, str(tmp_path / "table")]) == 0
    assert json.loads(capsys.readouterr().out)["features"] == "brightness"
    assert main(["classify", *words, str(tmp_path / "classes"), "--hold-out", "copy", "--trials", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"]["features"] == "brightness"


@pytest.mark.usefixtures("brightness")
def test_an_unknown_or_missing_feature_is_refused() -> None:
    with pytest.raises(InputError, match="brightness"):
        feature_of("brightnes")
    with pytest.raises(InputError, match="strips"):
        feature_of("brightness:strip=3")
    with pytest.raises(MissingToolError, match="gone needs gone_extension, which is not installed"):
        feature_of("gone")
