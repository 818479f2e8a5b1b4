"""Test the grade: published figures, verdicts, reasons, and the command."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from helpers.studies import write_study

from tacbench_cad import lab
from tacbench_cad.cli import main
from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.study_design import Design, keyed
from tacbench_cad.lab.analysis.variance.cells import FRAMES
from tacbench_cad.lab.analysis.variance.grade_limits import to_two_repeats
from tacbench_cad.lab.analysis.variance.grading import Grades, graded
from tacbench_cad.lab.analysis.variance.result import Variance
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.names import SELECTED
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError

ENDER, BAMBU, RESIN = published.PAPER_VARIANCE


def cell(texture: int | str, low: float = math.nan, high: float = math.nan, **changes: Any) -> dict[str, Any]:
    """Return a row of the variance table."""
    values: dict[str, Any] = {
        "printer": "mine",
        "filament": "petg",
        "texture": f"texture-{texture}" if isinstance(texture, int) else texture,
        "force_level": 1,
        "variance": 1.0 if math.isnan(low) else (low + high) / 2.0,
        "floor": 0.2,
        "noise_alone": 0.1,
        "low": low,
        "high": high,
        "prints": 6,
        "presses": 900,
        "floor_from": FRAMES,
        "published": math.nan,
    }
    return {**values, **changes}


def like(row: tuple[float, ...], low: float, high: float, **changes: Any) -> list[dict[str, Any]]:
    return [cell(i, low * value, high * value, **changes) for i, value in enumerate(row, start=1)]


def study_of(*, sensor: dict[str, Any] | None = None, block: Block | None = None, **protocol: Any) -> Design:
    """Return the design of a study like the paper's with the given changes; it has no files."""
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
    press = {"run": "run", "press": 1, "frame": "image_1.png", "sensor": "TacTip", "units": info.sensor["units"]}
    press |= {"contact": info.protocol.targets.contact, "simulated": "; ".join(info.simulated) or None, "planned": True}
    run = Run(folder=Path("run"), info=info)
    return Design(presses=keyed(pd.DataFrame([press])), runs=(run,), unknown=frozenset())


PAPER = study_of()


def graded_cells(cells: list[dict[str, Any]], study: Design = PAPER, **changes: Any) -> Grades:
    given: dict[str, Any] = {"protocol": "as-published", "left_out": (), **changes}
    table = {"variance": pd.DataFrame(cells)}
    nothing: dict[str, Any] = {"maps": {}, "means": {}, "outside": None}
    return graded(Variance(design=study, feature=lab.Pixels(), ddof=0, seed=0, tables=table, **nothing, **given))


def verdict(grades: Grades, row: tuple[str, str]) -> pd.Series:
    """Return the verdict for one of the paper's rows."""
    return grades.answers.set_index(["published_printer", "published_filament"]).loc[row]


def limits(grades: Grades) -> tuple[str, ...]:
    (of_printer,) = grades.limits.values()
    return of_printer


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


def test_an_interval_below_all_figures_is_as_consistent() -> None:
    result = graded_cells(like(published.PAPER_VARIANCE[RESIN], 0.3, 0.9))
    assert len(result.table) == 6 * 3 and set(result.table["ours_is"]) == {"less"}
    resin = verdict(result, RESIN)
    assert (resin["less"], resin["more"], resin["unclear"]) == ("1, 2, 3, 4, 5, 6", "", "")
    text = "Form 3 resin: repeats as well, or better (less: 1, 2, 3, 4, 5, 6)"
    assert resin["text"] == result.verdicts(("mine", "petg"))[2] == text


def test_verdicts_are_monotone_in_the_variance() -> None:
    """With the same relative intervals, a larger variance of one texture never gets a better verdict."""
    words = (
        ("less", "unclear", "more"),
        ("repeats as well, or better", "not enough data", "varies more", "repeats less"),
    )
    for noise_alone, low, high in ((0.1, 0.7, 1.6), (2.0, 0.5, 3.0), (math.nan, 0.9, 1.1)):
        ranks = []
        for variance in np.geomspace(0.3, 40.0, 16):
            cells = like(published.PAPER_VARIANCE[BAMBU], 0.3, 0.9)
            cells[2] = cell(3, low * variance, high * variance, variance=variance, noise_alone=noise_alone)
            result = graded_cells(cells)
            of_texture = result.table.loc[result.table["texture"] == 3, "ours_is"].map(words[0].index)
            verdicts = result.answers["verdict"]
            ranks.append([*of_texture, *(next(i for i, w in enumerate(words[1]) if v.startswith(w)) for v in verdicts)])
        assert (np.diff(ranks, axis=0) >= 0).all() and np.ptp(ranks, axis=0).min() > 0


def test_an_interval_above_a_figure_is_less_consistent() -> None:
    result = graded_cells(like(published.PAPER_VARIANCE[ENDER], 0.5, 0.8))
    assert verdict(result, ENDER)["verdict"] == "repeats as well, or better"
    bambu = verdict(result, BAMBU)
    assert bambu["at_least"] == pytest.approx(0.5 * 10.36 / 2.64)
    assert bambu["at_most"] == pytest.approx(0.8 * 7.026 / 3.63)
    assert bambu["text"] == (
        "Bambu P1P PLA-: repeats less well (more: 2, 3, 4, 6, at least 2 times as much; less: 1; unclear: 5, up to 1.5 "
        "times as much)"
    )


@pytest.mark.parametrize(
    ("noise", "words"),
    [
        (1.0, "repeats less well"),
        (3.0, "varies more, but the sensor's noise may explain it"),
        (math.nan, "varies more, but without a noise floor the reason is unknown"),
    ],
)
def test_noise_is_not_attributed_to_the_prints(noise: float, words: str) -> None:
    resin = verdict(graded_cells([cell(1, 4.0, 5.0, noise_alone=noise)]), RESIN)
    assert (resin["verdict"], resin["more"]) == (words, "1")


def test_an_interval_around_a_figure_gives_no_verdict() -> None:
    bambu = verdict(graded_cells(like(published.PAPER_VARIANCE[BAMBU], 0.5, 4.0)), BAMBU)
    assert bambu["verdict"] == "not enough data" and bambu["unclear"] == "1, 2, 3, 4, 5, 6"
    assert bambu["at_most"] == pytest.approx(4.0) and math.isnan(bambu["at_least"])


def test_figures_of_other_numbers_of_repeats_are_converted_to_two() -> None:
    assert [to_two_repeats(repeats) for repeats in (2, 3, 6)] == pytest.approx([1.0, 0.75, 0.6])
    cells = like(published.PAPER_VARIANCE[RESIN], 1.1, 1.5)
    two, five = (graded_cells(cells, study_of(repeats=n)).table.iloc[2] for n in (2, 5))
    assert (two["ours_is"], five["ours_is"]) == ("more", "less")
    assert (five["ratio_low"], five["ratio_high"]) == pytest.approx((1.1 * 0.625, 1.5 * 0.625))


def test_both_sides_of_a_ratio_have_the_same_divisor() -> None:
    """Two repeats of pure noise of variance 5 have a variance of 2.5 with ddof 0, so the prints add nothing."""
    noise = graded_cells([cell(1, 2.4, 2.6, variance=2.5, floor=5.0, noise_alone=2.5)])
    assert verdict(noise, RESIN)["verdict"] == "varies more, but the sensor's noise may explain it"
    assert any("Up to 100 % of the figure is noise (texture 1)" in text for text in limits(noise))
    half = graded_cells([cell(1, 9.0, 11.0, variance=10.0, floor=8.0, noise_alone=4.0)])
    assert verdict(half, RESIN)["verdict"] == "repeats less well"
    assert not any("of the figure is noise" in text for text in limits(half))


def test_one_print_has_no_verdict_but_a_reason() -> None:
    result = graded_cells([cell(i, prints=1) for i in range(1, 7)])
    assert set(result.table["ours_is"]) == {""} and verdict(result, RESIN)["text"] == "Form 3 resin: no interval"
    words = "There is only one print of textures 1, 2, 3, 4, 5, 6. Other prints may"
    assert any(text.startswith(words) for text in limits(result))


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
    assert not any(sentence in text for text in limits(graded_cells(cells)))
    assert any(sentence in text for text in limits(graded_cells(cells, study_of(**changes))))


def test_noise_floors_missing_in_the_study_and_without_unit_in_the_paper_are_reported() -> None:
    cells = like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9, floor=math.nan, floor_from="", noise_alone=math.nan)
    assert any("There is no noise floor" in text for text in limits(graded_cells(cells)))
    comparable = limits(graded_cells(like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9)))
    assert len(comparable) == 3
    assert "2.6 counts^2 if it is a variance or 6.8 counts^2 if it is a standard deviation" in comparable[1]


def test_other_units_are_not_compared() -> None:
    cells = like(published.PAPER_VARIANCE[RESIN], 0.3, 0.9)
    result = graded_cells(cells, study_of(sensor={"units": "kPa", "shape": [16]}))
    assert set(result.table["ours_is"]) == {""} and result.document()["units"] == "kPa^2"
    assert set(result.answers["verdict"]) == {"another unit"}
    assert not any("The published figures" in text for text in limits(result))


def test_missing_and_own_textures_are_reported() -> None:
    result = graded_cells([cell(2, 0.5, 1.0), cell("hex", 0.5, 1.0)])
    assert set(result.table["texture"]) == {2}
    assert "Not pressed: textures 1, 3, 4, 5, 6." in limits(result)
    assert "Not compared, because not in the paper: hex." in limits(result)


def test_each_printer_and_filament_has_a_grade_for_its_force_level() -> None:
    cells = [cell(1, 0.5, 1.0, printer=printer, force_level=2) for printer in ("b", "a")]
    result = graded_cells([*cells, cell("hex", 0.5, 1.0, printer="c")])
    assert list(result.limits) == [("b", "petg"), ("a", "petg")]
    titles = [shown.title for _, shown in result.shown()]
    assert [title.partition(";")[0] for title in titles] == ["b, petg: force level 2", "a, petg: force level 2"]
    words = "The force level is 2, and the published figures are for level 1"
    assert any(words in text for text in result.limits["b", "petg"])


def test_data_that_cannot_be_graded_are_refused() -> None:
    with pytest.raises(InputError, match="protocol = 'paper': must be as-published"):
        graded_cells([cell(1, 0.5, 1.0)], protocol="paper")
    with pytest.raises(InputError, match="none of them is one of the paper's six"):
        graded_cells([cell("hex", 0.5, 1.0)])


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


def test_the_command_prints_json_and_the_function_writes_the_tables(
    study: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["grade", str(study), "--force-level", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["simulated"] == ["sensor: simulated TacTip"] and document["units"] == "counts^2"
    first, last = document["grade"][0], document["grade"][-1]
    assert (first["printer"], first["force_level"], first["texture"]) == ("ender-3", 1, 1)
    assert (last["printer"], last["texture"], last["published_printer"], last["published"]) == (
        *("bambu-p1p", 2, "form-3", 2.11),
    )
    assert first["low"] < first["variance"] < first["high"] and first["ours_is"] in ("less", "more", "unclear")
    assert len(document["verdicts"]) == 2 * 3 and len(document["limits"]) == 2
    for path, rows in zip(lab.grade(lab.read(study)).save(tmp_path), (12, 6), strict=True):
        assert len(pd.read_csv(path)) == rows


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
    result = graded_cells(like(published.PAPER_VARIANCE[RESIN], 0.5, 0.9), left_out=left_out)
    assert limits(result)[0] == "2 frames could not be used; the first is run/a.png: is damaged."
