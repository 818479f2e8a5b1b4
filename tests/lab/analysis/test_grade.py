"""Test the grade: published figures, verdicts, reasons, and the command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.studies import write_study

from tacbench_cad.cli import main
from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.variance.cells import FRAMES, Cell
from tacbench_cad.lab.analysis.variance.grade import Grade, grade
from tacbench_cad.lab.analysis.variance.grade_limits import to_two_repeats
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.names import SELECTED
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError

ENDER, BAMBU, RESIN = published.PAPER_VARIANCE


def cell(texture: int | str, low: float | None, high: float | None, **changes: Any) -> Cell:
    values: dict[str, Any] = {
        "printer": "mine",
        "filament": "petg",
        "texture": f"texture-{texture}" if isinstance(texture, int) else texture,
        "force_level": 1,
        "variance": 1.0 if low is None or high is None else (low + high) / 2.0,
        "floor": 0.2,
        "noise_alone": 0.1,
        "low": low,
        "high": high,
        "prints": 6,
        "presses": 900,
        "floor_from": FRAMES,
        "quantity": "repeats of one print",
    }
    return Cell(**{**values, **changes})


def like(row: tuple[float, ...], low: float, high: float, **changes: Any) -> list[Cell]:
    return [cell(i, low * value, high * value, **changes) for i, value in enumerate(row, start=1)]


def study_of(*, sensor: dict[str, Any] | None = None, block: Block | None = None, **protocol: Any) -> Collection:
    """Return a study like the paper's with the given changes; it has no files."""
    info = RunInfo(
        printed=PrintedBlock(block=block or Block.of(1, preset="released"), printer="mine", filament="petg", copy=1),
        levels=(1,),
        protocol=Protocol().changed(**{"grid": PressGrid.paper(1.0, "even"), **protocol}),
        grid_spacing="even",
        holder=HolderRim(),
        frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
        slot=0,
        stage={"identity": "stage", "simulated": ""},
        gauge={"identity": "gauge", "simulated": "", "calibration": {}},
        sensor={"name": "TacTip", "simulated": "", "units": "counts", "shape": [480, 640, 3], **(sensor or {})},
    )
    return Collection(runs=(Run(folder=Path("run"), info=info),), run=np.array([0]), number=np.array([1]))


PAPER = study_of()


def graded(cells: list[Cell], study: Collection = PAPER, **options: Any) -> Grade:
    result = grade(cells, study, **options)
    assert len(result) == 1
    return result[0]


def test_the_published_figures_equal_the_paper() -> None:
    assert list(published.PAPER_VARIANCE) == list(SELECTED) == list(published.PAPER_ROW_NAMES)
    assert published.PAPER_VARIANCE[ENDER] == (2.60, 10.36, 12.12, 10.75, 7.026, 8.28)
    assert published.PAPER_VARIANCE[BAMBU] == (2.80, 2.64, 3.61, 3.67, 3.63, 3.51)
    assert published.PAPER_VARIANCE[RESIN] == (2.31, 2.11, 2.8, 3.06, 3.32, 3.14)
    unseen = {(row.model, row.train_on): row.unseen for row in published.CLASSIFICATION}
    assert list(unseen.values()) == [31.4, 33.21, 63.98, 53.73, 70.66, 61.41]
    assert {row.train_on for row in published.CLASSIFICATION} == set(SELECTED)
    assert published.FLOOR == 2.6
    assert published.PAPER_FLOORS["standard deviation"] == pytest.approx(6.76)


def differences(result: Grade) -> list[list[str | None]]:
    """Return the verdicts for each texture against each of the paper's rows."""
    return [[comparison.ours_is for comparison in texture.published] for texture in result.textures]


def test_an_interval_below_all_figures_is_as_consistent() -> None:
    result = graded(like(published.PAPER_VARIANCE[RESIN], 0.3, 0.9))
    assert differences(result) == [["less"] * 3] * 6
    resin = result.verdicts[2]
    assert (resin.printer, resin.filament, resin.verdict) == (*RESIN, "repeats as well, or better")
    assert (resin.less, resin.more, resin.unclear) == ((1, 2, 3, 4, 5, 6), (), ())
    assert resin.text == "Form 3 resin: repeats as well, or better (less: 1, 2, 3, 4, 5, 6)"


def test_verdicts_are_monotone_in_the_variance() -> None:
    """With the same relative intervals, a larger variance of one texture never gets a better verdict."""
    words = (
        ("less", "unclear", "more"),
        ("repeats as well, or better", "not enough data", "varies more", "repeats less"),
    )
    for noise_alone, low, high in ((0.1, 0.7, 1.6), (2.0, 0.5, 3.0), (None, 0.9, 1.1)):
        ranks = []
        for variance in np.geomspace(0.3, 40.0, 60):
            cells = like(published.PAPER_VARIANCE[BAMBU], 0.3, 0.9)
            cells[2] = cell(3, low * variance, high * variance, variance=variance, noise_alone=noise_alone)
            result = graded(cells)
            of_texture = [words[0].index(str(compared.ours_is)) for compared in result.textures[2].published]
            verdicts = [judgement.verdict for judgement in result.verdicts]
            ranks.append(of_texture + [next(i for i, w in enumerate(words[1]) if v.startswith(w)) for v in verdicts])
        assert (np.diff(ranks, axis=0) >= 0).all() and np.ptp(ranks, axis=0).min() > 0


def test_an_interval_above_a_figure_is_less_consistent() -> None:
    ender, bambu, _ = graded(like(published.PAPER_VARIANCE[ENDER], 0.5, 0.8)).verdicts
    assert ender.verdict == "repeats as well, or better"
    assert bambu.verdict == "repeats less well"
    assert (bambu.less, bambu.more, bambu.unclear) == ((1,), (2, 3, 4, 6), (5,))
    assert bambu.at_least == pytest.approx(0.5 * 10.36 / 2.64)
    assert bambu.at_most == pytest.approx(0.8 * 7.026 / 3.63)
    assert bambu.text == (
        "Bambu P1P PLA-: repeats less well (more: 2, 3, 4, 6, at least 2 times as much; less: 1; unclear: 5, up to 1.5 "
        "times as much)"
    )


@pytest.mark.parametrize(
    ("noise", "verdict"),
    [
        (1.0, "repeats less well"),
        (3.0, "varies more, but the sensor's noise may explain it"),
        (None, "varies more, but without a noise floor the reason is unknown"),
    ],
)
def test_noise_is_not_attributed_to_the_prints(noise: float | None, verdict: str) -> None:
    resin = graded([cell(1, 4.0, 5.0, noise_alone=noise)]).verdicts[2]
    assert (resin.verdict, resin.more) == (verdict, (1,))


def test_an_interval_around_a_figure_gives_no_verdict() -> None:
    bambu = graded(like(published.PAPER_VARIANCE[BAMBU], 0.5, 4.0)).verdicts[1]
    assert bambu.verdict == "not enough data" and bambu.unclear == (1, 2, 3, 4, 5, 6)
    assert bambu.at_most == pytest.approx(4.0) and bambu.at_least is None


def test_figures_of_other_numbers_of_repeats_are_converted_to_two() -> None:
    assert [to_two_repeats(repeats) for repeats in (2, 3, 6)] == pytest.approx([1.0, 0.75, 0.6])
    two, five = (graded(like(published.PAPER_VARIANCE[RESIN], 1.1, 1.5), study_of(repeats=n)) for n in (2, 5))
    assert two.textures[0].published[2].ours_is == "more"
    assert five.textures[0].published[2].ours_is == "less"
    assert five.textures[0].published[2].ratio == pytest.approx((1.1 * 0.625, 1.5 * 0.625))


def test_both_sides_of_a_ratio_have_the_same_divisor() -> None:
    """Two repeats of pure noise of variance 5 have a variance of 2.5 with ddof 0, so the prints add nothing."""
    noise = graded([cell(1, 2.4, 2.6, variance=2.5, floor=5.0, noise_alone=2.5)])
    assert noise.verdicts[2].verdict == "varies more, but the sensor's noise may explain it"
    assert any("Up to 100 % of the figure is noise" in text for text in noise.limits)
    half = graded([cell(1, 9.0, 11.0, variance=10.0, floor=8.0, noise_alone=4.0)])
    assert half.verdicts[2].verdict == "repeats less well"
    assert not any("of the figure is noise" in text for text in half.limits)


def test_one_print_has_no_verdict_but_a_reason() -> None:
    result = graded([cell(i, None, None, prints=1) for i in range(1, 7)])
    assert differences(result) == [[None] * 3] * 6
    assert [verdict.text for verdict in result.verdicts][2] == "Form 3 resin: no interval"
    assert any(
        text.startswith("There is only one print of textures 1, 2, 3, 4, 5, 6. Other prints may")
        for text in result.limits
    )


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"sensor": {"simulated": "simulated TacTip"}}, "The data are simulated (sensor: simulated TacTip)"),
        ({"contact": "depth"}, "were pressed to a depth"),
        ({"forces_n": (0.5, 1.0), "bands_n": (0.1, 0.1)}, "The forces (0.5, 1 N) are not the paper's"),
        ({"sensor": {"shape": [240, 320, 3]}}, "The images have 240 x 320 x 3"),
        ({"grid": PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0))}, "The positions are not those"),
        ({"block": Block.of(1, preset="paper")}, "The blocks have preset paper"),
        ({"block": Block.of(1, preset="released", scale=2.0)}, "at scale 2"),
        ({"repeats": 5}, "5 repeats at each position"),
    ],
)
def test_differences_from_the_paper_are_reported(changes: dict[str, Any], sentence: str) -> None:
    cells = like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9)
    assert not any(sentence in text for text in graded(cells).limits)
    assert any(sentence in text for text in graded(cells, study_of(**changes)).limits)


def test_a_missing_noise_floor_is_reported() -> None:
    cells = like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9, floor=None, floor_from="", noise_alone=None)
    assert any("There is no noise floor" in text for text in graded(cells).limits)


def test_the_papers_unknown_noise_floor_is_reported_for_a_comparable_study() -> None:
    limits = graded(like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9)).limits
    assert len(limits) == 3
    assert "2.6 counts^2 if it is a variance or 6.8 counts^2 if it is a standard deviation" in limits[1]


def test_other_units_are_not_compared() -> None:
    result = graded(like(published.PAPER_VARIANCE[RESIN], 0.3, 0.9), study_of(sensor={"units": "kPa", "shape": [16]}))
    assert differences(result) == [[None] * 3] * 6 and result.units == "kPa^2"
    assert {verdict.verdict for verdict in result.verdicts} == {"another unit"}
    assert not any("The published figures" in text for text in result.limits)


def test_a_figure_that_is_mostly_noise_is_reported() -> None:
    cells = like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9)
    cells[1] = replace(cells[1], noise_alone=0.8 * cells[1].variance)
    assert any("Up to 80 % of the figure is noise (texture 2)" in text for text in graded(cells).limits)


def test_missing_and_own_textures_are_reported() -> None:
    result = graded([cell(2, 0.5, 1.0), cell("hex", 0.5, 1.0)])
    assert [texture.texture for texture in result.textures] == [2]
    assert "Not pressed: textures 1, 3, 4, 5, 6." in result.limits
    assert "Not compared, because not in the paper: hex." in result.limits


def test_each_printer_and_filament_has_a_grade_for_its_force_level() -> None:
    result = grade([cell(1, 0.5, 1.0, printer=printer, force_level=2) for printer in ("b", "a")], PAPER)
    assert [grade.printer for grade in result] == ["b", "a"]
    assert all(grade.force_level == 2 and len(grade.textures) == 1 for grade in result)
    assert any("The force level is 2, and the published figures are for level 1" in text for text in result[0].limits)


def test_data_that_cannot_be_graded_are_refused() -> None:
    with pytest.raises(InputError, match="protocol = 'paper': must be as-published"):
        grade([cell(1, 0.5, 1.0, quantity="prints and repeats")], PAPER)
    with pytest.raises(InputError, match="none of them is one of the paper's six"):
        grade([cell("hex", 0.5, 1.0)], PAPER)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a simulated study of two textures with three prints from each of two printers and no stationary frames."""
    folder = tmp_path_factory.mktemp("study")
    write_study(folder, copies=3, simulated="simulated TacTip", still=0)
    return folder


def test_the_command_prints_a_table_verdicts_and_reasons(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grade", str(study)]) == 0
    out = capsys.readouterr().out
    assert out.endswith(f"\nNext: tacbench classify {study}\n")
    assert "ender-3, pla-plus: force level 1" in out
    assert "bambu-p1p, pla-minus: force level 1" in out
    for sentence in (
        "The data are simulated (sensor: simulated TacTip)",
        "There are 3 prints, and 6 in the paper",
        "There is no noise floor",
        "Not pressed: textures 3, 4, 5, 6.",
        "The positions are not those of the paper's grid",
        "The images have 24 x 32",
    ):
        assert out.count(sentence) == 2


def test_the_command_prints_json(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["grade", str(study), "--force-level", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["simulated"] == ["sensor: simulated TacTip"] and document["units"] == "counts"
    assert [(row["printer"], row["force_level"]) for row in document["grades"]] == [("ender-3", 1), ("bambu-p1p", 1)]
    first, second = document["grades"][0]["textures"]
    assert (first["texture"], second["texture"]) == (1, 2)
    assert first["low"] < first["variance"] < first["high"]
    resin = first["published"][2]
    assert (resin["printer"], resin["filament"], resin["variance"]) == ("form-3", "grey-v4", 2.31)
    assert resin["ours_is"] in ("less", "more", "unclear")
    verdict = document["grades"][0]["verdicts"][2]
    assert verdict["printer"] == "form-3" and sorted(verdict["less"] + verdict["more"] + verdict["unclear"]) == [1, 2]


@pytest.mark.parametrize(
    ("options", "message"),
    [(["--force-level", "two"], "force level = 'two'"), (["--jobs", "0"], "jobs = 0: must be 1 or more")],
)
def test_invalid_options_are_refused_by_name(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["grade", str(tmp_path), *options]) == 2
    assert message in capsys.readouterr().err


def test_excluded_frames_are_reported() -> None:
    left_out = ("run/a.png: is damaged", "run/b.png: is damaged")
    limits = graded(like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9), left_out=left_out).limits
    assert limits[0] == "2 frames could not be used; the first is run/a.png: is damaged."
