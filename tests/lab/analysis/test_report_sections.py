"""Sections of a report that other packages add by an entry point."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from helpers.devices import install_package
from helpers.sources import ROOT
from helpers.studies import write_study

pytest.importorskip("cv2")

from tacbench_cad import lab
from tacbench_cad.lab.analysis.report.page import write_files
from tacbench_cad.lab.analysis.report.results import Results
from tacbench_cad.lab.analysis.study_design import Design
from tacbench_cad.util.entries import groups


def test_the_section_of_the_manual_is_in_the_document_and_its_table_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "docs/extending.md").read_text(encoding="utf-8")
    code = re.search(r"```python write=weather.py\n(.*?)```", page, re.DOTALL)
    assert code is not None
    point = "[tacbench.report_sections]\nweather = weather:section\ngone = no_such_package:section\n"
    install_package(tmp_path / "site", monkeypatch, point, weather=code.group(1))
    try:
        (run,) = write_study(tmp_path / "runs", textures=(1,), prints=(("ender-3", "pla-plus"),), copies=1)
        results = Results(design=Design.of(lab.read(tmp_path / "runs")))
        page = write_files(results, tmp_path / "files")
    finally:
        groups.cache_clear()
    assert '<details id="weather"><summary><h2>Weather</h2>' in page and f"<td>{run.name}</td>" in page
    assert (tmp_path / "files" / "weather.csv").read_text(encoding="utf-8").count(run.name) == 1
    assert "no_such_package, which is not installed" in page
