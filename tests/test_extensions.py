"""The house stands without its extensions: each folder can be deleted, and all of them together."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.cases import mostly_long
from helpers.sources import ROOT

from tacbench_cad.util.entries import entries

EXTENSIONS = ROOT / "tacbench_cad" / "extensions"
NAMES = sorted(path.parent.name for path in EXTENSIONS.glob("*/__init__.py"))
STUDY = """
[study]
textures = [1, 4]
prints = [{ printer = "resin", filament = "resin", copies = 2 }]
[protocol]
positions.grid = { x_mm = [4.0, 9.0], y_mm = [18.0, 23.0] }
checks.stationary_frames = 1
repeats = 1
"""
PROGRAM = """
import sys
from tacbench_cad.cli import main

for words in (
    ["--help"],
    ["make", "--texture", "1", "--formats", "stl", "--parts", "blocks", "--out", "blocks"],
    ["check-part", "blocks/texture-1_paper_x1.stl"],
    ["simulate", "--study", "study.toml", "--out", "runs"],
    ["check-runs", "runs"],
    ["variance", "runs"],
):
    if code := main(words):
        sys.exit(f"{words} ended with {code}")
sys.exit(sum(main([word, "--help"]) != int(word in sys.argv[2].split()) * 2 for word in sys.argv[1].split()))
"""


def commands_of(extension: str) -> set[str]:
    """Return the commands that an extension adds."""
    added = entries("tacbench.commands").items()
    return {name for name, entry in added if entry.module.startswith(f"tacbench_cad.extensions.{extension}.")}


@pytest.mark.parametrize("deleted", mostly_long(["all", *NAMES], "all"))
def test_the_core_works_without_an_extension(deleted: str, tmp_path: Path) -> None:
    """Blocks are made and checked, presses are simulated and analysed; a deleted command says what is missing."""
    for package in ("tacbench_cad", "housing"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    gone = NAMES if deleted == "all" else [deleted]
    for name in gone:
        shutil.rmtree(tmp_path / "tacbench_cad" / "extensions" / name)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    missing = {command for name in gone for command in commands_of(name)}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, " ".join(entries("tacbench.commands")), " ".join(missing)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not any(f"│ {command} " in done.stdout for command in missing)
    for name in gone:
        for command in commands_of(name):
            assert f"{command} needs tacbench_cad.extensions.{name}" in done.stderr


def test_every_extension_is_described_and_tested() -> None:
    assert len(NAMES) > 10
    for name in NAMES:
        lines = (EXTENSIONS / name / "README.md").read_text(encoding="utf-8").splitlines()
        assert lines[0] == f"# {name}" and len(lines) <= 12, name
        tested = ROOT / "tests" / "extensions" / name
        assert any(tested.glob("test_*.py")), name
