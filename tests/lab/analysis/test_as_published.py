"""Compare the quantity of the paper's printed variances with the notebooks' loop over the raw images."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.studies import write_study

from tacbench_cad.cli import main
from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.pixels import AS_PUBLISHED, Pixels
from tacbench_cad.lab.analysis.variance.result import VarianceResult
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.lab.analysis.variance.view import VarianceView
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: An image size of which 40 % is not a whole number.
SHAPE = (34, 47, 3)
BAMBU = ("bambu-p1p", "pla-minus")


def coloured(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """Return a colour image that depends on the print, with noise that depends on the texture."""
    own = np.random.default_rng(list(f"{printed.name} {press.position}".encode()))
    clean = own.integers(60, 200, SHAPE)
    return np.asarray(clean + rng.normal(0.0, 2.0 + int(printed.object_label), SHAPE)).clip(0, 255).astype(np.uint8)


def notebook_grey(image: Frame) -> Floats:
    """Load an image as the notebooks do."""
    grey = np.dot(image, [0.2989, 0.5870, 0.1140])
    return cv2.resize(grey, (int(0.4 * image.shape[1]), int(0.4 * image.shape[0])), interpolation=cv2.INTER_AREA)


def notebook_variance(study: Collection, combination: str, texture: str, level: int) -> float:
    """Compute the variance with the notebooks' loop over prints, but without their 8-bit row numbers."""
    frames = []
    for copy in np.unique(study.copy):
        here = (study.combination == combination) & (study.texture == texture) & (study.level == level)
        mine = np.flatnonzero(here & (study.copy == copy))
        order = mine[np.lexsort((study.position[mine], study.repeat[mine]))]
        images = np.array([notebook_grey(study.frame(int(i))) for i in order])
        frames.append(images.reshape(2, len(images) // 2, *images.shape[1:]))
    return float(np.var(np.array(frames), axis=1).mean())


@pytest.fixture(scope="module")
def study(make_study: Callable[..., Collection]) -> Collection:
    return make_study(prints=(("ender-3", "pla-plus"), BAMBU), copies=3, levels=(1, 2), image=coloured, shape=SHAPE)


@pytest.fixture(scope="module")
def result(study: Collection) -> VarianceResult:
    return variance_table(study, protocol="as-published")


def test_each_figure_equals_the_notebooks_loop(study: Collection, result: VarianceResult) -> None:
    assert len(result.cells) == 4
    for cell in result.cells:
        expected = notebook_variance(study, cell.combination, cell.texture, 1)
        assert cell.variance == pytest.approx(expected, rel=1e-9)
        assert (cell.force_level, cell.prints, cell.quantity) == (1, 3, "repeats of one print")
        assert cell.low is not None and cell.high is not None and cell.low < cell.variance < cell.high
    values = result.positions[1, ("ender-3_pla-plus", "texture-1")]
    cell = result.cell(1, "ender-3_pla-plus", "texture-1")
    assert cell is not None and values.mean() == pytest.approx(cell.variance, rel=1e-12)


def test_another_level_is_used_if_it_is_the_only_one(study: Collection) -> None:
    result = variance_table(study.at_level(2), protocol="as-published")
    expected = notebook_variance(study, "bambu-p1p_pla-minus", "texture-2", 2)
    cell = result.cell(2, "bambu-p1p_pla-minus", "texture-2")
    assert cell is not None and cell.variance == pytest.approx(expected, rel=1e-9)


def test_noise_and_figure_have_the_same_divisor(result: VarianceResult) -> None:
    for cell in result.cells:
        assert cell.floor is not None and cell.noise_alone == pytest.approx(cell.floor / 2.0)
        assert cell.unbiased == pytest.approx(2.0 * cell.variance)
        assert cell.floor_from == "stationary frames"


def test_the_papers_figure_is_shown_for_this_quantity_only(study: Collection, result: VarianceResult) -> None:
    figures = {(cell.combination, cell.texture): cell.published for cell in result.cells}
    assert figures["bambu-p1p_pla-minus", "texture-2"] == 2.64
    assert figures["ender-3_pla-plus", "texture-1"] is None
    assert {cell.published for cell in variance_table(study).cells} == {None}


def test_a_missing_press_excludes_its_print_at_that_position(study: Collection, result: VarianceResult) -> None:
    key = ("ender-3_pla-plus", "texture-1")
    gone = (study.combination == key[0]) & (study.texture == key[1]) & (study.level == 1)
    gone &= (study.copy == 2) & (study.position == 3) & (study.repeat == 1)
    less = variance_table(study.chosen(~gone), protocol="as-published").cell(1, *key)
    mine = study.chosen((study.combination == key[0]) & (study.texture == key[1]) & (study.level == 1))
    values = []
    for copy in (1, 2, 3):
        for position in (1, 2, 3, 4):
            pair = np.flatnonzero((mine.copy == copy) & (mine.position == position))
            if (copy, position) != (2, 3):
                values.append(np.var([notebook_grey(mine.frame(int(i))) for i in pair], axis=0).mean())
    assert less is not None and less.variance == pytest.approx(np.mean(values), rel=1e-9)


def test_one_repeat_is_refused(study: Collection) -> None:
    with pytest.raises(InputError, match="no print was pressed twice at one position"):
        variance_table(study.chosen(study.repeat == 1), protocol="as-published")


def test_samples_with_unknown_prints_are_refused(study: Collection, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Collection, "has", lambda self, what: what != "print")
    with pytest.raises(InputError, match="the published quantity: needs the print of every sample"):
        variance_table(study, protocol="as-published")
    answers = VarianceView.of(variance_table(study)).tables["printer_answers"]["answer"]
    assert set(answers) == {"cannot be said: the print of each sample is unknown"}


def test_without_stationary_frames_there_is_no_noise_floor(make_study: Callable[..., Collection]) -> None:
    result = variance_table(make_study(still=0, textures=(1,)), protocol="as-published")
    assert {(cell.floor, cell.floor_from, cell.noise_alone) for cell in result.cells} == {(None, "", None)}
    assert any("there is no noise floor" in line for line in VarianceView.of(result).warnings)


def test_other_settings_are_refused(study: Collection) -> None:
    with pytest.raises(InputError, match="always uses grey images at 40 % of their size and ddof 0"):
        variance_table(study, Pixels(), protocol="as-published")
    with pytest.raises(InputError, match="always uses grey images at 40 % of their size and ddof 0"):
        variance_table(study, protocol="as-published", ddof=1)
    with pytest.raises(InputError, match="protocol"):
        variance_table(study, protocol="printed")  # type: ignore[arg-type]


def test_grey_is_not_rounded_and_has_the_notebooks_weights() -> None:
    image = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    np.testing.assert_allclose(AS_PUBLISHED(image), notebook_grey(image), rtol=1e-12)
    assert AS_PUBLISHED(image[..., 0]).dtype == np.float64
    pure = np.zeros(SHAPE, np.uint8)
    pure[..., 2] = 100  # OpenCV stores red last
    assert Pixels(notebook=True)(pure)[0, 0] == pytest.approx(11.4)
    assert Pixels()(pure)[0, 0] == 30


def test_the_command_shows_the_papers_row_next_to_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_study(tmp_path / "runs", prints=(BAMBU,), levels=(1, 2), image=coloured, shape=SHAPE)
    runs, out = str(tmp_path / "runs"), tmp_path / "out"
    assert main(["variance", runs, "--protocol", "as-published", "-o", str(out)]) == 0
    screen = " ".join(capsys.readouterr().out.split())
    assert (
        "variance of the repeats on one print, 0.08 N (counts^2; grey not rounded, 40 % of the size, ddof 0)" in screen
    )
    assert "the paper 2.8 2.64" in screen and "variance components" not in screen
    assert sorted(path.name for path in out.iterdir() if path.suffix != ".lock") == [
        *("floor_removed.csv", "positions.csv", "variance.csv", "variance.pdf", "variance.png"),
        "variance_settings.json",
    ]
    with (out / "variance.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["published"] for row in rows] == ["2.8", "2.64"]
    assert {row["quantity"] for row in rows} == {"repeats of one print"}
    view = VarianceView.read(out, Collection.open([tmp_path / "runs"]))
    assert [cell.published for cell in view.cells] == [2.8, 2.64] and len(list(view.shown())) == 1
    assert main(["variance", runs]) == 0
    screen = capsys.readouterr().out
    assert "2.64" not in screen and "tacbench variance --protocol as-published" in screen
    assert main(["variance", runs, "--protocol", "as-published", "--force-level", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["protocol"] == "as-published" and {row["force_level"] for row in document["variance"]} == {2}
    for options in (["--colour"], ["--ddof", "1"], ["--register"]):
        assert main(["variance", runs, "--protocol", "as-published", *options]) == 2
        assert "as-published has fixed settings" in capsys.readouterr().err


def test_the_notebooks_output_is_the_printed_row_with_more_digits() -> None:
    saved = (2.80017674, 2.64039746, 3.61887302, 3.6796849, 3.63699284, 3.51960279)
    assert tuple(int(100.0 * value) / 100.0 for value in saved) == published.PAPER_VARIANCE[BAMBU]
