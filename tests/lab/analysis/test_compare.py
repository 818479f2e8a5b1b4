"""Test the comparison of two sensors."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from helpers.studies import noise_image, write_study

pytest.importorskip("scipy")
pytest.importorskip("sklearn")
pytest.importorskip("matplotlib")
threadpoolctl = pytest.importorskip("threadpoolctl")

from tacbench_cad.cli import classify as classify_command
from tacbench_cad.cli import compare as command
from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord
from tacbench_cad.lab.analysis.compare import (
    ALL_TEXTURES,
    COLUMNS,
    Difference,
    PrintAccuracy,
    Side,
    compare,
    read_side,
)
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Ints

TEXTURES = ("texture-1", "texture-2")
PRESSES = 50


def side(name: str, right: dict[str, Ints], start: int = 0) -> Side:
    """Return a sensor with the number of correct presses of each print; print numbers begin at ``start``."""
    accuracies = {
        ("copy", texture): {
            f"{texture}_{start + i}": PrintAccuracy(int(count) / PRESSES, presses=PRESSES)
            for i, count in enumerate(counts)
        }
        for texture, counts in right.items()
    }
    return Side(name=name, record=record(name), accuracies=accuracies)


def record(sensor: str, textures: tuple[str, ...] = TEXTURES) -> ClassificationRecord:
    return ClassificationRecord(
        trials=1, textures=textures, sensor=sensor, units="counts", simulated=(), data="", notes=()
    )


def compare_sides(a: Ints, b: Ints, start: int = 0, same_prints: bool = True) -> Difference:
    """Return the row of texture 1."""
    other = np.full(len(a), 25)
    first = side("a", {"texture-1": a, "texture-2": other})
    second = side("b", {"texture-1": b, "texture-2": np.full(len(b), 25)}, start)
    result = compare(first, second, "forest", same_prints=same_prints)
    assert [row.texture for row in result.rows] == [ALL_TEXTURES, *TEXTURES]
    return result.rows[1]


def test_prints_pressed_by_both_are_compared_in_pairs() -> None:
    a = np.array([10, 20, 30, 40])
    better = a + np.array([9, 11, 9, 11])
    line = compare_sides(a, better)
    assert line.paired and (line.prints_a, line.prints_b) == (4, 4)
    assert line.difference == pytest.approx(0.2)
    assert line.verdict == "B better" and line.smallest_difference is not None
    apart = compare_sides(a, better, start=100)
    assert not apart.paired and apart.verdict == "not told apart"
    assert apart.smallest_difference is not None
    assert apart.smallest_difference > 2.0 * line.smallest_difference
    assert compare_sides(a, better, same_prints=False) == apart


def test_two_perfect_sensors_are_not_shown_to_be_equal() -> None:
    line = compare_sides(np.full(6, PRESSES), np.full(6, PRESSES))
    assert line.difference == 0.0 and line.smallest_difference is not None and line.smallest_difference > 0.02


def test_a_single_print_shows_no_difference() -> None:
    line = compare_sides(np.array([10]), np.array([50]))
    assert (line.low, line.high, line.smallest_difference) == (None, None, None)
    assert line.verdict == "too few prints"


@pytest.mark.parametrize("start", [0, 100])
def test_the_smallest_difference_is_detected_in_80_percent_of_studies(start: int) -> None:
    """A difference of the typical smallest size is shown in about 80 % of seeded studies, a zero difference in 5 %."""
    rng = np.random.default_rng(7)
    prints, studies = 12, 250

    def study(difference: float) -> Difference:
        hard = np.clip(rng.normal(0.6, 0.05, (2, prints)), 0.0, 1.0)
        if start == 0:
            hard[1] = hard[0]
        return compare_sides(rng.binomial(PRESSES, hard[0]), rng.binomial(PRESSES, hard[1] + difference), start)

    null = [study(0.0) for _ in range(studies)]
    smallest = float(np.mean([result.smallest_difference or 1.0 for result in null]))
    assert sum(result.verdict != "not told apart" for result in null) <= 0.08 * studies
    shown = sum(study(smallest).verdict == "B better" for _ in range(studies))
    assert 0.72 * studies <= shown <= 0.92 * studies


def test_other_textures_are_refused_by_name() -> None:
    a = side("a", {"texture-1": np.array([1, 2])})
    b = Side(name="b", record=record("b", ("texture-1", "wave")), accuracies=a.accuracies)
    with pytest.raises(InputError, match="textures = 'texture-2, wave': must be in both a and b"):
        compare(a, b, "forest")


def test_no_common_level_is_refused() -> None:
    a = side("a", {"texture-1": np.array([1, 2])})
    accuracies = {("force", texture): prints for (_, texture), prints in a.accuracies.items()}
    b = Side(name="b", record=record("b"), accuracies=accuracies)
    with pytest.raises(InputError, match="have no level in common"):
        compare(a, b, "forest")


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory, few_trees: None) -> tuple[Path, dict[str, object]]:
    """Compare, by the command, a sensor that sees textures with a sensor that sees noise on the same prints."""
    folder = tmp_path_factory.mktemp("compare")
    write_study(folder / "seeing", simulated="a formula", copies=3)
    write_study(folder / "blind", image=noise_image, copies=3)
    out = folder / "out"
    words = [str(folder / "seeing"), str(folder / "blind"), "-o", str(out), "--trials", "1", "--jobs", "1", "--json"]
    with threadpoolctl.threadpool_limits(1):
        answer = CliRunner().invoke(command.command, words)
    assert answer.exit_code == 0, answer.output
    return folder, json.loads(answer.stdout)


def test_the_command_takes_runs_and_distinguishes_a_seeing_sensor_from_a_blind_one(
    compared: tuple[Path, dict[str, object]],
) -> None:
    folder, document = compared
    assert document["simulated"] == ["sensor: a formula"]
    with (folder / "out" / "comparison.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [*(column.name for column in COLUMNS), "simulated"]
    of_press = {row["texture"]: row for row in rows if row["hold_out"] == "press"}
    assert float(of_press["all"]["accuracy_a"]) > 0.9 > 0.8 > float(of_press["all"]["accuracy_b"])
    assert float(of_press["all"]["high"]) < 0.0 and of_press["all"]["paired"] == "true"
    for kind in ("png", "pdf"):
        assert (folder / "out" / f"comparison.{kind}").stat().st_size > 5000


@pytest.mark.usefixtures("no_figures")
def test_the_command_takes_result_folders_of_classify(compared: tuple[Path, dict[str, object]], tmp_path: Path) -> None:
    folder, document = compared
    sides = [str(folder / "out" / f"classification_{side}") for side in "ab"]
    again = CliRunner().invoke(command.command, [*sides, "-o", str(tmp_path), "--json"])
    assert again.exit_code == 0
    assert json.loads(again.stdout)["rows"] == document["rows"]
    unpaired = CliRunner().invoke(command.command, [*sides, "--unpaired", "-o", str(tmp_path), "--json"])
    assert not any(row["paired"] for row in json.loads(unpaired.stdout)["rows"])
    plain = CliRunner().invoke(command.command, [*sides, "-o", str(tmp_path)])
    assert "A better" in plain.stdout and "simulated: sensor (see run.json)\n" in plain.stdout


def test_a_folder_without_the_estimator_is_refused(compared: tuple[Path, dict[str, object]]) -> None:
    with pytest.raises(InputError, match=r"estimator = 'network': must be one of forest, as in"):
        read_side(compared[0] / "out" / "classification_a", "a", "network")


def test_a_study_is_not_compared_with_itself(tmp_path: Path) -> None:
    answer = CliRunner().invoke(command.command, [str(tmp_path), str(tmp_path)])
    assert isinstance(answer.exception, InputError) and "is the same folder as A" in str(answer.exception)


def test_two_estimators_of_one_classification_are_compared(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", still=1)
    out, answer = tmp_path / "out", tmp_path / "answer"
    quick = ["--resolution", "1", "--components", "4", "--trials", "1", "--jobs", "1", "--epochs", "2", "--depth", "3"]
    words = [str(tmp_path / "runs"), *quick, "--hold-out", "copy", "--estimator", "forest,network", "-o", str(out)]
    assert CliRunner().invoke(classify_command.command, words).exit_code == 0
    words = [str(out), str(out), "-o", str(answer), "--estimator"]
    document = json.loads(CliRunner().invoke(command.command, [*words, "forest,network", "--json"]).stdout)
    assert document["estimator"] == "forest and network"
    for key, name in (("accuracy_a", "forest"), ("accuracy_b", "network")):
        accuracies = read_side(out, "", name)[0].accuracies["copy", "texture-2"].values()
        (row,) = (row for row in document["rows"] if row["texture"] == "texture-2")
        assert row[key] == pytest.approx(np.mean([accuracy.value for accuracy in accuracies])) and row["paired"]
    for names, reason in (
        ("forest,forest", "is the same folder as A"),
        ("forest,network,forest", "must be one name, or one for A and one for B"),
    ):
        error = CliRunner().invoke(command.command, [*words, names]).exception
        assert isinstance(error, InputError) and reason in str(error)
