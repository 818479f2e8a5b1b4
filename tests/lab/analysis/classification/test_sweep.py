"""Test sweeps: the accuracy as a function of a setting."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import pytest

from tacbench_cad.lab.analysis.classification.accuracy_figures import draw_result
from tacbench_cad.lab.analysis.classification.classify import write_tables
from tacbench_cad.lab.analysis.classification.result import SWEEP_COLUMNS, Result
from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
from tacbench_cad.lab.analysis.classification.sweep import Sweep, run_sweep
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.usefixtures("single_thread", "few_trees")

LEAK_FREE = ClassificationSettings(resolution=1.0, components=4, hold_out=("copy",))


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(levels=(1, 2), copies=3, still=1)


def swept(
    study: Collection, out: Path, text: str, settings: ClassificationSettings = LEAK_FREE, trials: int = 2
) -> Result:
    with workers() as executor:
        return run_sweep(study, settings, Sweep.parsed(text), trials, out, executor)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("resolution=0.025:0.475", tuple(round(0.025 + 0.05 * i, 6) for i in range(10))),
        ("components=5:50:10", tuple(float(number) for number in range(5, 51, 5))),
        ("copies=1:3", (1.0, 2.0, 3.0)),
        ("forces=3,1", (1.0, 3.0)),
    ],
)
def test_values_are_a_range_or_a_list(text: str, values: tuple[float, ...]) -> None:
    assert Sweep.parsed(text).values == values


@pytest.mark.parametrize(
    "text",
    ["resolution", "resolution=", "resolution=a:b", "resolution=0.4:0.1", "resolution=0:1", "resolution=0.1:nan",
     "copies=1.5,2", "copies=0,1", "components=1:5:1", "resolution=0.1:0.2:3:4"],
)  # fmt: skip
def test_invalid_sweeps_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="sweep"):
        Sweep.parsed(text)
    with pytest.raises(InputError, match='did you mean "resolution"'):
        Sweep.parsed("resolutoin=0.1:0.2")


def test_each_value_has_a_row_with_interval_and_standard_deviation(study: Collection, tmp_path: Path) -> None:
    result = swept(study, tmp_path, "resolution=0.1,0.5,1")
    (path,) = write_tables(result, tmp_path)
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [*SWEEP_COLUMNS, "simulated"]
    assert [float(row["value"]) for row in rows] == [0.1, 0.5, 1.0]
    for row in rows:
        assert row["parameter"] == "resolution" and row["trials"] == "2" and row["standard_deviation"]
        assert float(row["low"]) <= float(row["accuracy"]) <= float(row["high"])
    again = swept(study, tmp_path, "resolution=0.5,1")
    assert [score.accuracy for score in again.scores] == [float(row["accuracy"]) for row in rows[1:]]
    assert len(list((tmp_path / "trials").iterdir())) == 6
    png, pdf = draw_result(result, tmp_path)
    assert png.name == "sweep_resolution.png" and pdf.read_bytes().startswith(b"%PDF")


def test_copies_and_forces_select_the_data(study: Collection, tmp_path: Path) -> None:
    copies = swept(study, tmp_path, "copies=1:2", trials=1)
    assert list(copies.values) == [1.0, 2.0]
    assert {score.images for score in copies.scores} == {len(study)}
    forces = swept(study, tmp_path, "forces=1,2", trials=1)
    assert {score.images for score in forces.scores} == {len(study) // 2}
    with pytest.raises(InputError, match="there are fewer than 3 prints of some texture in training"):
        swept(study, tmp_path, "copies=3", trials=1)
    with pytest.raises(InputError, match="force-level = 3: must be a level of the runs: 1, 2"):
        swept(study, tmp_path, "forces=3", trials=1)


def test_a_setting_of_another_protocol_is_refused(study: Collection, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs --protocol leak-free"):
        swept(study, tmp_path, "copies=1", ClassificationSettings(protocol="paper"))
    with pytest.raises(InputError, match="needs principal components"):
        swept(study, tmp_path, "components=2,3", ClassificationSettings(components=None))


def test_the_papers_columns_can_be_swept(study: Collection, tmp_path: Path) -> None:
    settings = ClassificationSettings(protocol="paper", resolution=1.0, estimators=("forest",))
    result = swept(study, tmp_path, "components=2,4", settings, trials=1)
    levels = [(value, score.hold_out) for value, score in zip(result.values, result.scores, strict=True)]
    assert levels == [(value, level) for value in (2.0, 4.0) for level in ("train", "test", "unseen")]
