"""Test variance and classification of series of moving frames against NumPy and scikit-learn on the same arrays."""

from __future__ import annotations

import csv
import json
import tracemalloc
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from helpers.dots import SHAPE as DOTS_SHAPE
from helpers.dots import dots_at_rest, dots_displacement, dots_frame, dots_image
from helpers.studies import PRINTERS, SHAPE, noise_image, write_study

from tacbench_cad.cli import main
from tacbench_cad.lab.analysis.classification.augment import Augmentation, trial_seed
from tacbench_cad.lab.analysis.classification.classify import classify, write_tables
from tacbench_cad.lab.analysis.classification.features import read_features
from tacbench_cad.lab.analysis.classification.leak_free import leak_free_trial, trial_folds
from tacbench_cad.lab.analysis.classification.outcomes import ClassifiedStudy
from tacbench_cad.lab.analysis.classification.principal import Products
from tacbench_cad.lab.analysis.classification.result import Result
from tacbench_cad.lab.analysis.classification.settings import ClassificationRecord, ClassificationSettings
from tacbench_cad.lab.analysis.classification.splits import PressTable
from tacbench_cad.lab.analysis.classification.sweep import Sweep, run_sweep
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.compare import compare
from tacbench_cad.lab.analysis.comparison_sides import read_side
from tacbench_cad.lab.analysis.feature import fitted
from tacbench_cad.lab.analysis.figures import styled
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.report.classification import Classification
from tacbench_cad.lab.analysis.variance.registration import register
from tacbench_cad.lab.analysis.variance.streaming import Pass, stream
from tacbench_cad.lab.analysis.variance.table import variance_table
from tacbench_cad.lab.analysis.variance.variance_figures import motion_figure
from tacbench_cad.lab.analysis.variance.view import VarianceView, write_all
from tacbench_cad.lab.parallel import workers
from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats

#: The number of frames of a series.
STEPS = 4


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


@pytest.fixture
def study(slides: Path) -> Collection:
    return Collection.open([slides]).viewed(True)


def arrays_of(collection: Collection, which: np.ndarray) -> Floats:
    """Return the series of presses with another reader than the analysis, (n, T, ...)."""
    return np.stack(
        [
            collection.runs[int(collection.run[i])].series(collection.rows[int(i)]).frames.astype(np.float64)
            for i in which
        ]
    )


def cells_of(collection: Collection) -> Iterator[tuple[int, int, tuple[str, str], np.ndarray]]:
    for level in collection.levels:
        for position in np.unique(collection.position).tolist():
            for combination in collection.combinations:
                for texture in collection.textures:
                    here = (collection.level == level) & (collection.position == position)
                    here &= (collection.combination == combination) & (collection.texture == texture)
                    yield level, position, (combination, texture), np.flatnonzero(here)


def passed(collection: Collection, feature: Pixels | None = None) -> Pass:
    with workers() as team:
        return stream(collection, feature or Pixels(), team)


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
    collection = Collection.open([tmp_path]).viewed(True)
    places = {(place.level, place.position): place for place in passed(collection, Pixels(colour=colour)).places}
    for level, position, key, which in cells_of(collection):
        frames = arrays_of(collection, which)
        assert frames.shape == (4, 3, *shape)
        place = places[level, position]
        for ddof in (0, 1):
            assert place.cells[key].variance(ddof) == pytest.approx(frames.var(axis=0, ddof=ddof).mean(), rel=1e-9)
        over_time = 4.0 * frames.var(axis=0).reshape(3, -1).mean(axis=1)
        np.testing.assert_allclose(place.steps[key], over_time, rtol=1e-9)


def test_all_sums_of_a_place_equal_those_of_the_stacked_arrays(study: Collection) -> None:
    place = passed(study).places[5]
    here = np.flatnonzero((study.level == place.level) & (study.position == place.position))
    values = arrays_of(study, here).reshape(len(here), -1)
    labels = [(study.texture[i], study.combination[i], study.copy[i], i) for i in here]
    means = [
        np.stack([values[[other[:depth] == label[:depth] for other in labels]].mean(axis=0) for label in labels])
        for depth in range(5)
    ]
    direct = [((fine - coarse) ** 2).sum(axis=0).mean() for coarse, fine in pairwise(means)]
    np.testing.assert_allclose(place.nested.squares, direct, rtol=1e-9)
    for combination, (names, distances) in place.distances.items():
        mine = study.combination[here] == combination
        first, second = (values[mine & (study.texture[here] == name)].mean(axis=0) for name in names)
        assert distances[0, 1] == pytest.approx(((first - second) ** 2).mean(), rel=1e-9)


def test_a_press_with_a_damaged_frame_is_left_out_with_its_whole_series(tmp_path: Path) -> None:
    write_slides(tmp_path, textures=(1,), prints=PRINTERS[:1], copies=3)
    collection = Collection.open([tmp_path]).viewed(True)
    damaged = int(np.flatnonzero((collection.copy == 2) & (collection.position == 3))[0])
    arrays = {position: arrays_of(collection, which) for _, position, _, which in cells_of(collection)}
    run = collection.runs[int(collection.run[damaged])]
    (run.folder / collection.paths(damaged)[-1]).write_bytes(b"\x89PNG but no more")
    result = passed(collection)
    assert [collection.paths(damaged)[-1] in line for line in result.left_out] == [True]
    for place in result.places:
        frames = arrays[place.position]
        if place.position == 3:
            kept = np.flatnonzero(collection.position == 3) != damaged
            frames = frames[kept]
        (cell,) = place.cells.values()
        assert cell.presses == len(frames)
        assert cell.variance() == pytest.approx(frames.var(axis=0).mean(), rel=1e-9)
    with pytest.raises(CheckFailedError, match=r"frame_04\.png"):
        read_features(collection, Pixels())


def test_memory_does_not_grow_with_the_length_of_the_series(tmp_path: Path) -> None:
    shape = (240, 320)

    def moving(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
        return np.full(shape, press.number + step, dtype=np.uint8)

    peaks = []
    for steps in (3, 12):
        write_slides(
            tmp_path / str(steps),
            moving=moving,
            moving_frames=steps,
            shape=shape,
            still=0,
            textures=(1,),
            image=lambda printed, press, rng: np.zeros(shape, np.uint8),
            prints=PRINTERS[:1],
        )
        collection = Collection.open([tmp_path / str(steps)]).viewed(True)
        collection.level, collection.repeat, collection.position  # noqa: B018 the presses are read before
        tracemalloc.start()
        try:
            passed(collection)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert peaks[1] < 1.05 * peaks[0]


def test_the_table_of_a_series_shows_the_variance_along_the_slide(study: Collection, tmp_path: Path) -> None:
    result = variance_table(study)
    assert tmp_path / "motion.csv" in VarianceView.of(result).write(tmp_path)
    with styled():
        panels = motion_figure(result).axes
    assert len(panels) == 2 * 2  # two printers and two forces
    assert [line.get_label() for line in panels[0].get_lines()] == ["1", "2", "noise alone"]
    np.testing.assert_allclose(panels[0].get_lines()[0].get_xdata(), [0.0, 0.5, 1.0, 1.5])
    with (tmp_path / "motion.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    assert len(rows) == 2 * 4 * STEPS
    mine = [row for row in rows if row["texture"] == "texture-2" and row["printer"] == "ender-3"]
    assert [float(row["distance_mm"]) for row in mine[:STEPS]] == pytest.approx([0.0, 0.5, 1.0, 1.5])
    assert [float(row["time_s"]) for row in mine[:STEPS]] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    cell = result.cell(1, "ender-3_pla-plus", "texture-2")
    assert cell is not None
    over_time = [float(row["variance"]) for row in mine if row["force_level"] == "1"]
    assert np.mean(over_time) == pytest.approx(cell.variance)
    assert over_time[-1] > 2.0 * over_time[0]  # the noise of a frame grows along this slide
    view = VarianceView.read(tmp_path, Collection.open([run.folder for run in study.runs]))
    assert view.settings.series
    assert any("mean over the 4 frames of a series" in note for note in view.notes)
    assert not any("in the paper's text" in warning for warning in view.warnings)
    # The noise of one frame is also the noise of each frame of a series.
    assert cell.floor == variance_table(study.viewed(False)).cell(1, "ender-3_pla-plus", "texture-2").floor


def test_forces_are_analysed_like_a_frame_with_a_number_for_each_time(slides: Path) -> None:
    collection = Collection.open([slides]).viewed(True)
    result = variance_table(collection, fitted(collection, "forces"))
    assert result.units == "N"
    mine = (
        (collection.level == 3) & (collection.combination == "ender-3_pla-plus") & (collection.texture == "texture-1")
    )
    expected = []
    for position in (1, 2, 3, 4):
        which = np.flatnonzero(mine & (collection.position == position))
        rows = [collection.runs[int(collection.run[i])].series(collection.rows[int(i)]).force_n for i in which]
        expected.append(np.var(rows, axis=0))
    cell = result.cell(3, "ender-3_pla-plus", "texture-1")
    assert cell is not None and cell.variance == pytest.approx(np.mean(expected), rel=1e-6)
    assert cell.floor_from == "repeats (upper bound)"  # the stationary frames have no forces
    steps = result.steps[3, ("ender-3_pla-plus", "texture-1")]
    np.testing.assert_allclose(steps, np.mean(expected, axis=0), rtol=1e-6)
    with styled():
        lines = motion_figure(result).axes[1].get_lines()
    np.testing.assert_allclose(lines[0].get_ydata(), steps)


def test_markers_are_followed_in_each_frame_of_a_series(tmp_path: Path) -> None:
    def moving(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
        return dots_frame(dots_displacement(printed, press) * (1.0 - 0.3 * step), rng)

    plan = {"shape": DOTS_SHAPE, "image": dots_image, "resting": dots_at_rest, "moving": moving, "moving_frames": 2}
    write_slides(tmp_path, textures=(1,), prints=PRINTERS[:1], still=0, **plan)
    collection = Collection.open([tmp_path]).viewed(True)
    result = variance_table(collection, fitted(collection, "markers"))
    truth = []
    for _, _, _, which in cells_of(collection):
        shifts = np.array(
            [
                dots_displacement(run.info.printed, run.info.press_by_number[int(collection.number[i])])
                for i in which
                for run in [collection.runs[int(collection.run[i])]]
            ]
        )
        truth.append([shifts.var(axis=0).mean(), (0.7 * shifts).var(axis=0).mean()])
    cell = result.cells[0]
    assert cell.variance == pytest.approx(np.mean(truth), rel=0.1)
    (steps,) = result.steps.values()
    np.testing.assert_allclose(steps, np.mean(truth, axis=0), rtol=0.1)


def accuracy(result: Result, hold_out: str) -> float:
    return next(score.accuracy for score in result.scores if (score.hold_out, score.tested_on) == (hold_out, "all"))


def classified(folder: Path, out: Path, **settings: object) -> Result:
    plan: dict[str, object] = {"resolution": 1.0, "components": 4, "hold_out": ("copy", "printer-filament")}
    with workers() as executor:
        how = ClassificationSettings(**{**plan, **settings})
        return classify(Collection.open([folder]), how, 1, out, executor)


@pytest.mark.usefixtures("single_thread", "few_trees")
def test_textures_that_differ_only_along_the_slide_are_told_apart_only_with_the_series(
    slides: Path, tmp_path: Path
) -> None:
    without = classified(slides, tmp_path)
    pixels = classified(slides, tmp_path, series=True)
    assert accuracy(without, "copy") < 0.75  # chance is 0.5
    for level in ("copy", "printer-filament"):
        assert accuracy(pixels, level) == 1.0
    assert without.record.data != pixels.record.data
    assert pixels.record.series and not without.record.series
    assert len(list((tmp_path / "trials").iterdir())) == 2  # one trial of each: the same folder mixes nothing
    plain = Augmentation()
    forces = classified(slides, tmp_path, series=True, features="forces", components=None, augmentation=plain)
    assert accuracy(forces, "copy") == 1.0 and forces.record.units == "N"


@pytest.mark.usefixtures("single_thread", "few_trees")
def test_predictions_are_those_of_scikit_learn_on_the_training_series_only(slides: Path) -> None:
    from sklearn.decomposition import PCA
    from sklearn.ensemble import RandomForestClassifier
    from sklearn.preprocessing import StandardScaler

    collection = Collection.open([slides]).viewed(True)
    presses = PressTable.of(collection)
    settings = ClassificationSettings(components=3, resolution=1.0, series=True, augmentation=Augmentation())
    features = read_features(collection, Pixels(resolution=0.5))
    assert features.shape == (STEPS, SHAPE[0] // 2, SHAPE[1] // 2)
    arrays = arrays_of(collection, np.arange(len(collection)))
    halves = arrays.reshape(len(collection), STEPS, SHAPE[0] // 2, 2, SHAPE[1] // 2, 2).mean(axis=(3, 5))
    assert np.abs(features.rows - halves.reshape(len(collection), -1)).max() <= 0.5  # rounded to whole counts
    products = Products.of(features.rows)
    outcomes = leak_free_trial(ClassifiedStudy(features=features, presses=presses, settings=settings), products, 1)
    folds = trial_folds(presses, settings, 1).folds
    for fold in folds:
        assert not set(fold.train) & set(fold.test)
        rows = features.rows.astype(float)
        pca = PCA(3, svd_solver="full").fit(rows[fold.train])
        scores = pca.transform(rows[fold.train])
        signs = np.sign(scores[np.argmax(np.abs(scores), axis=0), np.arange(3)])
        scaler = StandardScaler().fit(scores * signs)
        forest = RandomForestClassifier(max_depth=50, random_state=trial_seed(0, 1))
        forest.fit(scaler.transform(scores * signs), presses.texture[fold.train])
        expected = forest.predict(scaler.transform(pca.transform(rows[fold.test]) * signs))
        predicted, outcomes = outcomes["predicted"].iloc[: len(expected)], outcomes.iloc[len(expected) :]
        assert np.array_equal(predicted, expected)


@pytest.mark.usefixtures("single_thread", "few_trees")
def test_series_of_noise_are_predicted_at_chance(tmp_path: Path) -> None:
    def moving(printed: PrintedBlock, press: Press, step: int, rng: np.random.Generator) -> Frame:
        return rng.integers(0, 256, SHAPE, dtype=np.uint8)

    write_slides(tmp_path / "runs", moving=moving, levels=(1, 2), still=0)
    result = classified(tmp_path / "runs", tmp_path, series=True, hold_out=("press", "position", "copy"))
    for score in (score for score in result.scores if score.tested_on == "all"):
        assert score.low is not None and score.high is not None
        assert score.low - 0.02 <= result.chance <= score.high + 0.02  # one of three levels may miss by chance


@pytest.mark.usefixtures("single_thread", "few_trees")
def test_a_sweep_shows_how_far_the_sensor_must_slide(few_slides: Path, tmp_path: Path) -> None:
    collection = Collection.open([few_slides])
    alone = read_features(collection.viewed(True, 1), Pixels())
    assert alone.shape == (1, *SHAPE)
    np.testing.assert_array_equal(alone.rows[3].reshape(SHAPE), collection.runs[0].series(collection.rows[3]).frames[0])
    forces = read_features(collection.viewed(True, 3), fitted(collection.viewed(True, 3), "forces"))
    assert forces.rows[5].tolist() == collection.runs[0].series(collection.rows[5]).force_n[:3].tolist()
    with pytest.raises(InputError, match="frames = 5: must be from 1 to 4, the length of a series"):
        collection.viewed(True, 5)
    settings = ClassificationSettings(resolution=1.0, components=3, hold_out=("copy",), series=True)
    sweep = Sweep.parsed("frames=1,3")
    with workers() as executor:
        result = run_sweep(collection, settings, sweep, 1, tmp_path, executor)
        # All textures have the same stripes in the first frame; the speed of the stripes shows only in later frames.
        assert result.values == (1.0, 3.0) and [score.accuracy for score in result.scores][1] == 1.0
        assert result.scores[0].accuracy < 0.8
        with pytest.raises(InputError, match="needs series of frames; also give --series"):
            run_sweep(collection, ClassificationSettings(), sweep, 1, tmp_path, executor)


def test_what_series_cannot_be_used_for_is_refused(slides: Path, tmp_path: Path) -> None:
    collection = Collection.open([slides])
    with pytest.raises(InputError, match="features = 'forces': are recorded during a motion; also give --series"):
        fitted(collection, "forces")
    moving = collection.viewed(True)
    with pytest.raises(InputError, match="is for the frames of presses; leave out --series"):
        variance_table(moving, protocol="as-published")
    with pytest.raises(InputError, match="is for the frames of presses; leave out --series"):
        register(moving)
    with pytest.raises(InputError, match="is for the frames of presses; leave out --series"):
        ClassificationSettings(protocol="as-published", series=True)
    write_study(tmp_path / "pressed", textures=(1,), still=0)
    with pytest.raises(
        InputError, match="has no series of frames: its protocol has no motion, or it was imported; leave out"
    ):
        Collection.open([tmp_path / "pressed"]).viewed(True)
    write_slides(tmp_path / "short", moving_frames=2, moving_force=None, still=0, copies=3, textures=(3,))
    with pytest.raises(InputError, match=r"need a force gauge, but .* has no forces"):
        fitted(Collection.open([tmp_path / "short"]).viewed(True), "forces")
    both = Collection.open([slides, tmp_path / "short"])  # the frames of the presses are comparable
    with pytest.raises(
        InputError, match=r"motion.*frames=2.*: in .*, but .*frames=4.* in .*; analyse the series of these runs separ"
    ):
        both.viewed(True)


def test_imported_arrays_with_an_axis_of_time_are_analysed_without_series(tmp_path: Path) -> None:
    samples = np.random.default_rng(5).integers(0, 256, (12, 3, 10, 11), dtype=np.uint8)  # (n, T, height, width)
    np.save(tmp_path / "slides.npy", samples)
    lines = [f"{'ab'[i % 2]},{1 + i // 2 % 2},1,{1 + i // 4}" for i in range(12)]
    (tmp_path / "slides.csv").write_text("\n".join(["label,print,position,repeat", *lines]))
    files = [str(tmp_path / name) for name in ("slides.npy", "slides.csv")]
    assert main(["import-frames", *files, "-o", str(tmp_path / "runs")]) == 0
    collection = Collection.open([tmp_path / "runs"])
    assert collection.info.frame_shape == (3, 10, 11)
    cell = variance_table(collection).cells[0]
    assert cell.variance == pytest.approx(samples[::2].var(axis=0).mean(), rel=1e-9)
    with pytest.raises(InputError, match=r"has no series of frames: .* it was imported"):
        collection.viewed(True)


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


@pytest.mark.usefixtures("single_thread", "few_trees")
def test_a_virtual_slide_study_is_analysed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.toml").write_text(STUDY)
    assert main(["simulate", "--study", "study.toml", "--jobs", "1"]) == 0
    collection = Collection.open([Path("runs")]).viewed(True)
    distance_mm = collection.courses.distance_mm
    np.testing.assert_allclose(distance_mm, np.tile([0.0, 2.0, 4.0, 6.0, 8.0], (8, 1)), atol=1e-3)
    cell = variance_table(collection).cells[0]
    here = np.flatnonzero(collection.texture == cell.texture)
    expected = [arrays_of(collection, here[collection.position[here] == at]).var(axis=0).mean() for at in (1, 2)]
    assert cell.variance == pytest.approx(np.mean(expected), rel=1e-9)
    result = classified(Path("runs"), tmp_path, series=True, resolution=0.1, components=3, hold_out=("copy",))
    assert accuracy(result, "copy") == 1.0


@pytest.fixture(scope="module")
def few_slides(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_slides(tmp_path_factory.mktemp("few"), prints=PRINTERS[:1], still=1)


@pytest.mark.usefixtures("few_trees")
def test_commands_analyse_series(few_slides: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = [str(few_slides), "--series", "--jobs", "1"]
    assert main(["variance", *common, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["series"] and document["features"] == "pixels"
    assert len(document["motion"]) == 2 * STEPS
    out = tmp_path / "forces"
    forces = ["--features", "forces", "--hold-out", "copy", "--trials", "1", "-o", str(out)]
    assert main(["classify", *common, *forces]) == 0
    record = ClassificationRecord.read(out)
    assert (record.features, record.series, record.components, record.units) == ("forces", True, None, "N")
    assert "the forces during the motion" in Classification.read(out).methods


@pytest.mark.usefixtures("single_thread", "few_trees")
def test_a_comparison_says_that_one_side_used_the_series(few_slides: Path, tmp_path: Path) -> None:
    for name, series in (("press", False), ("slide", True)):
        write_tables(classified(few_slides, tmp_path / name, series=series, hold_out=("copy",)), tmp_path / name)
    sides = [read_side(tmp_path / name, name) for name in ("press", "slide")]
    comparison = compare(sides[0][0], sides[1][0], "forest")
    assert "series: False for A, True for B" in comparison.notes
    assert comparison.rows[0].paired and comparison.rows[0].accuracy_b == 1.0


def test_a_report_shows_the_variance_along_the_slide(few_slides: Path, tmp_path: Path) -> None:
    view = variance_table(Collection.open([few_slides]).viewed(True))
    write_all(view, tmp_path / "variance")
    report = ["report", str(few_slides), "--variance", str(tmp_path / "variance"), "--no-classify", "--jobs", "1"]
    assert main([*report, "-o", str(tmp_path / "report.html")]) == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Variance of each frame of the series" in page
    assert "They were taken while the sensor moved in contact, 4 after each press." in page
    assert (tmp_path / "report_files" / "variance" / "variance_motion.png").is_file()
