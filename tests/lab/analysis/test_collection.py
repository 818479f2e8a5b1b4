"""Test collections of runs as a table of presses, and the pixels of frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from helpers.printers import PRINTER, measured
from helpers.studies import GRID, Plan, write_run, write_study

from tacbench_cad.extensions.printer_models.correction import corrected_for
from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.runs.reading import find_runs
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import CheckFailedError, InputError


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("parent") / "study"
    write_study(folder, levels=(1, 3))
    return folder


def test_every_press_has_a_row_in_the_table(study: Path) -> None:
    result = Collection.open([study])
    assert len(result.runs) == 8 and len(result) == 8 * 2 * 2 * len(GRID.positions_mm)
    assert result.combinations == ("ender-3_pla-plus", "bambu-p1p_pla-minus")
    assert result.textures == ("texture-1", "texture-2") and result.levels == (1, 3)
    for index in (0, 17, len(result) - 1):
        run = result.runs[result.run[index]]
        press = run.info.presses[result.number[index] - 1]
        assert (press.force_level, press.repeat, press.position) == (
            result.level[index],
            result.repeat[index],
            result.position[index],
        )
        assert run.info.printed.copy == result.copy[index]
        assert (
            run.info.printed.combination
            == result.combination[index]
            == (f"{result.printer[index]}_{result.filament[index]}")
        )


def test_frames_belong_to_the_chosen_presses(study: Path) -> None:
    result = Collection.open([study])
    some = result.chosen((result.texture == "texture-2") & (result.level == 3) & (result.position == 4))
    assert len(some) == 2 * 2 * 2 and set(some.copy.tolist()) == {1, 2}
    rows = np.flatnonzero((result.texture == "texture-2") & (result.level == 3) & (result.position == 4))
    assert all(np.array_equal(some.frame(i), result.frame(j)) for i, j in enumerate(rows))
    assert len(result.chosen(rows[:3])) == 3


def test_a_run_a_folder_of_runs_and_a_folder_of_studies_are_found(study: Path) -> None:
    runs = find_runs([study])
    assert find_runs([study.parent]) == runs
    assert find_runs([*runs, study]) == runs and find_runs(runs[:1]) == runs[:1]


@pytest.mark.parametrize("name", ["nowhere", "empty", "file"])
def test_a_folder_without_runs_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=name):
        Collection.open([tmp_path / name])


def test_runs_that_must_not_be_mixed_are_refused_by_name(tmp_path: Path) -> None:
    printed = PrintedBlock(block=Block.of(1), printer="ender-3", filament="petg")
    first = write_run(tmp_path / "a", printed, Plan())
    same = write_run(tmp_path / "b", printed, Plan())
    with pytest.raises(InputError, match="same print"):
        Collection.open([first, same])
    other = PrintedBlock(block=Block.of(2), printer="ender-3", filament="petg")
    grid = write_run(tmp_path / "c", other, Plan(grid=PressGrid(x_mm=(4.0, 8.0), y_mm=(18.0, 23.0))))
    with pytest.raises(InputError, match="grid"):
        Collection.open([first, grid])
    units = write_run(tmp_path / "d", other, Plan(units="kPa"))
    with pytest.raises(InputError, match="sensor units"):
        Collection.open([first, units])
    wide = PrintedBlock(block=Block.of(2, "released"), printer="ender-3", filament="petg")
    with pytest.raises(InputError, match="block size"):
        Collection.open([first, write_run(tmp_path / "e", wide, Plan())])


def test_a_damaged_frame_is_reported_when_it_is_read(tmp_path: Path) -> None:
    (folder, *_) = write_study(tmp_path, textures=(1,), copies=1)
    result = Collection.open([folder])
    (folder / "sensor_images" / "image_3.png").write_bytes(b"no picture")
    with pytest.raises(CheckFailedError, match=r"image_3\.png"):
        result.frame(2)


def test_simulated_devices_are_listed_once(tmp_path: Path) -> None:
    write_study(tmp_path, textures=(1,), simulated="simulated TacTip")
    assert Collection.open([tmp_path]).simulated == ("sensor: simulated TacTip",)


def test_grey_and_resolution_equal_opencv() -> None:
    image = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    assert np.array_equal(Pixels()(image), grey)
    assert np.array_equal(Pixels(colour=True)(image), image)
    small = Pixels(resolution=0.5)(image)
    assert small.shape == (24, 32) and small.dtype == np.uint8
    # At half the resolution a pixel is the mean of four pixels.
    assert np.abs(small - grey.reshape(24, 2, 32, 2).mean(axis=(1, 3))).max() <= 0.5
    assert Pixels(resolution=0.4)(np.zeros((480, 640), np.uint8)).shape == (192, 256)


def test_other_arrays_are_not_changed() -> None:
    taxels = np.arange(16.0).reshape(4, 4)
    assert np.array_equal(Pixels(resolution=0.5)(taxels), taxels)
    with pytest.raises(InputError, match="resolution"):
        Pixels(resolution=0.0)


def test_prints_of_files_that_differ_from_the_block_do_not_mix_with_others(tmp_path: Path) -> None:
    def write(folder: str, model: PrinterModel | None, copy: int, printer: str = "ender-3") -> None:
        block = Block.of(1)
        file = None if model is None else corrected_for(block, model).file
        printed = PrintedBlock(block=block, printer=printer, filament="pla-plus", copy=copy, file=file)
        write_run(tmp_path / folder / printed.name, printed, Plan())

    write("plain", None, 1)
    write("corrected", PRINTER, 1)
    # The file for each printer may be corrected by the model of that printer.
    write("corrected", replace(PRINTER, scale_x=measured(0.99)), 1, "bambu-p1p")
    name = "texture-1_paper_x1_from-t1-corr_ender-3_pla-plus_copy01"
    assert name in [run.name for run in find_runs([tmp_path])]
    collection = Collection.open([tmp_path / "corrected"])
    assert {row.preset for row in collection.rows} == {"paper"}
    files = [getattr(run.info.printed, "file", None) for run in collection.runs]
    assert corrected_for(Block.of(1), PRINTER).file in files
    with pytest.raises(InputError, match=r"printed file = 'that of the block': in .*plain.*, but 'another than that"):
        Collection.open([tmp_path / "corrected", tmp_path / "plain"])
    write("remade", replace(PRINTER, scale_x=measured(0.98)), 2)
    with pytest.raises(InputError, match=r"printed file = 't1-corr': of .*remade.* differs from that of .*corrected"):
        Collection.open([tmp_path / "corrected", tmp_path / "remade"])
    # The same printer, and another printer, with the other rule for the relief.
    for printer in ("ender-3", "bambu-p1p", "form-3"):
        write(f"free-{printer}", replace(PRINTER, relief_rule="free"), 3, printer)
        with pytest.raises(InputError, match=r"printed file = 't1-free': of .*free.* differs from that of"):
            Collection.open([tmp_path / "corrected", tmp_path / f"free-{printer}"])
