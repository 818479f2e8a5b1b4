"""The result of a scan: its numbers as a table, as JSON, as files and as pictures."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers.scans import true_scan

from tacbench_cad.extensions.scan.comparison import Views
from tacbench_cad.extensions.scan.deviations import top_map, wall_points
from tacbench_cad.extensions.scan.record import SCAN_FILE, ScanRecord, read_scan_record
from tacbench_cad.extensions.scan.result import Noise, PrintOrigin, ScanResult, wave_table
from tacbench_cad.extensions.scan.result_files import (
    DEVIATION_FILE,
    POINTS_FILE,
    WAVES_FILE,
    write_result,
    write_simulated,
)
from tacbench_cad.extensions.scan.simulating import ScanTruth, low_pass, stretch
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

BLOCK = Block.of(2, scale=0.5)


@cache
def result() -> ScanResult:
    truth = ScanTruth(points=20_000, noise_mm=0.01, seed=3, transfer_x=low_pass(1.0)).with_random_pose()
    truth = replace(truth, pose=replace(truth.pose, stretch=stretch((0.996, 0.998, 1.0), (0.002, 0.0, 0.0))))
    cloud, fit = true_scan(BLOCK, truth)
    top = top_map(cloud, BLOCK, fit, layer_mm=0.1)
    return ScanResult(
        cloud=cloud,
        block=BLOCK,
        fit=fit,
        top=top,
        walls=wall_points(cloud, BLOCK, fit),
        noise=Noise(rms_mm=top.noise_rms_mm, source="residuals"),
        origin=PrintOrigin(printer="ender-3", filament="pla-plus", copy=2, nozzle_mm=0.4),
    )


def test_the_table_has_the_shrinkage_the_skew_and_what_is_not_determined() -> None:
    rows = {name: (value, remark) for name, value, remark in result().rows()}
    assert rows["scale along x"] == ("0.99600", "+0.400 % shrinkage (+0.380 to +0.420)")
    assert rows["skew xy"][0] == "+0.115 degrees"
    assert rows["skew xz"] == ("not determined", "the scan does not show it")
    assert rows["crests lost"][0].endswith(f"of {result().top.peaks.count}")
    assert "% of the mean square" in rows["  scanner's noise, rms"][1]
    table = wave_table(result().fit.waves)
    assert len(table) == len(result().fit.waves)
    reference = replace(result().fit.waves[0], is_shift_reference=True)
    assert wave_table((reference,))[0][-1] == "sets the position"


def test_the_files_agree_with_the_result(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    paths = write_result(result(), tmp_path / "out")
    assert [path.name for path in paths] == [SCAN_FILE, DEVIATION_FILE, WAVES_FILE, POINTS_FILE]
    document = json.loads(paths[0].read_text(encoding="utf-8"))
    assert (document["printer"], document["copy"], document["nozzle_mm"]) == ("ender-3", 2, 0.4)
    record = read_scan_record(paths[0], ScanRecord)
    assert result().top.summary is not None
    assert (record.simulated, record.block) == (True, BLOCK.name)
    assert record.top_rms_mm == pytest.approx(result().top.summary.rms_mm)
    assert record.pin_shift_px == pytest.approx(result().top.pin_shift_px)
    with paths[1].open(encoding="utf-8") as stream:
        cells = list(csv.DictReader(stream))
    assert sum(int(cell["points"]) for cell in cells) == int(result().top.counts.sum())
    known = [float(cell["deviation_mm"]) for cell in cells]
    assert max(map(abs, known)) >= result().top.summary.largest_mm - 1e-4
    cloud = trimesh.load(paths[3])
    inside = np.array([*BLOCK.size_mm, BLOCK.height_mm]) + 0.1
    assert np.all(cloud.vertices > -0.1) and np.all(cloud.vertices < inside)
    assert len(cloud.vertices) == int(result().fit.used.sum())
    assert {cell["simulated"] for cell in cells} == {"true"}
    assert b"comment simulated scan: scan simulator" in paths[3].read_bytes()[:300]


def test_a_simulated_scan_can_be_read_again(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    write_simulated(result().cloud, tmp_path / "scan.ply")
    points = trimesh.load(tmp_path / "scan.ply").vertices
    np.testing.assert_allclose(points, result().cloud.points_mm, atol=1e-4)


@pytest.mark.parametrize("text", ['{"kind": "other"}', '{"kind": "tacbench scan", "schema": 2}', "[1]"])
def test_another_document_is_not_the_record_of_a_scan(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scan.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"scan\.json"):
        read_scan_record(path, ScanRecord)


def test_the_views_have_the_same_numbers_on_the_same_grid() -> None:
    top = result().top
    views = _views()
    rows = {name: cells for name, *cells in views.rows()}
    assert rows["height error, rms (µm)"][0] == "30"
    assert rows["height error, mean (µm)"][0] == "+30"
    assert rows["crests lost"][1] == f"{top.peaks.missed} of {top.peaks.count}"
    i, j = views.cut()
    assert 0 < i < len(top.x_mm) and 0 < j < len(top.y_mm)
    assert set(views.as_dict()) == {"as_sliced", "as_scanned"}


@pytest.mark.parametrize("name", ["deviation", "waves", "comparison"])
def test_a_picture_says_that_the_scan_is_simulated(tmp_path: Path, name: str) -> None:
    pytest.importorskip("matplotlib")
    from tacbench_cad.extensions.scan.scan_pictures import comparison_picture, deviation_picture, waves_picture

    path = tmp_path / f"{name}.svg"
    if name == "comparison":
        comparison_picture(_views(), path)
    else:
        {"deviation": deviation_picture, "waves": waves_picture}[name](result(), path)
    assert "simulated scan" in path.read_text(encoding="utf-8")


def _views() -> Views:
    top = result().top
    printed = {"as sliced": top.formula_mm + 0.03, "as scanned": top.printed_mm}
    return Views(top=replace(top, layer_mm=0.1), printed_mm=printed, simulated=True)
