"""Test the variance and classification of markers against their true displacements."""

from __future__ import annotations

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from helpers.dots import REST, SHAPE, dots_at_rest, dots_displacement, dots_image
from helpers.studies import write_study
from sklearn.base import clone

from tacbench_cad import lab
from tacbench_cad.cli import main
from tacbench_cad.extensions.markers import MarkerDisplacements
from tacbench_cad.lab.analysis.feature import feature_of
from tacbench_cad.lab.analysis.figures import save, styled
from tacbench_cad.lab.analysis.variance.map_figures import exhibit_figure
from tacbench_cad.lab.runs import write_png
from tacbench_cad.lab.runs.press_table import runs_of
from tacbench_cad.lab.study.presses import plan_presses
from tacbench_cad.util.errors import CheckFailedError, InputError


@pytest.fixture(scope="module")
def pressed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dots")
    write_study(folder, shape=SHAPE, image=dots_image, resting=dots_at_rest, levels=(1, 2))
    return folder


@pytest.fixture(scope="module")
def result(pressed: Path) -> lab.Variance:
    return lab.variance(lab.read(pressed), MarkerDisplacements())


def test_variance_of_markers_equals_that_of_their_true_displacements(pressed: Path, result: lab.Variance) -> None:
    assert isinstance(result.feature, MarkerDisplacements)
    assert result.feature.markers_.count == len(REST)
    assert result.units == "px"
    assert result.outside is None
    runs = runs_of(lab.read(pressed))
    for cell in result.table[result.table["force_level"] != "all"].itertuples():
        truth = []
        for position in (1, 2, 3, 4):
            displacements = [
                dots_displacement(run.info.printed, press)
                for run in runs
                if (run.info.printed.printer, run.info.printed.texture) == (cell.printer, cell.texture)
                for press in plan_presses(run.info.protocol, run.info.levels, run.info.printed.name)
                if (press.force_level, press.position) == (cell.force_level, position)
            ]
            truth.append(np.var(displacements, axis=0).mean())
        assert cell.variance == pytest.approx(np.mean(truth), rel=0.1)
    assert len(result.means) == 2 * 4
    mean = result.means[2, ("ender-3_pla-plus", "texture-1")].reshape(-1, 2)
    reference = result.feature.markers_.first.reference_px
    nearest = np.argmin(np.hypot(*(reference[:, None] - REST[None]).transpose(2, 0, 1)), axis=1)
    run = next(run for run in runs if run.info.printed.combination == "ender-3_pla-plus")
    press = plan_presses(run.info.protocol, run.info.levels, run.info.printed.name)[-1]
    assert np.corrcoef(mean[:, 0], dots_displacement(run.info.printed, press)[nearest, 0])[0, 1] > 0.98


def test_worker_processes_give_the_same_marker_table_and_a_figure(
    pressed: Path, result: lab.Variance, tmp_path: Path
) -> None:
    together = lab.variance(lab.read(pressed), MarkerDisplacements(), jobs=2)
    assert together.table["variance"].tolist() == pytest.approx(result.table["variance"].tolist())
    with styled():
        for path in save(exhibit_figure(together), tmp_path / "displacements", ()):
            assert path.stat().st_size > 5000


def test_the_feature_is_a_transformer_of_scikit_learn(pressed: Path) -> None:
    presses = lab.read(pressed)[:6]
    feature = MarkerDisplacements(sigma_px=3.0).fit(presses)
    numbers = feature.transform(presses)
    assert numbers.shape == (6, 2 * len(REST))
    assert np.array_equal(pickle.loads(pickle.dumps(feature)).transform(presses), numbers)
    assert clone(feature).get_params() == {"sigma_px": 3.0, "threshold": None, "dark": None, "roi": None}
    assert feature.get_feature_names_out().tolist()[-1] == "markers_97"
    with pytest.raises(InputError, match="need run folders"):
        MarkerDisplacements().fit(presses.assign(folder=None))


def test_the_results_say_where_the_displacements_begin(tmp_path: Path) -> None:
    size = {"textures": (1,), "prints": (("form-3", "grey-v4"),), "levels": (1,)}
    folders = write_study(tmp_path, shape=SHAPE, image=dots_image, resting=dots_at_rest, **size)
    for origin in ("position without contact", "median position"):
        result = lab.variance(lab.read(tmp_path), MarkerDisplacements())
        with styled():
            labels = [axes.get_ylabel() for axes in exhibit_figure(result).axes]
        assert any(label.startswith(f"displacement from the {origin} (px)") for label in labels)
        assert any(f"49 markers from its {origin}, mean" in note for note in result.notes)
        for folder in folders:  # without the frames at rest, as in an imported run
            table = folder / "references" / "references.csv"
            table.write_text(table.read_text().splitlines()[0] + "\n")


@pytest.mark.usefixtures("no_figures")
def test_the_commands_report_what_was_analysed(
    pressed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["variance", str(pressed), "--features", "markers", "-o", str(tmp_path / "out"), "--jobs", "1"]) == 0
    shown = capsys.readouterr().out
    assert "px^2; displacement of markers" in shown
    assert "49 markers" in shown
    assert (tmp_path / "out" / "displacements.png").is_file()
    rows = (tmp_path / "out" / "displacements.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 4 * 49
    assert main(["variance", str(pressed), "--roi", "rect:10,10,150,150", "--json", "--jobs", "1"]) == 0
    assert json.loads(capsys.readouterr().out)["roi"] == "rect:10,10,150,150"
    report = ["report", str(pressed), "--no-classify", "--features", "markers", "--jobs", "1", "-o"]
    assert main([*report, str(tmp_path / "report.html")]) == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "displacements of 49 markers (px)" in page
    assert "Displacements of the markers at the largest force" in page
    command = ["classify", str(pressed), "--features", "markers", "--trials", "1", "--hold-out", "copy", "--jobs", "1"]
    assert main([*command, "-o", str(tmp_path / "classes")]) == 0
    assert "100.0" in capsys.readouterr().out


def test_regions_and_markers_are_drawn_and_regions_stored(
    pressed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["markers", str(pressed), "-o", str(tmp_path / "pictures")]) == 0
    assert "49 bright markers" in capsys.readouterr().out
    assert len(list((tmp_path / "pictures").glob("*_markers.png"))) == 8
    assert main(["roi", str(pressed), "--roi", "circle:100,90,80", "-o", str(tmp_path / "pictures")]) == 0
    assert "stored with 8 runs" in capsys.readouterr().out
    assert main(["roi", str(pressed), "--roi", "none", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["region"] is None
    assert not list(pressed.glob("*/roi.json"))


def test_a_frame_without_markers_is_excluded(pressed: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(next(pressed.iterdir()), tmp_path / "run"))
    feature = MarkerDisplacements().fit(lab.read(run))
    write_png(run / "black.png", np.zeros(SHAPE, dtype=np.uint8))
    with pytest.raises(CheckFailedError, match="0 of 49 markers were found"):
        feature.markers_.displacement_px(run, run / "black.png")


def test_settings_of_the_markers_follow_the_name() -> None:
    feature = feature_of("markers:sigma_px=3.5,dark=true", colour=True)
    assert isinstance(feature, MarkerDisplacements)
    assert (feature.sigma_px, feature.threshold, feature.dark) == (3.5, None, True)
    for wrong in ("markers:sigma_px=wide", "markers:learned=1", "marker"):
        with pytest.raises(InputError):
            feature_of(wrong)


def test_settings_that_are_not_allowed_are_refused(pressed: Path) -> None:
    with pytest.raises(InputError, match="sigma_px"):
        MarkerDisplacements(sigma_px=99).fit(lab.read(pressed))
