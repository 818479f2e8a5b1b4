"""Test ``tacbench rig wizard`` with typed answers: virtual, interrupted, and with ports of virtual firmware."""

from __future__ import annotations

import io
import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad.cli import main, rig_wizard
from tacbench_cad.cli.rig_wizard import first_press
from tacbench_cad.extensions.virtual_rig import FlatSpring
from tacbench_cad.lab.acquire.study_file import read_study, virtual_study
from tacbench_cad.lab.rig.calibration import CalibrationPoint, fit, write_calibration
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.loadcell import LoadCellOptions, open_load_cell
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.study.editing import store_keys
from tacbench_cad.util.errors import InputError

pytest.importorskip("serial")
pytest.importorskip("cv2")

EXAMPLES = Path(__file__).parents[2] / "examples" / "rigs"
BLOCK = ("1", "ender-3", "pla-minus")


@pytest.fixture(autouse=True)
def nothing_plugged_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rig_wizard, "candidates", list)
    monkeypatch.setattr(rig_wizard, "cameras", lambda folders: [])


def typed(monkeypatch: pytest.MonkeyPatch, *lines: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(line + "\n" for line in lines)))


def no_calibration(port: str, file: Path) -> None:
    raise AssertionError("the calibration is already there")


def no_alignment(path: Path) -> None:
    raise AssertionError("the block is already aligned")


@pytest.mark.usefixtures("rig_time")
def test_from_nothing_to_the_first_press_on_the_simulated_rig(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.toml"
    typed(monkeypatch, *BLOCK, "virtual", "")
    assert main(["rig", "wizard", str(path)]) == 0
    (folder,) = (path for path in (tmp_path / "first-press").iterdir() if path.is_dir())
    (row,) = Run.open(folder).rows
    assert row.measured_force_n == pytest.approx(0.1, abs=0.02)
    assert (row.pose_x, row.pose_y) == pytest.approx((6.5, 20.5), abs=0.01)
    output = capsys.readouterr().out
    assert f"with {row.measured_force_n:.3f} N" in output
    assert output.splitlines()[-1].endswith(f"acquire {path}")
    # The template's explanations are still there, and the file describes the whole study, not only the first press.
    assert "# The stable name of a port" in path.read_text()
    assert read_study(path).study.presses == 150


def test_an_interrupted_wizard_continues_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.toml"
    typed(monkeypatch, "4", "Ender 3", "ender-3")
    assert main(["rig", "wizard", str(path)]) == 2
    assert "printer = 'Ender 3'" in capsys.readouterr().err
    stored = tomllib.loads(path.read_text())["block"]
    assert stored == {"texture": "4", "printer": "ender-3", "filament": ""}
    typed(monkeypatch, "pla-minus", "virtual")
    assert main(["rig", "wizard", str(path)]) == 2
    assert tomllib.loads(path.read_text())["stage"]["driver"] == "simulated"


@pytest.mark.usefixtures("rig_time")
@pytest.mark.parametrize(
    ("machine", "firmware", "limits", "top_mm"),
    [
        ("ender-3", {"kind": "marlin", "start_mm": (80.0, 80.0, 60.0)}, "0 200, 0 200, 0 100", 40.0),
        (
            "cnc-3018",
            {"kind": "grbl", "origin": "switch", "start_mm": (-100.0, -100.0, -40.0), "settings": {1: 255.0}},
            "-199 -1, -199 -1, -99 -1",
            -60.0,
        ),
    ],
)
def test_the_files_of_two_machines_are_set_up_at_ports_of_virtual_firmware(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    machine: str,
    firmware: dict[str, Any],
    limits: str,
    top_mm: float,
) -> None:
    """The stage is identified at its port, the load cell is calibrated, and the press reaches its force."""
    from helpers.rig_here import launch

    path, stiffness = tmp_path / "rig.toml", 0.4
    middle = 80.0 if top_mm > 0.0 else -120.0
    with launch(**firmware, speed=20.0) as virtual:

        def calibrate(port: str, file: Path) -> None:
            points = []
            with open_load_cell(port, None, clock=Clock(), options=LoadCellOptions()) as cell:
                for mass_g in (0.0, 100.0, 200.0):
                    # A spring that is compressed by 1 mm replaces the mass.
                    virtual.put(FlatSpring(flat_z_mm=firmware["start_mm"][2] + 1.0, n_per_mm=9.80665e-3 * mass_g))
                    cell.mean(0.2)
                    raw = cell.mean(0.3)
                    point = CalibrationPoint(
                        mass_g=mass_g, counts=raw.mean, spread_counts=raw.spread, samples=raw.samples
                    )
                    points.append(point)
            write_calibration(file, fit(points, date_utc="2026-01-01T00:00:00Z", device=port))
            virtual.put(FlatSpring(flat_z_mm=top_mm, n_per_mm=stiffness))

        def align(study: Path) -> None:
            store_keys(study, "stage", {"origin_mm": [middle, middle, top_mm]})

        # The limits are those of the virtual machine, so the wizard asks for them.
        text = (EXAMPLES / f"{machine}.toml").read_text()
        path.write_text(re.sub(r"^limits_mm = .*$", "limits_mm = []", text, flags=re.MULTILINE))
        store_keys(path, "sensor", {"driver": "simulated", "exposure": None})
        answers = (virtual.port, "0 200, 200 0, 0 100", limits, virtual.gauge_port, "kilograms", "counts", "", "")
        typed(monkeypatch, *BLOCK, *answers)
        rig_wizard.run(path, calibrate, align)
        document = tomllib.loads(path.read_text())
        assert document["stage"]["driver"] == firmware["kind"]
        assert [f"{low:g} {high:g}" for low, high in document["stage"]["limits_mm"]] == limits.split(", ")
        assert document["gauge"] == {"driver": "serial", "port": virtual.gauge_port, "calibration": "gauge.json"}
        (folder,) = (path for path in (tmp_path / "first-press").iterdir() if path.is_dir())
        (row,) = Run.open(folder).rows
        assert row.measured_force_n == pytest.approx(0.1, abs=0.02)
        assert row.pose_z == pytest.approx(-0.1 / stiffness, abs=0.02 / stiffness)
        # Everything is done: the second time, only the blocks have to be put in.
        typed(monkeypatch, "")
        rig_wizard.run(path, no_calibration, no_alignment)


@pytest.mark.parametrize("machine", ["ender-3", "cnc-3018"])
def test_only_values_that_the_user_knows_are_missing_in_the_files_of_machines(tmp_path: Path, machine: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text((EXAMPLES / f"{machine}.toml").read_text())
    with pytest.raises(
        InputError, match=r"\[block\] texture, \[block\] printer, \[block\] filament, \[sensor\] exposure"
    ):
        read_study(path, teaching=True)
    store_keys(path, "block", {"texture": "1", "printer": "ender-3", "filament": "petg"})
    store_keys(path, "sensor", {"exposure": 100})
    rig = read_study(path, teaching=True).required_rig
    assert rig.stage.driver == {"ender-3": "marlin", "cnc-3018": "grbl"}[machine]


def test_the_first_press_is_careful_whatever_the_study_says() -> None:
    study = virtual_study().study
    careful = first_press(study)
    assert careful.presses == 1
    assert careful.protocol.targets.forces_n == (0.1,) and careful.protocol.limits.hard_limit_n == 1.0
    assert careful.protocol.positions.grid.positions_mm.tolist() == [[6.5, 20.5]]
    assert careful.protocol.steps.settle_s == study.protocol.steps.settle_s
