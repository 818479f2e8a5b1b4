"""``tacbench import``: small arrays in the authors' two layouts, their spellings, and what is refused."""

from __future__ import annotations

import json
import pickle
import re
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.cli import main
from tacbench_cad.lab.runs import writing
from tacbench_cad.lab.runs.authors import AuthorsFile, ImportOptions, gather_authors_files, import_block
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import sha256

Capture = pytest.CaptureFixture[str]
SHAPE = (16, 24, 3)


def images(seed: int, repeats: int = 2) -> Any:
    """Readings of one block at one force: (1, repeats, 5, 5, height, width, 3)."""
    return np.random.default_rng(seed).integers(0, 256, (1, repeats, 5, 5, *SHAPE), dtype=np.uint8)


def save(folder: Path, name: str, array: Any) -> Path:
    path = folder / name
    np.save(path, array)
    return path


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("first_axis", ["y", "x"])
def test_every_image_lands_at_its_press(flat: bool, first_axis: Any, tmp_path: Path) -> None:
    array = images(1)
    stored = array.reshape(50, *SHAPE) if flat else array
    path = save(tmp_path, "PLAminus_z0_P40_Bambu.npy", stored)
    how = ImportOptions(first_axis=first_axis)
    folder = import_block(gather_authors_files([path], how)[0], tmp_path / "out")
    assert folder.name == "texture-1_released_x1_bambu-p1p_pla-minus_copy01"
    run = Run.open(folder)
    assert len(run.rows) == 50
    x_mm, y_mm = (4.0, 5.25, 6.5, 7.75, 9.0), (18.0, 19.25, 20.5, 21.75, 23.0)
    for row in run.rows:
        i, j = divmod(row.position - 1, 5) if first_axis == "y" else divmod(row.position - 1, 5)[::-1]
        assert np.array_equal(run.frame(row, verify=True), array[0, row.repeat - 1, i, j])
        along_x, along_y = (j, i) if first_axis == "y" else (i, j)
        assert row.pose_mm[:2] == (x_mm[along_x], y_mm[along_y])


def test_what_nobody_recorded_stays_empty(tmp_path: Path) -> None:
    path = save(tmp_path, "resin_z3.2_P50_resin.npy", images(1))
    run = Run.open(import_block(gather_authors_files([path], ImportOptions())[0], tmp_path / "out"))
    row = run.rows[0]
    assert (row.object_label, row.printer, row.filament, row.copy) == (4, "form-3", "grey-v4", 2)
    assert (row.force_level, row.target_force_n) == (3, 3.0137)
    assert (row.measured_force_n, row.force_after_n, row.in_band, row.time_utc, row.reference_age_s) == (None,) * 5
    assert np.isnan(row.pose_mm[2])
    assert run.info.levels == (3,)
    assert run.info.simulated == ()
    assert json.loads((run.folder / "env_params.json").read_text())["robot"] == "arduino"
    source = json.loads((run.folder / "run.json").read_text())["source"]
    assert source["files"] == [{"name": path.name, "sha256": sha256(path), "force_level": 3}]


def test_the_levels_of_a_block_become_one_run_and_blocks_stay_apart(tmp_path: Path) -> None:
    arrays = {name: images(seed) for seed, name in enumerate(("P30", "P40", "P50"))}
    paths = [save(tmp_path, f"Plaplus_z5_{name}_creality.npy", array) for name, array in arrays.items()]
    paths.append(save(tmp_path, "PLAplus_z5.4_P30_crealty.npy", images(9)))
    blocks = gather_authors_files(paths[::-1], ImportOptions())
    assert [[one.level for one in block.files] for block in blocks] == [[1, 2, 3], [1]]
    folders = [import_block(block, tmp_path / "out") for block in blocks]
    run = Run.open(folders[0])
    assert len(run.rows) == 150
    for level, array in enumerate(arrays.values(), start=1):
        assert np.array_equal(run.frame(run.by_key[(level, 2, 25)]), array[0, 1, 4, 4])
    for folder in folders:
        assert check_run(folder).ok


def test_an_interrupted_import_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save(tmp_path, "PLAminus_z0_P30_Ender.npy", images(1))
    block = gather_authors_files([path], ImportOptions())[0]
    real = writing.RunWriter.press

    def interrupted(self: Any, press: Any, *rest: Any) -> None:
        if press.number == 20:
            raise KeyboardInterrupt
        real(self, press, *rest)

    monkeypatch.setattr(writing.RunWriter, "press", interrupted)
    with pytest.raises(KeyboardInterrupt):
        import_block(block, tmp_path / "out")
    monkeypatch.undo()
    told: list[tuple[int, int]] = []
    folder = import_block(block, tmp_path / "out", lambda done, of: told.append((done, of)))
    assert told[0] == (20, 50) and told[-1] == (50, 50)
    assert check_run(folder).ok


def test_another_file_under_the_same_name_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path, "PLAminus_z0_P30_Ender.npy", images(1))
    import_block(gather_authors_files([path], ImportOptions())[0], tmp_path / "out")
    save(tmp_path, path.name, images(2))
    with pytest.raises(InputError, match=r"was begun with other settings: source.files"):
        import_block(gather_authors_files([path], ImportOptions())[0], tmp_path / "out")


@pytest.mark.parametrize(
    ("name", "printer", "filament"),
    [
        ("PLAminus_z0_P30_Bambu.npy", "bambu-p1p", "pla-minus"),
        ("Plaplus_z0_P30_bambu.npy", "bambu-p1p", "pla-plus"),
        ("PLAplus_z0_P30_Ender.npy", "ender-3", "pla-plus"),
        ("PETG_z0_P30_ender.npy", "ender-3", "petg"),
        ("Plaminus_z0_P30_creality.npy", "ender-3-v3-se", "pla-minus"),
        ("PLAminus_z0_P30_crealty.npy", "ender-3-v3-se", "pla-minus"),
        ("resin_z0_P30_resin.npy", "form-3", "grey-v4"),
        ("resin_z0_p30_Resin.npy", "form-3", "grey-v4"),
    ],
)
def test_the_authors_spellings_are_known(name: str, printer: str, filament: str, tmp_path: Path) -> None:
    one = AuthorsFile.of(save(tmp_path, name, images(1)), ImportOptions())
    assert (one.printer, one.filament, one.level, one.repeats) == (printer, filament, 1, 2)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("PLAminus_z0_P30_Banbu.npy", "printer = 'Banbu': did you mean \"bambu\""),
        ("PLAmines_z0_P30_Bambu.npy", "filament = 'PLAmines': did you mean \"plaminus\""),
        ("PLAminus_z6_P30_Bambu.npy", "z6 is no texture"),
        ("PLAminus_z0_P35_Bambu.npy", "P35 is no known force level; --force-levels has P30=1, P40=2, P50=3"),
        ("PLAminus_z0.0_P30_Bambu.npy", "copy 0 must be from 1"),
        ("PLAminus_0_P30_Bambu.npy", "must be named"),
        ("PLAminus_z0_P30_Bambu_2.npy", "must be named"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest(name: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        gather_authors_files([save(tmp_path, name, images(1))], ImportOptions())
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((49, *SHAPE), np.uint8),
        np.zeros((0, *SHAPE), np.uint8),
        np.zeros((50, 16, 24, 4), np.uint8),
        np.zeros((50, 16, 24), np.uint8),
        np.zeros((50, 4, 24, 3), np.uint8),
        np.zeros((2, 2, 5, 5, *SHAPE), np.uint8),
        np.zeros((1, 2, 4, 5, *SHAPE), np.uint8),
        np.zeros((50, *SHAPE), np.float64),
        np.zeros((50, *SHAPE), np.int8),
        np.asfortranarray(np.zeros((50, *SHAPE), np.uint8)),
        np.zeros((), np.uint8),
    ],
)
def test_other_shapes_and_types_are_refused(array: Any, tmp_path: Path) -> None:
    path = save(tmp_path, "PLAminus_z0_P30_Bambu.npy", array)
    with pytest.raises(InputError, match=r"has shape|are uint8"):
        gather_authors_files([path], ImportOptions())


def test_one_array_cannot_become_two_copies(tmp_path: Path) -> None:
    path, out = save(tmp_path, "PLAminus_z0_P30_Bambu.npy", images(1)), tmp_path / "out"
    first = import_block(gather_authors_files([path], ImportOptions())[0], out)
    (out / "damaged").mkdir()
    (out / "damaged" / "run.json").write_text("{")
    with pytest.raises(InputError, match=f"is there already, as {re.escape(str(first))}"):
        import_block(gather_authors_files([path], ImportOptions(unnumbered_copy=2))[0], out)
    assert import_block(gather_authors_files([path], ImportOptions())[0], out) == first
    assert sorted(one.name for one in out.iterdir()) == ["damaged", first.name]


def test_a_folder_in_place_of_files_is_told_how(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"is a folder; name its files, as .*/\*\.npy"):
        gather_authors_files([tmp_path], ImportOptions())


def test_bad_files_are_refused_and_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "PLAminus_z0_P30_Bambu.npy"
    np.save(path, np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="holds pickled objects"):
        gather_authors_files([path], ImportOptions())
    path.write_bytes(pickle.dumps(images(1)))
    with pytest.raises(InputError, match="is pickled"):
        gather_authors_files([path], ImportOptions())
    np.save(path, images(1))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="is truncated"):
        gather_authors_files([path], ImportOptions())
    with pytest.raises(InputError, match="is a folder"):
        gather_authors_files([tmp_path.rename(tmp_path.with_name("PLAminus_z0_P30_Bambu.npy"))], ImportOptions())
    with pytest.raises(InputError, match="No such file"):
        gather_authors_files([tmp_path / "PLAminus_z1_P30_Bambu.npy"], ImportOptions())


def test_two_files_of_one_block_and_level_are_refused_with_the_way_out(tmp_path: Path) -> None:
    paths = [save(tmp_path, f"resin_z0{copy}_P30_resin.npy", images(1)) for copy in ("", ".1")]
    with pytest.raises(InputError, match="--unnumbered-copy"):
        gather_authors_files(paths, ImportOptions())
    assert [block.files[0].copy for block in gather_authors_files(paths, ImportOptions(unnumbered_copy=6))] == [1, 6]


def test_levels_of_a_block_must_agree(tmp_path: Path) -> None:
    paths = [save(tmp_path, f"resin_z0_P{30 + 10 * i}_resin.npy", images(1, repeats=i + 1)) for i in range(2)]
    with pytest.raises(InputError, match="of the same block has 1 x 25"):
        gather_authors_files(paths, ImportOptions())


def test_memory_stays_flat(tmp_path: Path) -> None:
    array = np.random.default_rng(0).integers(0, 256, (50, 120, 160, 3), dtype=np.uint8)
    paths = [save(tmp_path, f"resin_z{z}_P30_resin.npy", array + np.uint8(z)) for z in range(3)]
    blocks = gather_authors_files(paths, ImportOptions())
    import_block(blocks[0], tmp_path / "out")
    tracemalloc.start()
    for block in blocks[1:]:
        import_block(block, tmp_path / "out")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < array.nbytes / 2


def test_the_command_imports_and_says_where(tmp_path: Path, capsys: Capture) -> None:
    for level in ("P20", "P30"):
        save(tmp_path, f"PLAminus_z0_{level}_Bambu.npy", images(int(level[1:])))
    files = [str(path) for path in sorted(tmp_path.glob("*.npy"))]
    words = ["import", *files, "--out", str(tmp_path / "out"), "--force-levels", "p20=1,P30=2"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert "1 run in" in said.out and "2 force levels" in said.err
    assert main(["runs", "check", str(tmp_path / "out")]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--first-axis", "z"], "first axis = 'z': allowed: x, y"),
        (["--force-levels", "P30"], "force levels = '': must be a whole number"),
        (["--force-levels", "P30=1,P40=1"], "must name each level's number once"),
        (["--force-levels", "P30=4"], "must be from 1 to 3"),
        (["--force-levels", "P30=1,P30=2"], "names P30 twice"),
        (["--force-levels", "30=1"], "must be as P30"),
        (["--unnumbered-copy", "one"], "must be a whole number"),
        (["--unnumbered-copy", "0"], "copy 0 must be from 1"),
        (["--preset", "papers"], 'did you mean "paper"'),
    ],
)
def test_wrong_options_are_refused(words: list[str], message: str, tmp_path: Path, capsys: Capture) -> None:
    path = save(tmp_path, "PLAminus_z0_P30_Bambu.npy", images(1))
    assert main(["import", str(path), "--out", str(tmp_path / "out"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
