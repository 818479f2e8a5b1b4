"""Compare the quantity of the paper's printed variances with the notebooks' loop over the raw images."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from helpers.studies import write_study

from tacbench_cad import lab
from tacbench_cad.cli import main
from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.pixels import as_published
from tacbench_cad.lab.analysis.variance.cells import cells_of
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.press_table import read_frame
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


def notebook_variance(study: pd.DataFrame, key: tuple[str, str], level: int) -> float:
    """Compute the variance with the notebooks' loop over prints, but without their 8-bit row numbers."""
    mine = of_cell(study, key)
    frames = []
    for _, of_print in mine[mine["force_level"] == level].sort_values(["repeat", "position"]).groupby("copy"):
        images = np.array([notebook_grey(read_frame(path)) for path in of_print["frame"]])
        frames.append(images.reshape(2, len(images) // 2, *images.shape[1:]))
    return float(np.var(np.array(frames), axis=1).mean())


def of_cell(study: pd.DataFrame, key: tuple[str, str]) -> pd.DataFrame:
    return study[(study["printer"] + "_" + study["filament"] == key[0]) & (study["texture"] == key[1])]


@pytest.fixture(scope="module")
def study(make_study: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    return make_study(prints=(("ender-3", "pla-plus"), BAMBU), copies=3, levels=(1, 2), image=coloured, shape=SHAPE)


@pytest.fixture(scope="module")
def result(study: pd.DataFrame) -> lab.Variance:
    return lab.variance(study, protocol="as-published")


def test_each_figure_equals_the_notebooks_loop(study: pd.DataFrame, result: lab.Variance) -> None:
    cells = cells_of(result.table)
    assert len(cells) == 4
    for (level, key), cell in cells.items():
        assert cell.variance == pytest.approx(notebook_variance(study, key, 1), rel=1e-9)
        assert (level, cell.prints, cell.quantity) == (1, 3, "repeats of one print")
        assert cell.low < cell.variance < cell.high
    means = result.tables["positions"].groupby(["printer", "texture"])["variance"].mean()
    assert means["ender-3", "texture-1"] == pytest.approx(cells[1, ("ender-3_pla-plus", "texture-1")].variance)


def test_another_level_is_used_if_it_is_the_only_one(study: pd.DataFrame) -> None:
    result = lab.variance(study[study["force_level"] == 2], protocol="as-published")
    key = ("bambu-p1p_pla-minus", "texture-2")
    assert cells_of(result.table)[2, key].variance == pytest.approx(notebook_variance(study, key, 2), rel=1e-9)


def test_noise_and_figure_have_the_same_divisor(result: lab.Variance) -> None:
    cells = result.table
    np.testing.assert_allclose(cells["noise_alone"], cells["floor"] / 2.0)
    np.testing.assert_allclose(cells["unbiased"], 2.0 * cells["variance"])
    assert set(cells["floor_from"]) == {"stationary frames"}


def test_the_papers_figure_is_shown_for_this_quantity_only(study: pd.DataFrame, result: lab.Variance) -> None:
    cells = cells_of(result.table)
    assert cells[1, ("bambu-p1p_pla-minus", "texture-2")].published == 2.64
    assert math.isnan(cells[1, ("ender-3_pla-plus", "texture-1")].published)
    assert lab.variance(study).table["published"].isna().all()


def test_a_missing_press_excludes_its_print_at_that_position(study: pd.DataFrame) -> None:
    key = ("ender-3_pla-plus", "texture-1")
    mine = of_cell(study, key)
    gone = mine.query("force_level == 1 and copy == 2 and position == 3 and repeat == 1").index
    less = lab.variance(study.drop(gone), protocol="as-published").table
    pairs = mine.drop(gone).query("force_level == 1").groupby(["copy", "position"])["frame"]
    values = [
        np.var([notebook_grey(read_frame(path)) for path in of], axis=0).mean() for _, of in pairs if len(of) == 2
    ]
    assert len(values) == 11
    assert cells_of(less)[1, key].variance == pytest.approx(np.mean(values), rel=1e-9)


def test_samples_with_one_repeat_or_unknown_prints_are_refused(study: pd.DataFrame) -> None:
    with pytest.raises(InputError, match="no print was pressed twice at one position"):
        lab.variance(study[study["repeat"] == 1], protocol="as-published")
    unknown = study.assign(copy=None)
    with pytest.raises(InputError, match="the published quantity: needs the print of every sample"):
        lab.variance(unknown, protocol="as-published")
    assert set(lab.variance(unknown).answers["answer"]) == {"cannot be said: the print of each sample is unknown"}


def test_without_stationary_frames_there_is_no_noise_floor(make_study: Callable[..., pd.DataFrame]) -> None:
    result = lab.variance(make_study(still=0, textures=(1,)), protocol="as-published")
    assert result.table[["floor", "noise_alone"]].isna().all(axis=None) and set(result.table["floor_from"]) == {""}
    assert any("there is no noise floor" in line for line in result.warnings)


@pytest.mark.parametrize("settings", [{"feature": lab.Pixels()}, {"ddof": 1}, {"register": True}])
def test_other_settings_are_refused(study: pd.DataFrame, settings: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="has fixed settings: grey images at 40 % of their size and ddof 0"):
        lab.variance(study, protocol="as-published", **settings)
    with pytest.raises(InputError, match="protocol"):
        lab.variance(study, protocol="printed")  # type: ignore[arg-type]


def test_grey_is_not_rounded_and_has_the_notebooks_weights() -> None:
    image = np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)
    np.testing.assert_allclose(as_published().numbers(image), notebook_grey(image), rtol=1e-12)
    assert as_published().numbers(image[..., 0]).dtype == np.float64
    pure = np.zeros(SHAPE, np.uint8)
    pure[..., 2] = 100  # OpenCV stores red last
    assert lab.Pixels(notebook=True).numbers(pure)[0, 0] == pytest.approx(11.4)
    assert lab.Pixels().numbers(pure)[0, 0] == 30


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
        *("positions.csv", "variance.csv", "variance.pdf", "variance.png", "variance_settings.json"),
    ]
    assert pd.read_csv(out / "variance.csv")["published"].tolist() == [2.8, 2.64]
    assert main(["variance", runs]) == 0
    screen = capsys.readouterr().out
    assert "2.64" not in screen and "tacbench variance --protocol as-published" in screen
    assert main(["variance", runs, "--protocol", "as-published", "--force-level", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["protocol"] == "as-published" and {row["force_level"] for row in document["variance"]} == {2}
    for options in (["--colour"], ["--ddof", "1"], ["--register"]):
        assert main(["variance", runs, "--protocol", "as-published", *options]) == 2
        assert "has fixed settings" in capsys.readouterr().err


def test_the_notebooks_output_is_the_printed_row_with_more_digits() -> None:
    saved = (2.80017674, 2.64039746, 3.61887302, 3.6796849, 3.63699284, 3.51960279)
    assert tuple(int(100.0 * value) / 100.0 for value in saved) == published.PAPER_VARIANCE[BAMBU]
