"""The lab where no CAD package can be imported, as on a small computer beside a rig."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

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


def test_blocks_are_pressed_studies_simulated_and_both_checked(tmp_path: Path) -> None:
    """All in one process: most of its time goes into loading what it needs."""
    commands: list[tuple[str | Path, ...]] = []
    drivers = () if sys.platform == "win32" else ("virtual-grbl", "virtual-marlin")  # they need pseudo-terminals
    for driver in drivers:
        study = tmp_path / f"{driver}.toml"
        study.write_text(STUDY.replace("virtual-grbl", driver))
        commands.append(("acquire", study, "--out", tmp_path / "runs" / driver))
    study = tmp_path / "study.toml"
    study.write_text(STUDY.partition("[stage]")[0])
    commands.append(("simulate", "--study", study, "--out", tmp_path / "runs" / "simulated", "--jobs", "1"))
    names = (*drivers, "simulated")
    said = _tacbench(*commands, ("runs", "check", *(tmp_path / "runs" / name for name in names)))
    assert f"{len(names)} runs, {2 * len(names)} presses: nothing wrong" in said
    for name in names:
        (info,) = (tmp_path / "runs" / name).glob("*/run.json")
        assert "simulated TacTip" in info.read_text(encoding="utf-8")
