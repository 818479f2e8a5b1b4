"""The lab where no CAD package can be imported, as on a small computer beside a rig."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from helpers.small_study import STUDY

BLOCKED = ("OCP", "cadquery", "build123d", "pymeshlab", "gmsh", "vtkmodules", "matplotlib", "housing")
CODE = f"""
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {BLOCKED!r}:
            raise ModuleNotFoundError(name + " is blocked", name=name)
sys.meta_path.insert(0, Blocker())
from tacbench_cad.cli import main
commands = [command.split("\\n") for command in sys.argv[1:]]
codes = [main(command) for command in commands]
assert codes == [0] * len(commands)
assert not [name for name in sys.modules if name.split(".")[0] in {BLOCKED!r}]
"""


def _tacbench(*commands: tuple[str | Path, ...]) -> str:
    """What commands print that are run one after the other in a new process."""
    lines = ["\n".join(map(str, command)) for command in commands]
    done = subprocess.run([sys.executable, "-c", CODE, *lines], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="the virtual rig needs pseudo-terminals; Windows has none")
@pytest.mark.parametrize("driver", ["virtual-grbl", "virtual-marlin"])
def test_a_block_is_pressed_and_checked(tmp_path: Path, driver: str) -> None:
    study = tmp_path / "study.toml"
    study.write_text(STUDY.replace("virtual-grbl", driver))
    said = _tacbench(("acquire", study, "--out", tmp_path / "runs"), ("runs", "check", tmp_path / "runs"))
    assert "2 presses: nothing wrong" in said
    (info,) = (tmp_path / "runs").glob("*/run.json")
    assert "simulated TacTip" in info.read_text(encoding="utf-8")


def test_a_study_is_simulated_and_checked(tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text(STUDY.partition("[stage]")[0])
    simulate = ("simulate", "--study", study, "--out", tmp_path / "runs", "--jobs", "1")
    assert "2 presses: nothing wrong" in _tacbench(simulate, ("runs", "check", tmp_path / "runs"))
