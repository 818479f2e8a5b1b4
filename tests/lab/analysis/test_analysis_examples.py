"""The examples that analyse presses run as they stand on a folder of runs, and on a folder of images."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.sources import ROOT
from helpers.studies import Frame, write_study

from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock

EXAMPLES = ROOT / "examples"


def pattern(shift_px: float) -> Frame:
    """Return a smooth pattern that is moved along x."""
    return np.tile(128.0 + 60.0 * np.sin((np.arange(96) - shift_px) / 6.0), (64, 1)).astype(np.uint8)


def moved(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """Return the pattern after a press, which moves it by 1 px for texture 1 and by 3 px for texture 2."""
    return pattern({1: 1.0, 2: 3.0}[int(printed.object_label)] + 0.2 * rng.normal())


def run(name: str, *arguments: str) -> None:
    """Run an example as a script."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_a_pipeline_is_tested_on_unseen_copies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_study(tmp_path / "runs")
    run("own_pipeline.py", str(tmp_path / "runs"))
    shown = capsys.readouterr().out
    assert "(64, 48, 64) uint8" in shown
    assert len(re.findall(r"[01]\.\d*", shown.splitlines()[-1])) == 2


@pytest.mark.usefixtures("no_figures", "few_trees")
def test_optical_flow_is_a_feature_of_every_analysis(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_study(Path("runs"), shape=(64, 96), image=moved, resting=lambda rng: pattern(0.0))
    run("optical_flow.py", "runs")
    assert "flow.html" in capsys.readouterr().out.splitlines()[-1]
    assert (tmp_path / "flow_files" / "variance" / "variance.csv").is_file()
    source = (EXAMPLES / "optical_flow.py").read_text(encoding="utf-8")
    assert len(source.splitlines()) < 40
