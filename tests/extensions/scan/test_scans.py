"""Scans beside presses: the correlation over prints, and the section of the report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from helpers.studies import Frame, write_study

pytest.importorskip("cv2")

from tacbench_cad import lab
from tacbench_cad.extensions.scan.record import KIND, SCAN_FILE, SCHEMA
from tacbench_cad.extensions.scan.report_section import answer, rank_correlation, report_section, scan_table
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.lab.analysis.tables import Shown
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.protocol import PressGrid


def rows(groups: int, prints: int, slope: float, noise: float = 0.0) -> pd.DataFrame:
    """Return scanned prints whose distance is a power of their deviation; each texture has its own scale."""
    random = np.random.default_rng(1)
    deviations = [[0.02 * 1.3**copy * 2.0**group for copy in range(prints)] for group in range(groups)]
    return pd.DataFrame(
        {
            "texture": f"texture-{group}",
            "printer": "ender-3",
            "filament": "pla-plus",
            "top_rms_mm": deviation,
            "from_others": 100.0**group * deviation**slope * np.exp(noise * random.standard_normal()),
        }
        for group, members in enumerate(deviations)
        for deviation in members
    )


def test_a_relation_inside_of_the_textures_is_found() -> None:
    result = rank_correlation(rows(2, 6, slope=2.0, noise=0.1), "top_rms_mm")
    assert (result.prints, result.groups) == (12, 2)
    assert result.value is not None and result.low is not None
    assert result.value > 0.9 and result.low > 0.5
    assert answer(rows(2, 6, 2.0), "top_rms_mm").startswith("Prints differ more from other prints of their texture")
    assert answer(rows(2, 6, -2.0), "top_rms_mm").startswith("Prints differ less")


def test_a_relation_between_textures_alone_does_not_count() -> None:
    sentence = answer(rows(3, 4, slope=0.0, noise=1.0), "top_rms_mm")
    assert sentence.startswith("No relation can be shown")


@pytest.mark.long
def test_intervals_of_unrelated_prints_contain_zero_in_nineteen_of_twenty_studies() -> None:
    random = np.random.default_rng(2)
    covered = 0
    for _ in range(400):
        study = rows(2, 6, 1.0)
        for name in ("top_rms_mm", "from_others"):
            study[name] = np.exp(random.standard_normal(len(study)))
        result = rank_correlation(study, "top_rms_mm")
        assert result.low is not None and result.high is not None
        covered += result.low <= 0.0 <= result.high
    assert 0.92 <= covered / 400 <= 0.985


def image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """Return an image of a print: copy 3 differs most from the others."""
    shift = {1: 0.0, 2: 2.0, 3: 20.0}[printed.copy]
    return (100.0 + shift + rng.normal(0.0, 1.0, (24, 32))).astype(np.uint8)


def test_the_table_joins_each_scan_with_its_print(tmp_path: Path) -> None:
    grid = PressGrid(x_mm=(4.0,), y_mm=(20.0,))
    folders = write_study(tmp_path, textures=(1,), prints=(("ender-3", "pla-plus"),), copies=3, grid=grid, image=image)
    for copy, folder in enumerate(folders[:2] + folders[2:], start=1):
        document = {"kind": KIND, "schema": SCHEMA, "file": "scan.ply", "block": "b", "simulated": True}
        document |= {"top": {"rms_mm": 0.01 * copy}, "pin_shift_px": 0.1 * copy, "seen_fraction": 1.0}
        (folder / SCAN_FILE).write_text(json.dumps(document), encoding="utf-8")
    (folders[0] / SCAN_FILE).write_text("{}", encoding="utf-8")
    presses = lab.read(tmp_path)
    design = Design.of(presses)
    table, damaged = scan_table(design, lab.variance(presses))
    assert len(damaged) == 1 and str(folders[0] / SCAN_FILE) in damaged[0]
    second, third = (row for _, row in table.iterrows())
    assert (second["run"], second["top_rms_mm"], second["scan_simulated"]) == (folders[1].name, 0.02, "yes")
    # The means of the three prints are 100, 102 and 120 counts.
    assert third["from_others"] == pytest.approx(19.0**2, rel=0.02)
    assert second["from_others"] == pytest.approx(8.0**2, rel=0.05)
    assert scan_table(design, None)[0]["from_others"].isna().all()


def test_the_report_shows_the_scans(tmp_path: Path) -> None:
    grid = PressGrid(x_mm=(4.0,), y_mm=(20.0,))
    (folder,) = write_study(tmp_path, textures=(1,), prints=(("ender-3", "pla-plus"),), copies=1, grid=grid)
    results = Results(design=Design.of(lab.read(tmp_path)))
    assert not report_section(results).parts
    document = {"kind": KIND, "schema": SCHEMA, "file": "scan.ply", "block": "b", "simulated": False}
    (folder / SCAN_FILE).write_text(
        json.dumps(document | {"top": {"rms_mm": 0.05}, "pin_shift_px": None, "seen_fraction": 1.0}), encoding="utf-8"
    )
    section = results.added["scans"]
    parts = section.parts
    assert list(section.tables) == ["scans.csv"]
    assert "Too few prints to compare the deviation from the formula" in str(parts[1])
    assert isinstance(parts[-1], Shown) and "50" in parts[-1].texts[0]
