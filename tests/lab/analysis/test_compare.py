"""Test the comparison of two sensors."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from helpers.studies import noise_image, write_study

pytest.importorskip("scipy")
pytest.importorskip("sklearn")
pytest.importorskip("matplotlib")
threadpoolctl = pytest.importorskip("threadpoolctl")

from tacbench_cad import lab
from tacbench_cad.cli import classify as classify_command
from tacbench_cad.cli import compare as command
from tacbench_cad.lab.analysis.classification.classification import Classification, ClassificationRecord
from tacbench_cad.lab.analysis.compare import ALL_TEXTURES, Comparison
from tacbench_cad.util.errors import InputError

TEXTURES = ("texture-1", "texture-2")
PRESSES = 50


def side(right: dict[str, Iterable[int]], start: int = 0, presses: int = PRESSES, **about: Any) -> Classification:
    """Return a classification with the number of correct presses of each print; print numbers begin at ``start``."""
    prints = [(f"{name}_{i}", name, count) for name, of in right.items() for i, count in enumerate(of, start=start)]
    run, texture, counts = (np.repeat(column, presses) for column in zip(*prints, strict=True))
    predicted = np.where(np.arange(len(run)) % presses < counts, texture, "other")
    same = {"estimator": "forest", "train_on": "the others", "tested_on": "all", "hold_out": "copy", "trial": 1}
    columns = {"run": run, "press": np.arange(len(run)), "unit": run, "augmentation": "none"}
    predictions = pd.DataFrame({**same, **columns, "texture": texture, "predicted": predicted})
    record = {"settings": lab.ClassificationSettings(), "features": "", "summary": "", "units": "", "trials": 1}
    record |= {"textures": tuple(right), "sensor": "", "simulated": (), "data": "", "notes": ()}
    return Classification(record=ClassificationRecord(**{**record, **about}), predictions=predictions)


def both(*counts: int) -> dict[str, list[int]]:
    """Return the same numbers of correct presses for both textures."""
    return {texture: list(counts) for texture in TEXTURES}


def rows_of(comparison: Comparison) -> list[Any]:
    return list(comparison.table.itertuples())


def compare_sides(a: Iterable[int], b: Iterable[int], start: int = 0, same_prints: bool = True) -> Any:
    """Return the row of texture 1."""
    first, second = (side({"texture-1": x, "texture-2": [25] * len(list(x))}, n) for x, n in ((a, 0), (b, start)))
    rows = rows_of(lab.compare(first, second, same_prints=same_prints))
    assert [row.texture for row in rows] == [ALL_TEXTURES, *TEXTURES]
    return rows[1]


def test_prints_pressed_by_both_are_compared_in_pairs() -> None:
    a = np.array([10, 20, 30, 38])
    better = a + np.array([9, 11, 9, 11])
    line = compare_sides(a, better)
    assert line.paired and (line.prints_a, line.prints_b) == (4, 4)
    assert line.difference == pytest.approx(0.2) and line.verdict == "B better"
    apart = compare_sides(a, better, start=100)
    assert not apart.paired and apart.verdict == "not told apart"
    assert apart.smallest_difference > 2.0 * line.smallest_difference
    assert compare_sides(a, better, same_prints=False) == pytest.approx(apart)


def test_two_perfect_sensors_are_not_shown_to_be_equal() -> None:
    line = compare_sides([PRESSES] * 6, [PRESSES] * 6)
    assert line.difference == 0.0 and line.smallest_difference > 0.02


def test_a_single_print_shows_no_difference() -> None:
    line = compare_sides([10], [50])
    assert np.isnan([line.low, line.high, line.smallest_difference]).all() and line.verdict == "too few groups"


@pytest.mark.parametrize("start", [0, 100])
def test_the_smallest_difference_is_detected_in_80_percent_of_studies(start: int) -> None:
    """Intervals exclude 0 in about 80 % of the studies with the typical smallest difference, and in 5 % with none."""
    rng = np.random.default_rng(7)
    prints, studies = 12, 100

    def study(difference: float) -> Any:
        hard = np.clip(rng.normal(0.6, 0.05, (2, prints)), 0.0, 1.0)
        if start == 0:
            hard[1] = hard[0]
        return compare_sides(rng.binomial(PRESSES, hard[0]), rng.binomial(PRESSES, hard[1] + difference), start)

    null = [study(0.0) for _ in range(studies)]
    smallest = float(np.mean([result.smallest_difference for result in null]))
    assert sum(result.verdict != "not told apart" for result in null) <= 0.08 * studies
    assert sum(result.verdict.endswith("better") for result in null) <= 0.02 * studies
    assert 0.72 * studies <= sum(study(smallest).low > 0.0 for _ in range(studies)) <= 0.92 * studies


def test_a_difference_below_the_detectable_one_is_not_shown() -> None:
    """The differences 2, 2, 4, 4, 9, 9 of 50 presses: t(5) = 2.571, interval 1.6 to 18.4 points, detectable 11.4."""
    expected = np.array([2, 2, 4, 4, 9, 9])
    line = compare_sides([25] * 6, 25 + expected)
    error = max(np.var(expected / 50, ddof=1), 0.01) / 6
    assert line.low > 0.0 and line.smallest_difference > 2.5 * np.sqrt(error) > 0.1
    assert line.difference == pytest.approx(0.1) and line.verdict == "not shown"


def test_random_tables_have_monotone_verdicts() -> None:
    """In a table with equally many prints, a larger difference never gets a weaker verdict."""
    rng = np.random.default_rng(25)
    ranks = {"A better": -1, "not shown": 0, "not told apart": 0, "B better": 1}
    seen = set()
    for number in range(60):
        names = tuple(f"texture-{i}" for i in range(int(rng.integers(2, 8))))
        prints, s = int(rng.integers(2, 13)), float(rng.choice([0.5, 5.0, 200.0]))
        sides = []
        for mean, start in zip(rng.choice([0.3, 0.7, 0.95, 1.0], 2), (0, 100 * (number % 2)), strict=True):
            ends = mean * s + 0.01, (1 - mean) * s + 0.01
            sides.append(side({name: rng.binomial(PRESSES, rng.beta(*ends, prints)) for name in names}, start))
        rows = sorted(rows_of(lab.compare(*sides))[1:], key=lambda row: row.difference)
        assert [row.paired for row in rows] == [number % 2 == 0] * len(names)
        verdicts = [row.verdict for row in rows]
        assert [ranks[verdict] for verdict in verdicts] == sorted(ranks[verdict] for verdict in verdicts)
        seen |= set(verdicts)
    assert seen == set(ranks)


def without(side: Classification, run: str) -> Classification:
    return replace(side, predictions=side.predictions[side.predictions["run"] != run])


def test_a_missing_print_leaves_the_others_paired() -> None:
    """The prints differ by up to 80 points, B by 20 from A: unpaired, this is lost."""
    a = np.array([5, 12, 20, 30, 38, 40])
    second = side(both(*(a + np.array([9, 11, 10, 9, 11, 10]))))
    comparison = lab.compare(side(both(*a)), without(second, "texture-1_3"), names=("a", "b"))
    whole, line, other = rows_of(comparison)
    assert (line.paired, line.prints_a, line.prints_b, line.verdict) == (True, 5, 5, "B better")
    assert (whole.prints_a, other.prints_a) == (11, 6)
    assert line.accuracy_a == pytest.approx(np.delete(a, 3).mean() / PRESSES)
    assert comparison.notes[0] == "a alone has the prints texture-1_3; they are left out"


@pytest.mark.parametrize(
    ("second", "counts", "note"),
    [
        (side(both(14, 23)), [(True, 4, 4), (True, 2, 2), (True, 2, 2)], "A alone has the prints"),
        (side(both(*range(20, 26)), 4), [(False, 12, 12)] + [(False, 6, 6)] * 2, "pressed only 4 of"),
        (
            side({"texture-1": range(20, 26), "texture-2": [25] * 10}, 0),
            [(True, 12, 12), (True, 6, 6), (True, 6, 6)],
            "B alone has the prints texture-2_6, texture-2_7",
        ),
        (
            side(both(*range(20, 26)), 9),
            [(False, 12, 12)] + [(False, 6, 6)] * 2,
            "different prints (",
        ),
    ],
)
def test_prints_that_both_sensors_pressed_are_paired_if_they_are_most(
    second: Classification, counts: list[tuple[bool, int, int]], note: str
) -> None:
    comparison = lab.compare(side(both(*range(20, 26))), second)
    assert [(row.paired, row.prints_a, row.prints_b) for row in rows_of(comparison)] == counts
    assert note in comparison.notes[0]


def test_a_texture_without_a_shared_print_is_named() -> None:
    second = side({"texture-1": range(20, 26), "texture-2": [25] * 10})
    for number in range(6):
        second = without(second, f"texture-2_{number}")
    comparison = lab.compare(side(both(*range(20, 26))), second)
    assert [row.texture for row in rows_of(comparison)] == [ALL_TEXTURES, "texture-1"]
    assert any("texture-2: no print was pressed by both sensors" in note for note in comparison.notes)


def sampled(wrong: int, of: int, data: str) -> Classification:
    """Return a classification of samples whose prints and sessions are unknown."""
    counts = both(of - wrong)
    result = side(counts, presses=of, data=data, unknown_groups=("prints", "sessions"))
    return replace(result, predictions=result.predictions.assign(hold_out="press"))


def test_many_samples_of_unknown_prints_show_a_clear_difference() -> None:
    """270 and 294 of 300 independent samples are right: the interval of two proportions is 4.3 to 11.7 points."""
    for row in rows_of(lab.compare(sampled(30, 300, "a"), sampled(6, 300, "b")))[1:]:
        assert row.verdict == "B better" and (row.low, row.high) == pytest.approx((0.0429, 0.1171), abs=0.004)


def test_classes_of_unknown_prints_are_not_called_prints() -> None:
    """Imported classes have a run folder each: their samples are compared, in pairs only if they are the same data."""
    comparison = lab.compare(sampled(10, 40, "1"), sampled(10, 40, "2"))
    ((_, shown),) = comparison.shown()
    assert not comparison.table["paired"][0] and shown.heads[-2] == "samples"
    assert "the prints are unknown, so the samples are compared" in comparison.notes[0]
    assert not any("same prints" in note or "pairs" in note for note in comparison.notes)
    assert shown.texts[0][0] == "random split, may leak"
    assert lab.compare(sampled(10, 40, "1"), sampled(10, 40, "1")).table["paired"][0]
    axes = comparison.figure().axes
    texts = [text.get_text() for each in axes for text in each.get_xticklabels()]
    texts += [each.get_title(loc="left") for each in axes]
    assert any("random split" in text and "may leak" in text for text in texts)
    assert not any("print" in text for text in texts)


def test_what_cannot_be_compared_is_refused() -> None:
    a = side(both(1, 2))
    for b, reason in (
        (side({"texture-1": [1], "wave": [2]}), "textures = 'texture-2, wave': must be in both A and B"),
        (replace(a, predictions=a.predictions.assign(hold_out="force")), "have no level in common"),
        (side(both(1), settings=lab.ClassificationSettings(protocol="paper")), "leak-free"),
    ):
        with pytest.raises(InputError, match=reason):
            lab.compare(a, b)
    with pytest.raises(InputError, match=r"estimator = 'network': must be one of forest, as in B"):
        lab.compare(a, a, estimators=("forest", "network"))


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory, few_trees: None) -> tuple[Path, dict[str, Any]]:
    """Compare, by the command, a sensor that sees textures with a sensor that sees noise on the same prints."""
    folder = tmp_path_factory.mktemp("compare")
    write_study(folder / "seeing", simulated="a formula", copies=3)
    write_study(folder / "blind", image=noise_image, copies=3)
    words = [str(folder / "seeing"), str(folder / "blind"), "-o", str(folder / "out"), "--jobs", "1", "--json"]
    with threadpoolctl.threadpool_limits(1):
        answer = CliRunner().invoke(command.command, words)
    assert answer.exit_code == 0, answer.output
    return folder, json.loads(answer.stdout)


def test_the_command_takes_runs_and_distinguishes_a_seeing_sensor_from_a_blind_one(
    compared: tuple[Path, dict[str, Any]],
) -> None:
    folder, document = compared
    assert document["simulated"] == ["sensor: a formula"]
    assert [document[letter]["name"] for letter in "ab"] == ["seeing", "blind"]  # the sensors have the same name
    rows = pd.read_csv(folder / "out" / "comparison.csv")
    (of_press,) = rows[(rows["hold_out"] == "press") & (rows["texture"] == "all")].itertuples()
    assert of_press.accuracy_a > 0.9 > 0.8 > of_press.accuracy_b and of_press.high < 0.0 and of_press.paired
    for kind in ("png", "pdf"):
        assert (folder / "out" / f"comparison.{kind}").stat().st_size > 5000


@pytest.mark.usefixtures("no_figures")
def test_the_command_takes_result_folders_of_classify(compared: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder, document = compared
    sides = [str(folder / "out" / f"classification_{side}") for side in "ab"]

    def run(*words: str) -> Any:
        return CliRunner().invoke(command.command, [*sides, *words, "-o", str(tmp_path)])

    assert json.loads(run("--json").stdout)["rows"] == document["rows"]
    assert not any(row["paired"] for row in json.loads(run("--unpaired", "--json").stdout)["rows"])
    plain = run("--names", "seeing,blind").stdout
    assert "A: seeing, B: blind; in %" in plain and "A better" in plain
    assert "simulated: sensor (see run.json)\n" in plain
    wrong = run("--names", "one").exception
    assert isinstance(wrong, InputError) and "names = 'one': must be two different names" in str(wrong)


def test_two_estimators_of_one_classification_are_compared(tmp_path: Path) -> None:
    write_study(tmp_path / "runs", still=1)
    out, answer = tmp_path / "out", tmp_path / "answer"
    quick = ["--resolution", "1", "--components", "4", "--trials", "1", "--jobs", "1", "--epochs", "2", "--depth", "3"]
    words = [str(tmp_path / "runs"), *quick, "--hold-out", "copy", "--estimator", "forest,network", "-o", str(out)]
    assert CliRunner().invoke(classify_command.command, words).exit_code == 0
    words = [str(out), str(out), "-o", str(answer), "--estimator"]
    document = json.loads(CliRunner().invoke(command.command, [*words, "forest,network", "--json"]).stdout)
    assert document["estimator"] == "forest and network" and document["a"]["name"] == "forest"
    table = Classification.open(out).whole.set_index("estimator")["accuracy"]
    whole = document["rows"][0]
    assert (whole["accuracy_a"], whole["accuracy_b"]) == pytest.approx((table["forest"], table["network"]))
    for names, reason in (
        ("forest,forest", "is the same folder as A"),
        ("forest,network,forest", "must be one name, or one for A and one for B"),
    ):
        error = CliRunner().invoke(command.command, [*words, names]).exception
        assert isinstance(error, InputError) and reason in str(error)
