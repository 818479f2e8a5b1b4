"""Run the commands of a rig on virtual Marlin, which withholds short moves as most builds of Marlin do."""

from __future__ import annotations

import io
import sys
import tomllib
from pathlib import Path

import pytest

from tacbench_cad.cli import main
from tacbench_cad.lab.runs.reading import Run

pytestmark = pytest.mark.usefixtures("rig_time")
STUDY = """
out = "runs"
[block]
texture = 2
printer = "bambu-p1p"
filament = "pla-minus"
[protocol]
targets.contact = "{contact}"
positions.grid = {{ x_mm = {x}, y_mm = {y} }}
{targets}
repeats = 1
checks.stationary_frames = 0
limits.clearance_mm = 1.0
[stage]
driver = "virtual-marlin"
origin_mm = [16.0, 2.0, 97.0]
options = {{ speed = 100.0, z_steps_per_mm = {steps} }}
[gauge]
driver = "virtual-serial"
[sensor]
driver = "simulated"
"""
#: The band of the paper's lightest force, which the search reaches with moves of a few motor steps.
FORCES = "targets.forces_n = [0.08045]\ntargets.bands_n = [0.00195]"


def study(folder: Path, contact: str, steps: int, x: str = "[4.0]", y: str = "[18.0]") -> Path:
    path = folder / "study.toml"
    targets = FORCES if contact == "force" else "targets.depths_mm = [0.353]"
    path.write_text(STUDY.format(contact=contact, targets=targets, steps=steps, x=x, y=y))
    return path


@pytest.mark.parametrize(("contact", "steps"), [("force", 400), pytest.param("depth", 2560, marks=pytest.mark.long)])
def test_presses_are_made(contact: str, steps: int, tmp_path: Path) -> None:
    path = study(tmp_path, contact, steps)
    assert main(["acquire", str(path)]) == 0
    (folder,) = (path for path in (tmp_path / "runs").iterdir() if path.is_dir())
    (row,) = Run.open(folder).rows
    assert row.in_band is (True if contact == "force" else None)
    height_steps = steps * (row.pose_mm[2] + 97.0)
    assert height_steps == pytest.approx(round(height_steps), abs=0.2), "the pose is that of the motors"


def test_align_takes_short_steps_also_at_the_upper_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = study(tmp_path, "force", 400, "[4.0, 9.0]", "[18.0, 23.0]")
    lines = [
        *("x 20 y 20", "x 0.05 y -0.05", "ok", "x 4.95 y 0.05", "ok", "x 0.025", "ok", "y -0.0125", "ok", "ok"),
        *("z -2", "z -1", "z -0.01", "z -0.0025", "ok"),
    ]
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
    assert main(["rig", "align", str(path)]) == 0
    origin = tomllib.loads(path.read_text())["stage"]["origin_mm"]
    assert origin == pytest.approx([16.0, 2.0, 96.9875], abs=0.1)
    assert origin[2] == pytest.approx(96.9875, abs=1e-4)
