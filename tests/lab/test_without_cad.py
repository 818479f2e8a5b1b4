"""Test the lab without CAD packages, as on a small computer next to a rig."""

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
    """Return the output of commands that run one after the other in a new process."""
    lines = ["\n".join(map(str, command)) for command in commands]
    result = subprocess.run([sys.executable, "-c", CODE, *lines], capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stderr
    return result.stdout + result.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="virtual firmware needs pseudo-terminals")
@pytest.mark.parametrize("driver", ["virtual-grbl", pytest.param("virtual-marlin", marks=pytest.mark.long)])
def test_a_block_is_pressed_simulated_and_checked(driver: str, tmp_path: Path) -> None:
    pressed, simulated, runs = tmp_path / "pressed.toml", tmp_path / "simulated.toml", tmp_path / "runs"
    pressed.write_text(STUDY.replace("virtual-grbl", driver))
    simulated.write_text(STUDY.partition("[stage]")[0])
    output = _tacbench(
        ("acquire", pressed, "--out", runs / "a"),
        ("simulate", "--study", simulated, "--out", runs / "b", "--jobs", "1"),
        ("check-runs", runs),
    )
    assert "2 runs, 4 presses: nothing wrong" in output
    assert all("simulated TacTip" in info.read_text(encoding="utf-8") for info in runs.glob("*/*/run.json"))
