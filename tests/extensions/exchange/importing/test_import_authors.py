"""Test the import of the authors' arrays: all published names, their shapes, and unknown information."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.cli import main
from tacbench_cad.lab import ImportOptions, Run, check_run, import_samples
from tacbench_cad.lab.runs.importing.grouping import Names, grouped
from tacbench_cad.lab.runs.importing.import_formats import sources_of
from tacbench_cad.lab.runs.importing.sources import LeftOutFile, Source

Capture = pytest.CaptureFixture[str]
NAMES = (Path(__file__).parent / "authors_names.txt").read_text().split()
SHAPE = (16, 24, 3)


def images(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, shape or (1, 2, 5, 5, *SHAPE), dtype=np.uint8)


def save(folder: Path, name: str, array: Any) -> Path:
    np.save(folder / name, array, allow_pickle=False)
    return folder / name


@pytest.fixture
def arrays(tmp_path: Path) -> Path:
    """Write a small array under each published name, and two files that cannot be imported."""
    (tmp_path / "arrays").mkdir()
    for seed, name in enumerate(NAMES):
        save(tmp_path / "arrays", name, images(seed, 25, 8, 8))
    save(tmp_path / "arrays", "X.npy", images(0, 100, 8, 8))
    save(tmp_path / "arrays", "petg_z0_P35_bambu.npy", images(1, 25, 8, 8))
    return tmp_path / "arrays"


def test_all_published_names_are_recognised(arrays: Path) -> None:
    items = list(sources_of([arrays], ImportOptions()))
    left_out = [item for item in items if isinstance(item, LeftOutFile)]
    assert [Path(sample.where).name for sample in left_out] == ["X.npy", "petg_z0_P35_bambu.npy"]
    assert "a table (CSV) with a row for each" in left_out[0].reason
    assert "P35 is not a force level; known are P30=1, P40=2, P50=3, and --format-options" in left_out[1].reason
    groups, faults = grouped([item for item in items if isinstance(item, Source)], Names())
    assert not faults and sum(len(group.samples) for group in groups) == len(NAMES) * 25 == 210 * 25
    printed = [group.specimen for group in groups]
    assert {print_.printer for print_ in printed} == {"bambu", "ender", "creality", "crealty", "resin"}
    assert {print_.filament for print_ in printed} == {"plaminus", "plaplus", "petg", "resin", "wood"}
    # A set without a number is a separate print in addition to the numbered prints.
    bambu = {
        print_.copy for print_ in printed if (print_.combination, print_.texture) == ("bambu_plaminus", "texture-1")
    }
    assert bambu == {1, 2, 3, 4, 5, 6, "unnumbered"}
    prints = {(name.partition("_P")[0] + name.rpartition("_")[2]).lower() for name in NAMES}
    assert len({print_.name for print_ in printed}) == len(groups) == len(prints)
    assert {group.levels for group in groups} == {(1,), (1, 2), (1, 2, 3)}


@pytest.mark.parametrize("first_axis", ["y", "x"])
@pytest.mark.parametrize(
    "shape",
    [
        (1, 2, 5, 5, *SHAPE),
        (25, 16, 24),
        *(pytest.param(shape, marks=pytest.mark.long) for shape in ((50, *SHAPE), (50, 16, 24), (1, 2, 5, 5, 16, 24))),
    ],
)
def test_every_frame_gets_its_position(shape: tuple[int, ...], first_axis: Any, tmp_path: Path) -> None:
    array = images(1, *shape)
    path = save(tmp_path, "PLAminus_z3.2_P40_Bambu.npy", array)
    options = ImportOptions(kind="authors", of_format={"first-axis": first_axis})
    report = import_samples([path], tmp_path / "out", options)
    assert report.ok
    run = Run.open(report.runs[0].folder)
    frames = array.reshape(-1, 5, 5, *(shape[-3:] if shape[-1] == 3 else shape[-2:]))
    x_mm, y_mm = (4.0, 5.25, 6.5, 7.75, 9.0), (18.0, 19.25, 20.5, 21.75, 23.0)
    assert len(run.rows) == len(frames) * 25
    for row in run.rows:
        assert row.position and row.repeat
        along_y, along_x = divmod(row.position - 1, 5)
        i, j = (along_y, along_x) if first_axis == "y" else (along_x, along_y)
        assert np.array_equal(run.frame(row, verify=True), frames[row.repeat - 1, i, j])
        assert row.pose_mm[:2] == (x_mm[along_x], y_mm[along_y])
    assert check_run(run.folder).ok


def test_float_frames_keep_every_digit(tmp_path: Path) -> None:
    array = np.random.default_rng(0).random((50, 12, 16)) * 255.0
    report = import_samples([save(tmp_path, "wood_z1_P30_bambu.npy", array)], tmp_path / "out")
    run = Run.open(report.runs[0].folder)
    assert run.info.sensor["units"] == "counts" and run.rows[0].sensor_image == "reading_1.npy"
    assert all(np.array_equal(run.frame(row), array[row.number - 1]) for row in run.rows)


def test_missing_information_stays_unknown(tmp_path: Path) -> None:
    path = save(tmp_path, "resin_z3.2_P50_resin.npy", images(1))
    run = Run.open(import_samples([path], tmp_path / "out").runs[0].folder)
    info, row = run.info, run.rows[0]
    of = info.printed
    assert (of.object_label, of.texture, of.printer, of.filament, of.copy) == (4, "texture-4", "resin", "resin", 2)
    assert (row.force_level, row.target_force_n, of.block and of.block.preset) == (3, 3.0137, "released")
    unknown = (row.pose_z, row.pose_rx, row.measured_force_n, row.in_band, row.time_utc)
    assert unknown == (None,) * 5
    assert (info.levels, info.protocol, info.holder, info.frame, info.stage, info.gauge) == (
        (3,),
        None,
        None,
        None,
        {},
        {},
    )
    assert info.printed.block and info.printed.block.preset == "released"
    assert info.source["geometry"].startswith("the files that the authors published")


def test_the_levels_of_a_print_become_one_run(tmp_path: Path) -> None:
    arrays = {name: images(seed) for seed, name in enumerate(("P30", "P40", "P50"))}
    paths = [save(tmp_path, f"Plaplus_z5_{name}_creality.npy", array) for name, array in arrays.items()]
    paths.append(save(tmp_path, "PLAplus_z5_P30_crealty.npy", images(9)))
    report = import_samples(paths[::-1], tmp_path / "out")
    assert [run.folder.name for run in report.runs] == [
        "texture-6_crealty_plaplus_unnumbered",
        "texture-6_creality_plaplus_unnumbered",
    ]
    run = Run.open(report.runs[1].folder)
    for level, array in enumerate(arrays.values(), start=1):
        assert np.array_equal(run.frame(run.by_key[(level, 2, 25)]), array[0, 1, 4, 4])


def test_names_merge_two_spellings_and_equal_prints_are_left_out(tmp_path: Path) -> None:
    names = tmp_path / "names.toml"
    names.write_text(
        '[printers]\ncreality = "ender-3-v3-se"\ncrealty = "ender-3-v3-se"\n[filaments]\nplaminus = "pla-minus"\n'
    )
    paths = [save(tmp_path, f"PLAminus_z0_P30_{word}.npy", images(len(word))) for word in ("creality", "crealty")]
    report = import_samples(paths, tmp_path / "out", ImportOptions(names=names))
    assert [run.folder.name for run in report.runs] == ["texture-1_ender-3-v3-se_pla-minus_unnumbered"]
    assert sum(sample.count for sample in report.left_out) == 50


def test_an_array_cannot_become_two_prints(tmp_path: Path) -> None:
    first = save(tmp_path, "PLAminus_z0_P30_Bambu.npy", images(1))
    second = save(tmp_path, "PLAminus_z0.1_P30_bambu.npy", images(1))
    for paths in ([first, second], [second]):
        report = import_samples(paths, tmp_path / "out")
        assert len(report.left_out) == 1 and "was already imported as" in report.left_out[0].reason
        assert report.left_out[0].count == 50
    assert len(list((tmp_path / "out").iterdir())) == 1


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((49, *SHAPE), np.uint8),
        np.zeros((0, *SHAPE), np.uint8),
        np.zeros((50, 16, 24, 4), np.uint8),
        np.zeros((50, 4, 24, 3), np.uint8),
        np.zeros((2, 2, 5, 5, *SHAPE), np.uint8),
        np.zeros((1, 2, 4, 5, *SHAPE), np.uint8),
        np.asfortranarray(np.zeros((50, *SHAPE), np.uint8)),
        np.zeros((50, *SHAPE), np.complex128),
        np.zeros((), np.uint8),
    ],
)
def test_other_shapes_are_left_out(array: Any, tmp_path: Path) -> None:
    report = import_samples([save(tmp_path, "PLAminus_z0_P30_Bambu.npy", array)], tmp_path / "out")
    assert not report.runs and ("has shape" in report.left_out[0].reason or "real numbers" in report.left_out[0].reason)
    assert not (tmp_path / "out").exists()


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "PLAminus_z0_P30_Bambu.npy"

    def reason() -> str:
        (left_out,) = import_samples([path], tmp_path / "out").left_out
        return left_out.reason

    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    assert "contains pickled objects" in reason()
    path.write_bytes(pickle.dumps(images(1)))
    assert "is pickled" in reason()
    np.save(path, images(1))
    path.write_bytes(path.read_bytes()[:-1])
    assert "is truncated" in reason()
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("first-axis=z", "first-axis = 'z': allowed: y, x"),
        ("P30", "must be NAME=VALUE"),
        ("P30=1,P40=1", "must have each number only once"),
        ("P30=4", "must be from 1 to 3"),
        ("P30=1,P30=2", "has P30 twice"),
        ("30=1", "format options = '30'"),
        ("spacing=2mm", "spacing = '2mm'"),
        ("preset=papers", 'did you mean "paper"'),
    ],
)
def test_invalid_options_are_refused(options: str, message: str, tmp_path: Path, capsys: Capture) -> None:
    path = save(tmp_path, "PLAminus_z0_P30_Bambu.npy", images(1))
    words = ["import-frames", str(path), "--kind", "authors", "--format-options", options]
    assert main([*words, "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
