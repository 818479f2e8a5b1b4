"""Test sweeps: the accuracy as a function of a setting."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from tacbench_cad import lab
from tacbench_cad.lab.analysis.classification.sweep import Sweep, parsed
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.usefixtures("single_thread", "few_trees")


@pytest.fixture(scope="module")
def study(make_study: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return make_study(levels=(1, 2), copies=3, still=1)


def swept(study: pd.DataFrame, text: str, trials: int = 1, folder: Path | None = None, **changes: Any) -> Sweep:
    settings = lab.ClassificationSettings(**{"components": 4, "hold_out": ("copy",), **changes})
    return lab.sweep(study, text, lab.Pixels(), settings, trials=trials, folder=folder)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("resolution=0.025:0.475", tuple(round(0.025 + 0.05 * i, 6) for i in range(10))),
        ("components=5:50:10", tuple(range(5, 51, 5))),
        ("copies=1:3", (1.0, 2.0, 3.0)),
        ("forces=3,1", (1.0, 3.0)),
    ],
)
def test_values_are_a_range_or_a_list(text: str, values: tuple[float, ...]) -> None:
    assert parsed(text) == (text.partition("=")[0], values)


@pytest.mark.parametrize(
    "text",
    ["resolution", "resolution=", "resolution=a:b", "resolution=0.4:0.1", "resolution=0:1", "resolution=0.1:nan",
     "copies=1.5,2", "copies=0,1", "components=1:5:1", "resolution=0.1:0.2:3:4", "resolutoin=0.1:0.2"],
)  # fmt: skip
def test_invalid_sweeps_are_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"sweep = .*(must be|did you mean)"):
        parsed(text)


def test_each_value_has_a_row_with_interval_and_standard_deviation(study: pd.DataFrame, tmp_path: Path) -> None:
    result = swept(study, "resolution=0.1,0.5,1", 2, tmp_path)
    csv, png, pdf = result.save(tmp_path)
    rows = pd.read_csv(csv)
    assert rows["value"].tolist() == [0.1, 0.5, 1.0] and set(rows["parameter"]) == {"resolution"}
    assert ((rows["low"] <= rows["accuracy"]) & (rows["accuracy"] <= rows["high"])).all()
    assert rows["standard_deviation"].notna().all()
    again = swept(study, "resolution=0.5,1", 2, tmp_path)
    assert np.array_equal(again.table["accuracy"], rows["accuracy"][1:])
    assert len(list((tmp_path / "trials").iterdir())) == 6
    assert png.name == "sweep_resolution.png" and pdf.read_bytes().startswith(b"%PDF")


def test_copies_forces_and_frames_select_the_data(study: pd.DataFrame) -> None:
    assert swept(study, "copies=1:2").table["images"].tolist() == [len(study)] * 2
    assert swept(study, "forces=1,2").table["images"].tolist() == [len(study) // 2] * 2
    for text, reason in (
        ("copies=3", "there are fewer than 3 prints of some texture in training"),
        ("forces=3", "force-level = 3: must be a level of the runs: 1, 2"),
        ("frames=1", "needs series of frames"),
    ):
        with pytest.raises(InputError, match=reason):
            swept(study, text)


def test_a_setting_of_another_protocol_is_refused(study: pd.DataFrame) -> None:
    with pytest.raises(InputError, match="needs --protocol leak-free"):
        swept(study, "copies=1", protocol="paper")
    with pytest.raises(InputError, match="needs principal components"):
        swept(study, "components=2,3", components=None)
    with pytest.raises(InputError, match="is not a setting of the feature forces"):
        lab.sweep(study, "resolution=0.5", lab.Forces(), lab.ClassificationSettings())


def test_the_papers_columns_can_be_swept(study: pd.DataFrame) -> None:
    table = swept(study, "components=2,4", protocol="paper", hold_out=()).table
    expected = [(value, level) for value in (2.0, 4.0) for level in ("train", "test", "unseen")]
    assert list(zip(table["value"], table["hold_out"], strict=True)) == expected
