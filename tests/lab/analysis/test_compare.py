"""Test the comparison of two sensors."""

from __future__ import annotations

import csv
import json
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

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
from tacbench_cad.lab.analysis.compare import ALL_TEXTURES, Difference, compare
from tacbench_cad.lab.analysis.comparison_sides import PrintAccuracy, Side, read_side, side_names
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Ints

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
    assert line.verdict == "too few groups"


@pytest.mark.parametrize("start", [0, 100])
def test_the_smallest_difference_is_detected_in_80_percent_of_studies(start: int) -> None:
    """Intervals exclude 0 in about 80 % of the studies with the typical smallest difference, and in 5 % with none."""
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
    assert sum(result.verdict.endswith("better") for result in null) <= 0.02 * studies
    shown = sum((study(smallest).low or 0.0) > 0.0 for _ in range(studies))
    assert 0.72 * studies <= shown <= 0.92 * studies


def test_a_difference_below_the_detectable_one_is_not_shown() -> None:
    """The differences 2, 2, 4, 4, 9, 9 of 50 presses: t(5) = 2.571, interval 1.6 to 18.4 points, detectable 11.4."""
    line = compare_sides(np.full(6, 25), 25 + np.array([2, 2, 4, 4, 9, 9]))
    expected = np.array([2, 2, 4, 4, 9, 9]) / 50
    error = max(np.var(expected, ddof=1), 0.01) / 6
    assert line.low is not None and line.low > 0.0 and line.smallest_difference is not None
    assert line.difference == pytest.approx(0.1) and line.smallest_difference > 2.5 * np.sqrt(error) > 0.1
    assert line.verdict == "not shown"


def test_random_tables_have_monotone_verdicts() -> None:
    """In a table with equally many prints, a larger difference never gets a weaker verdict."""
    rng = np.random.default_rng(25)
    ranks = {"A better": -1, "not shown": 0, "not told apart": 0, "B better": 1}
    seen = set()
    for number in range(150):
        names = tuple(f"texture-{i}" for i in range(int(rng.integers(2, 8))))
        prints, s = int(rng.integers(2, 13)), float(rng.choice([0.5, 5.0, 200.0]))
        counts = [
            {name: rng.binomial(PRESSES, rng.beta(mean * s + 0.01, (1 - mean) * s + 0.01, prints)) for name in names}
            for mean in rng.choice([0.3, 0.7, 0.95, 1.0], 2)
        ]
        first, second = (
            replace(side(letter, of, start), record=record(letter, names))
            for letter, of, start in zip("ab", counts, (0, 100 * (number % 2)), strict=True)
        )
        rows = sorted(compare(first, second, "forest").rows[1:], key=lambda row: row.difference)
        assert [row.paired for row in rows] == [number % 2 == 0] * len(names)
        verdicts = [row.verdict for row in rows]
        assert [ranks[verdict] for verdict in verdicts] == sorted(ranks[verdict] for verdict in verdicts)
        seen |= set(verdicts)
    assert seen == set(ranks)


def test_a_missing_print_leaves_the_others_paired() -> None:
    """The prints differ by up to 80 points, B by 20 from A: unpaired, this is lost."""
    a = np.array([5, 12, 20, 30, 38, 40])
    first = side("a", dict.fromkeys(TEXTURES, a))
    second = side("b", {name: a + np.array([9, 11, 10, 9, 11, 10]) for name in TEXTURES})
    del second.accuracies["copy", "texture-1"]["texture-1_3"]  # type: ignore[attr-defined]
    comparison = compare(first, second, "forest")
    whole, line, other = comparison.rows
    assert (line.paired, line.prints_a, line.prints_b, line.verdict) == (True, 5, 5, "B better")
    assert (whole.prints_a, other.prints_a) == (11, 6)
    assert line.accuracy_a == pytest.approx(np.delete(a, 3).mean() / PRESSES)
    assert comparison.notes[0] == "a alone has the prints texture-1_3; they are left out"


def test_a_few_prints_of_one_sensor_are_compared_with_the_same_prints_of_the_other() -> None:
    """B pressed two of A's six prints. They are the same prints, so the sensors did not press different ones."""
    a = np.array([5, 12, 20, 30, 38, 40])
    first = side("a", dict.fromkeys(TEXTURES, a))
    second = side("b", dict.fromkeys(TEXTURES, a[:2] + np.array([9, 11])))
    comparison = compare(first, second, "forest")
    assert [(row.paired, row.prints_a, row.prints_b) for row in comparison.rows] == [
        (True, 4, 4),
        (True, 2, 2),
        (True, 2, 2),
    ]
    assert not any("different prints (" in note for note in comparison.notes)


def test_prints_that_are_mostly_different_are_not_compared_in_pairs() -> None:
    """Each sensor pressed six prints, and both pressed two of them: six against six show more than two pairs."""
    first, second = (
        side(name, dict.fromkeys(TEXTURES, np.arange(20, 26)), start) for name, start in (("a", 0), ("b", 4))
    )
    comparison = compare(first, second, "forest")
    assert [(row.paired, row.prints_a, row.prints_b) for row in comparison.rows[1:]] == [(False, 6, 6)] * 2
    assert "both sensors pressed only 4 of the prints" in comparison.notes[0]


def test_a_texture_without_a_shared_print_is_named() -> None:
    first = side("a", dict.fromkeys(TEXTURES, np.arange(20, 26)))
    second = side("b", {"texture-1": np.arange(20, 26)})
    second.accuracies["copy", "texture-2"] = {"texture-2_9": PrintAccuracy(0.5, PRESSES)}  # type: ignore[index]
    comparison = compare(first, second, "forest")
    assert [row.texture for row in comparison.rows] == [ALL_TEXTURES, "texture-1"]
    assert any("texture-2: no print was pressed by both sensors" in note for note in comparison.notes)


def test_many_samples_of_unknown_prints_show_a_clear_difference() -> None:
    """270 and 294 of 300 independent samples are right: the interval of two proportions is 4.3 to 11.7 points."""
    unknown = replace(record("DIGIT"), unknown_groups=("prints", "sessions"))

    def sampled(name: str, wrong: int) -> Side:
        samples = {
            ("press", texture): {f"{texture} {i}": PrintAccuracy(float(i >= wrong), presses=1) for i in range(300)}
            for texture in TEXTURES
        }
        return Side(name=name, record=replace(unknown, data=name), accuracies=samples)

    for row in compare(sampled("a", 30), sampled("b", 6), "forest").rows[1:]:
        assert row.low is not None and row.high is not None and row.verdict == "B better"
        assert (row.low, row.high) == pytest.approx((0.0429, 0.1171), abs=0.004)


def test_classes_of_unknown_prints_are_not_called_prints() -> None:
    """Imported classes have a run folder each: their samples are compared, in pairs only if they are the same data."""
    unknown = replace(record("DIGIT"), unknown_groups=("prints", "sessions"))
    samples = {
        ("press", texture): {f"{texture} {i}": PrintAccuracy(float(i % 4 > 0), presses=1) for i in range(40)}
        for texture in TEXTURES
    }
    first = Side(name="a", record=replace(unknown, data="1"), accuracies=samples)
    second = replace(first, name="b", record=replace(unknown, data="2"))
    comparison = compare(first, second, "forest")
    assert not comparison.rows[0].paired and comparison.shown.heads[-2] == "samples"
    assert "the prints are unknown, so the samples are compared" in comparison.notes[0]
    assert not any("same prints" in note or "pairs" in note for note in comparison.notes)
    assert comparison.shown.texts[0][0] == "random split, may leak"
    assert compare(first, first, "forest and network").rows[0].paired
    texts = [text for axes in comparison.figure().axes for text in shown_texts(axes)]
    assert any("random split" in text and "may leak" in text for text in texts)
    assert not any("print" in text for text in texts)


def shown_texts(axes: Axes) -> list[str]:
    """Return the title and the labels of the x axis of a plot."""
    return [axes.get_title(loc="left"), *(label.get_text() for label in axes.get_xticklabels())]


def test_sides_are_named_by_what_differs(tmp_path: Path) -> None:
    folders = tmp_path / "x" / "runs", tmp_path / "y" / "runs"
    assert side_names(folders, [record("TacTip"), record("DIGIT")]) == ("TacTip", "DIGIT")
    same = [record("simulated TacTip")] * 2
    assert side_names((tmp_path / "fine", tmp_path / "coarse"), same) == ("fine", "coarse")
    assert side_names(folders, same) == (str(folders[0]), str(folders[1]))
    assert side_names((tmp_path, tmp_path), same) is None


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
    assert list(rows[0]) == [*(field.name for field in fields(Difference)), "simulated"]
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
    plain = CliRunner().invoke(command.command, [*sides, "--names", "seeing,blind", "-o", str(tmp_path)])
    assert "A: seeing, B: blind; in %" in plain.stdout
    assert [document[letter]["name"] for letter in "ab"] == ["seeing", "blind"]  # type: ignore[index]
    wrong = CliRunner().invoke(command.command, [*sides, "--names", "one", "-o", str(tmp_path)]).exception
    assert isinstance(wrong, InputError) and "names = 'one': must be two different names" in str(wrong)
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
