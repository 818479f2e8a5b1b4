"""The command ``tacbench scan``: a simulated scan from end to end, its files, the run folder, and errors."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from helpers.gcode_writer import write_gcode
from helpers.printers import write_corrected
from helpers.studies import write_study

from tacbench_cad.cli import main
from tacbench_cad.extensions.scan import Cloud, analysing, fit_scan, read_scan
from tacbench_cad.extensions.scan.record import SCAN_FILE, ScanRecord, read_scan_record
from tacbench_cad.extensions.scan.result_files import write_simulated
from tacbench_cad.extensions.scan.simulating import ScanTruth, low_pass, simulate_scan
from tacbench_cad.spec.block import Block

pytest.importorskip("trimesh")
Capture = pytest.CaptureFixture[str]
BLOCK = Block.of(2, scale=0.5)
HALF = ("--block", "2", "--scale", "0.5")
LAYER_MM = 0.1


@pytest.fixture(autouse=True)
def _no_roughness(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the roughness, because surfalize takes seconds to load; it has its own tests."""
    monkeypatch.setattr(analysing, "why_missing", lambda *_: "surfalize is left out in this test")


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a simulated scan of a print that has lost some of its short waves."""
    path = tmp_path_factory.mktemp("scan") / "top.ply"
    truth = ScanTruth(points=15_000, noise_mm=0.01, transfer_x=low_pass(0.5), seed=2).with_random_pose()
    write_simulated(simulate_scan(BLOCK, truth), path)
    return path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_table_and_the_files_of_a_scan(scan: Path, folder: Path, capsys: Capture) -> None:
    assert main(["scan", str(scan), *HALF, "--no-picture", "--limits", "pin_shift_px=none,wall_outward_mm=none"]) == 0
    captured = capsys.readouterr()
    assert "simulated scan of texture-2_paper_x0.5, 15,000 points" in captured.out
    assert "scale along x" in captured.out and "printed / formula" in captured.out
    verdict, following = captured.out.splitlines()[-2:]
    assert verdict.startswith("within the limits: ")
    assert following == "Next: tacbench printer-model top_scan -o my-printer.toml"
    assert "No roughness by ISO 25178: surfalize is left out" in captured.err
    assert {path.name for path in (folder / "top_scan").iterdir()} == {
        *(SCAN_FILE, "deviation.csv", "waves.csv", "deviation.ply")
    }


@pytest.mark.parametrize("word", ["all", "later"])
def test_one_block_is_simulated_and_not_the_first_of_several(word: str, folder: Path, capsys: Capture) -> None:
    assert main(["scan", "--simulate", "scan.ply", "--block", word]) == 2
    assert f"block = '{word}': must be a single one with --simulate" in capsys.readouterr().err
    assert not (folder / "scan.ply").exists()


def test_a_limit_that_is_not_met_gives_exit_code_1_and_one_line(scan: Path, folder: Path, capsys: Capture) -> None:
    words = ["--limits", "top_rms_mm=0.000001", "--printer", "ender-3", "--copy", "3", "--json", "--no-picture"]
    assert main(["scan", str(scan), *HALF, *words]) == 1
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is False and document["verdict"].startswith("beyond the limits: rms deviation")
    assert (document["printer"], document["copy"], document["simulated"]) == ("ender-3", 3, True)
    stored = json.loads((folder / "top_scan" / SCAN_FILE).read_text(encoding="utf-8"))
    assert stored == {name: value for name, value in document.items() if name not in ("folder", "files")}


def test_the_sliced_surface_is_compared_on_the_same_grid(scan: Path, folder: Path, capsys: Capture) -> None:
    gcode = write_gcode(folder / "half.gcode", BLOCK, layer_mm=LAYER_MM)
    words = ["--compare", str(gcode), "--json", "--no-picture", "--limits", "pin_shift_px=none"]
    assert main(["scan", str(scan), *HALF, *words]) == 0
    document = json.loads(capsys.readouterr().out)
    views = document["comparison"]
    assert json.loads((folder / "top_scan" / SCAN_FILE).read_text(encoding="utf-8"))["comparison"] == views
    assert document["layer_mm"] == pytest.approx(LAYER_MM) and views["as_scanned"]["peaks"] == document["peaks"]
    assert set(views) == {"as_sliced", "as_scanned"}
    assert views["as_sliced"]["height_error"]["count"] >= views["as_scanned"]["height_error"]["count"] > 1000


def test_a_run_folder_names_the_block_and_receives_the_numbers(folder: Path) -> None:
    (run,) = write_study(folder / "runs", textures=(1,), prints=(("ender-3", "pla-plus"),), copies=1)
    cloud = simulate_scan(Block.of(1), ScanTruth(points=15_000, seed=4).with_random_pose())
    write_simulated(cloud, folder / "scan.ply")
    main(["scan", "scan.ply", "--block", str(run), "--no-picture"])
    record = read_scan_record(run / SCAN_FILE, ScanRecord)
    assert record.block.startswith("texture-1") and record.simulated
    document = json.loads((run / SCAN_FILE).read_text(encoding="utf-8"))
    assert document["printer"] and document["copy"] == 1


def test_a_copy_of_a_simulated_scan_has_other_points_and_the_next_command_names_the_same_block(
    folder: Path, capsys: Capture
) -> None:
    words = ["--block", "2", "--preset", "released", "--scale", "0.5", "--key"]
    assert main(["scan", "--simulate", "first.ply", *words]) == 0
    assert capsys.readouterr().out == "Next: tacbench scan first.ply --block 2 --preset released --scale 0.5 --key 3\n"
    assert main(["scan", "--simulate", "second.ply", *words, "--copy", "2"]) == 0
    first, second = (read_scan(folder / name).cloud.points_mm for name in ("first.ply", "second.ply"))
    assert first.shape == second.shape and not np.array_equal(first, second)


def test_a_simulated_scan_of_a_corrected_file_shows_its_print(folder: Path) -> None:
    write_corrected(folder, BLOCK)
    file = ["--printed-from", f"{BLOCK.texture.name}.toml"]
    assert main(["scan", "--simulate", "corrected.ply", *HALF, *file]) == 0
    points = read_scan(folder / "corrected.ply").cloud.points_mm[:20_000]
    fit = fit_scan(Cloud(points_mm=points, source="corrected.ply"), BLOCK)
    # The simulated printer shrinks 0.4 %. The file is larger, by the scales of the model.
    assert [fit.parameter(f"scale_{axis}").value for axis in "xy"] == pytest.approx([1.0, 0.996 / 0.995], abs=5e-4)
    main(["scan", "corrected.ply", *HALF, *file, "--no-picture", "--out", "result"])
    document = json.loads((folder / "result" / SCAN_FILE).read_text(encoding="utf-8"))
    assert document["block"] == BLOCK.name and document["printed_from"].startswith("t2-corr_")
    # A model needs scans of prints of plain files.
    assert (
        main(["printer-model", "result", "--printer", "a", "--filament", "b", "--nozzle", "0.4", "-o", "m.toml"]) == 2
    )


def test_points_without_a_value_are_counted_and_a_cloud_has_no_pixels(
    scan: Path, folder: Path, capsys: Capture
) -> None:
    points = read_scan(scan).cloud.points_mm
    points[100:107] = np.nan
    np.savetxt("top.xyz", points)
    assert main(["scan", "top.xyz", *HALF, "--unit", "mm", "--no-picture", "--limits", "pin_shift_px=none"]) in (0, 1)
    assert "Without a valid value and left out: 7 points." in capsys.readouterr().err
    assert main(["scan", "top.xyz", *HALF, "--unit", "mm", "--mm-per-pixel", "0.1"]) == 2
    assert "top.xyz is not a height map" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "name a scan"),
        (["missing.ply", "--block", "2"], "missing.ply"),
        (["scan.ply", "--simulate", "a.ply"], "leave out scan.ply"),
        (["--simulate", "a.stl"], "must end in .ply"),
        (["scan.ply", "--block", "textur-4"], "texture"),
        (["scan.ply", "--limits", "top=1"], "top_rms_mm"),
        (["scan.ply", "--layer", "-1"], "layer"),
        (["scan.ply", "--layer", "0"], "layer"),
        (["scan.ply", "--printer", "Ender 3 S1"], "printer"),
    ],
)
def test_wrong_input_is_one_clear_line(folder: Path, capsys: Capture, words: Sequence[str], message: str) -> None:
    assert main(["scan", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and message in error
