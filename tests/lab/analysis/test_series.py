"""Test analyses of series of moving frames against NumPy on the same arrays."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.dots import SHAPE as DOTS_SHAPE
from helpers.dots import dots_at_rest, dots_displacement, dots_frame, dots_image
from helpers.studies import PRINTERS, SHAPE, noise_image, write_study

from tacbench_cad import lab
from tacbench_cad.cli import main
from tacbench_cad.lab.analysis.feature import feature_of
from tacbench_cad.lab.analysis.figures import styled
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.variance.cells import cells_of
from tacbench_cad.lab.analysis.variance.streaming import Pass, stream
from tacbench_cad.lab.analysis.variance.variance_figures import motion_figure
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs.press_table import read_frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The number of frames of a series.
STEPS = 4
KEY = ("ender-3_pla-plus", "texture-2")


def stripes(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
    """Return a frame whose mean is the same for all textures, but whose stripes move at the texture's own speed."""
    number = int(printed.object_label)
    phase = number * step + 0.1 * printed.copy + 0.02 * press.position
    columns = np.sin(0.8 * np.arange(SHAPE[1]) + phase)
    image = 120.0 + 30.0 * columns + rng.normal(0.0, 2.0 + step, SHAPE)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def force_n(printed: PrintedBlock, press: Press, step: int) -> float:
    return 1.0 + 0.1 * int(printed.object_label) * step + 0.001 * press.number + 0.002 * printed.copy


def write_slides(folder: Path, **changes: object) -> Path:
    plan: dict[str, object] = {"image": noise_image, "moving": stripes, "moving_force": force_n}
    write_study(folder, **{**plan, "moving_frames": STEPS, **changes})
    return folder


@pytest.fixture(scope="module")
def slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_slides(tmp_path_factory.mktemp("slides"), levels=(1, 3))


@pytest.fixture(scope="module")
def study(slides: Path) -> pd.DataFrame:
    return lab.read(slides, series=True)


def passed(presses: pd.DataFrame, feature: lab.Feature | None = None) -> Pass:
    with workers() as executor:
        return stream(Design.of(presses), (feature or lab.Pixels()).fit(presses), executor)


def arrays_of(presses: pd.DataFrame) -> Floats:
    """Return the series of each press with another reader than the analysis, (n, T, pixels)."""
    series = (of_press["frame"] for _, of_press in presses.groupby(["run", "press"]))
    return np.array([[read_frame(path).astype(np.float64).ravel() for path in frames] for frames in series])


def colours(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
    return rng.integers(0, 256, (6, 8, 3), dtype=np.uint8)


def taxels(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
    return rng.normal(step, 1.0 + step, 3)


@pytest.mark.parametrize(
    ("shape", "moving", "units", "colour"),
    [
        (SHAPE, stripes, "counts", False),
        ((6, 8, 3), colours, "counts", True),
        # Three frames of three numbers: a frame with three channels must not be taken for three frames.
        ((3,), taxels, "kPa", False),
    ],
)
def test_each_cell_has_numpys_variance(
    tmp_path: Path, shape: tuple[int, ...], moving: Callable[..., Frame], units: str, colour: bool
) -> None:
    def pressed(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
        return moving(printed, press, 0, rng)

    write_slides(tmp_path, shape=shape, image=pressed, moving=moving, units=units, moving_frames=3, still=1)
    presses = Design.of(lab.read(tmp_path, series=True)).presses
    of_cells = presses.groupby(["level", "position", "combination", "texture"])
    for place in passed(presses, lab.Pixels(colour=colour)).places:
        for key, cell in place.cells.items():
            frames = arrays_of(of_cells.get_group((place.level, place.position, *key)))
            assert frames.shape == (4, 3, np.prod(shape))
            for ddof in (0, 1):
                assert cell.variance(ddof) == pytest.approx(frames.var(axis=0, ddof=ddof).mean(), rel=1e-9)
            np.testing.assert_allclose(place.steps[key], 4.0 * frames.var(axis=0).mean(axis=1), rtol=1e-9)


def test_a_press_with_a_damaged_frame_is_left_out_with_its_whole_series(tmp_path: Path) -> None:
    write_slides(tmp_path, textures=(1,), prints=PRINTERS[:1], copies=3)
    presses = lab.read(tmp_path, series=True)
    damaged = presses[(presses["copy"] == 2) & (presses["position"] == 3)].iloc[STEPS - 1]
    kept = presses[(presses["run"] != damaged["run"]) | (presses["press"] != damaged["press"])]
    expected = {at: arrays_of(of).var(axis=0).mean() for at, of in kept.groupby("position")}
    Path(damaged["frame"]).write_bytes(b"\x89PNG but no more")
    result = passed(presses)
    assert [damaged["frame"] in line for line in result.left_out] == [True]
    for place in result.places:
        (cell,) = place.cells.values()
        assert cell.presses == (5 if place.position == 3 else 6)
        assert cell.variance() == pytest.approx(expected[place.position], rel=1e-9)


def test_memory_does_not_grow_with_the_length_of_the_series(tmp_path: Path) -> None:
    shape = (240, 320)

    def moving(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
        return np.full(shape, press.number + step, dtype=np.uint8)

    peaks = []
    for steps in (3, 12):
        plan = {"shape": shape, "still": 0, "textures": (1,), "prints": PRINTERS[:1], "moving_frames": steps}
        write_slides(tmp_path / str(steps), moving=moving, image=lambda *_: np.zeros(shape, np.uint8), **plan)
        presses = lab.read(tmp_path / str(steps), series=True)
        tracemalloc.start()
        try:
            passed(presses)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0]


def test_the_table_of_a_series_shows_the_variance_along_the_slide(study: pd.DataFrame, slides: Path) -> None:
    result = lab.variance(study)
    with styled():
        panels = motion_figure(result).axes
    assert len(panels) == 2 * 2  # two printers and two forces
    assert [line.get_label() for line in panels[0].get_lines()] == ["1", "2", "noise alone"]
    np.testing.assert_allclose(panels[0].get_lines()[0].get_xdata(), [0.0, 0.5, 1.0, 1.5])
    motion, cell = result.tables["motion"], cells_of(result.table)[1, KEY]
    assert len(motion) == 2 * 4 * STEPS
    mine = motion.query("texture == 'texture-2' and printer == 'ender-3' and force_level == 1")
    assert mine["frame"].tolist() == [1, 2, 3, 4]
    np.testing.assert_allclose(mine["distance_mm"], [0.0, 0.5, 1.0, 1.5])
    np.testing.assert_allclose(mine["time_s"], [0.0, 0.1, 0.2, 0.3])
    assert mine["variance"].mean() == pytest.approx(cell.variance)
    assert mine["variance"].iloc[-1] > 2.0 * mine["variance"].iloc[0]  # the noise of a frame grows along this slide
    assert any("mean over the 4 frames of a series" in note for note in result.notes)
    assert not any("in the paper's text" in warning for warning in result.warnings)
    # The noise of one frame is also the noise of each frame of a series.
    assert cell.floor == cells_of(lab.variance(lab.read(slides)).table)[1, KEY].floor


def test_forces_are_analysed_like_a_frame_with_a_number_for_each_time(study: pd.DataFrame) -> None:
    result = lab.variance(study, lab.Forces())
    mine = study.query("texture == 'texture-2' and printer == 'ender-3' and force_level == 3")
    forces = mine.pivot(index=["position", "run", "press"], columns="step", values="measured_force_n")
    expected = forces.groupby("position").var(ddof=0).mean()
    cell = cells_of(result.table)[3, KEY]
    assert result.units == "N" and cell.variance == pytest.approx(expected.mean(), rel=1e-6)
    assert cell.floor_from == "repeats (upper bound)"  # the stationary frames have no forces
    steps = result.tables["motion"].query("texture == 'texture-2' and printer == 'ender-3' and force_level == 3")
    np.testing.assert_allclose(steps["variance"], expected, rtol=1e-6)


def test_markers_are_followed_in_each_frame_of_a_series(tmp_path: Path) -> None:
    def moving(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
        return dots_frame(dots_displacement(printed, press) * (1.0 - 0.3 * step), rng)

    plan = {"shape": DOTS_SHAPE, "image": dots_image, "resting": dots_at_rest, "moving": moving, "moving_frames": 2}
    write_slides(tmp_path, textures=(1,), prints=PRINTERS[:1], still=0, **plan)
    presses = lab.read(tmp_path, series=True)
    result = lab.variance(presses, feature_of("markers"))
    runs = {run.info.printed.name: run.info for run in Design.of(presses).runs}
    truth = []
    for _, of_place in presses[presses["step"] == 1].groupby("position"):
        infos = ((runs[row.run], row.press) for row in of_place.itertuples())
        shifts = np.array([dots_displacement(info.printed, info.press_by_number[press]) for info, press in infos])
        truth.append([shifts.var(axis=0).mean(), (0.7 * shifts).var(axis=0).mean()])
    assert result.table["variance"][0] == pytest.approx(np.mean(truth), rel=0.1)
    np.testing.assert_allclose(result.tables["motion"]["variance"], np.mean(truth, axis=0), rtol=0.1)


def test_what_series_cannot_be_used_for_is_refused(slides: Path, study: pd.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="features = 'forces': are recorded during a motion; also give --series"):
        lab.Forces().fit(lab.read(slides))
    with pytest.raises(InputError, match="has fixed settings"):
        lab.variance(study, protocol="as-published")
    with pytest.raises(InputError, match="is for the frames of presses; leave out --series"):
        lab.variance(study, register=True)
    write_slides(tmp_path / "short", moving_frames=2, moving_force=None, still=0, copies=3, textures=(3,))
    with pytest.raises(InputError, match=r"need a force gauge, but .* has no forces"):
        lab.Forces().fit(lab.read(tmp_path / "short", series=True))
    both = [slides, tmp_path / "short"]
    Design.of(lab.read(both))  # the frames of the presses are comparable
    with pytest.raises(InputError, match=r"motion.*frames=2.*: in .*, but .*frames=4.* in .*; analyse them separately"):
        Design.of(lab.read(both, series=True))


def test_imported_arrays_with_an_axis_of_time_are_analysed_without_series(tmp_path: Path) -> None:
    samples = np.random.default_rng(5).integers(0, 256, (12, 3, 10, 11), dtype=np.uint8)  # (n, T, height, width)
    np.save(tmp_path / "slides.npy", samples)
    lines = [f"{'ab'[i % 2]},{1 + i // 2 % 2},1,{1 + i // 4}" for i in range(12)]
    (tmp_path / "slides.csv").write_text("\n".join(["label,print,position,repeat", *lines]))
    files = [str(tmp_path / name) for name in ("slides.npy", "slides.csv")]
    assert main(["import-frames", *files, "-o", str(tmp_path / "runs")]) == 0
    presses = lab.read(tmp_path / "runs")
    assert Design.of(presses).frame_shape == (3, 10, 11)
    assert lab.variance(presses).table["variance"][0] == pytest.approx(samples[::2].var(axis=0).mean(), rel=1e-9)


STUDY = """
out = "runs"
[study]
preset = "released"
textures = [1, 5]
prints = [{ printer = "bambu-p1p", filament = "pla-minus", copies = 2, force_levels = [2] }]
[protocol]
positions.grid = { x_mm = [5.0, 8.0], y_mm = [15.0] }
repeats = 1
checks.stationary_frames = 1
[protocol.motion]
name = "slide"
frames = 5
length_mm = 8.0
direction_deg = 0.0
"""


def test_a_virtual_slide_study_is_analysed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(STUDY)
    assert main(["simulate", "--study", "study.toml", "--jobs", "1"]) == 0
    capsys.readouterr()
    assert main(["variance", "runs", "--series", "--jobs", "1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["series"] and document["features"] == "pixels"
    np.testing.assert_allclose(
        [row["distance_mm"] for row in document["motion"][:5]], np.arange(0.0, 9.0, 2.0), atol=1e-3
    )
    presses = lab.read("runs", series=True)
    first = presses[presses["texture"] == document["variance"][0]["texture"]]
    expected = [arrays_of(of_place).var(axis=0).mean() for _, of_place in first.groupby("position")]
    assert document["variance"][0]["variance"] == pytest.approx(np.mean(expected), rel=1e-9)
    pixels = lab.Pixels(resolution=0.1)
    settings = lab.ClassificationSettings(components=3, hold_out=("copy",))
    scores = lab.classify(presses, pixels, settings, trials=1).table
    assert (scores.loc[scores["tested_on"] == "all", "accuracy"] == 1.0).all()


@pytest.mark.usefixtures("no_figures")
def test_a_report_shows_the_variance_along_the_slide(tmp_path: Path) -> None:
    write_slides(tmp_path / "few", prints=PRINTERS[:1], still=1)
    report = ["report", str(tmp_path / "few"), "--series", "--no-classify", "--jobs", "1"]
    assert main([*report, "-o", str(tmp_path / "report.html")]) == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Variance of each frame of the series" in page
    assert "They were taken while the sensor moved in contact, 4 after each press." in page
    assert (tmp_path / "report_files" / "variance" / "variance_motion.png").is_file()
