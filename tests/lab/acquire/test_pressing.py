"""Press with devices that are objects, as the example does, and with every way to name a driver."""

from __future__ import annotations

import runpy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tacbench_cad import Block, lab
from tacbench_cad.cli import main
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.study.spec import StageSettings
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError

EXAMPLE = Path(__file__).parents[3] / "examples" / "press_with_my_devices.py"
LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 60.0))
ALIGNMENT = f"""
[holder]
rim_mm = 1.5

[stage]
driver = "grbl"
port = "/dev/not-plugged-in"
origin_mm = [40.0, 40.0, 10.0]
limits_mm = {[list(limits) for limits in LIMITS]}
"""
FEW: dict[str, Any] = {
    "printer": "mk4",
    "filament": "pla",
    "grid": PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0,)),
    "depths_mm": (0.5, 1.0),
    "repeats": 1,
    "stationary_frames": 2,
    "progress": PressProgress(),
}


@pytest.fixture
def devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Return the names of the example, which can also be imported, and write an alignment."""
    shutil.copy(EXAMPLE, tmp_path / "my_devices.py")
    (tmp_path / "rig.toml").write_text(ALIGNMENT)
    monkeypatch.chdir(tmp_path)
    return runpy.run_path(str(EXAMPLE))


def test_a_block_is_pressed_with_objects_and_the_run_is_complete(devices: dict[str, Any], tmp_path: Path) -> None:
    rig = lab.Rig(stage=devices["MyStage"](), sensor=devices["MySensor"](), alignment="rig.toml")
    pressed = lab.press(Block.of(4), rig, "runs", **FEW)
    assert pressed.folder == Path("runs") / "texture-4_paper_x1_mk4_pla_copy01"
    assert "4 of 4 presses saved" in str(pressed) and "nothing is missing" in str(pressed)
    assert "stage of the example; sensor: sensor of the example" in str(pressed)
    info = pressed.run.info
    assert (info.stage["identity"], info.stage["settings"]["driver"]) == ("my arm", "<run_path>:MyStage")
    assert info.holder is not None and info.holder.rim_mm == 1.5
    kinds = {finding.kind for finding in check_run(tmp_path / pressed.folder).findings}
    assert kinds <= {"blurred"}, "the example's frames have no contrast"
    again = lab.press(Block.of(4), rig, "runs", **FEW)
    assert again.presses == 0 and "4 of 4 presses saved" in str(again)


def test_a_missing_press_is_listed(devices: dict[str, Any]) -> None:
    rig = lab.Rig(stage=devices["MyStage"](), sensor=devices["MySensor"](), alignment="rig.toml")
    pressed = lab.press(Block.of(4), rig, "runs", **FEW)
    table = pressed.folder / "targets.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:-1]))
    assert "missing: press 4" in str(pressed)


@pytest.mark.parametrize(
    "named",
    [
        lambda devices: (devices["MyStage"](), devices["MySensor"]()),
        lambda devices: (devices["MyStage"], devices["MySensor"]),
        lambda devices: ("my_devices:MyStage", "my_devices:MySensor"),
    ],
)
def test_objects_classes_and_names_end_in_the_same_devices(
    devices: dict[str, Any], named: Callable[[dict[str, Any]], tuple[Any, Any]]
) -> None:
    stage, sensor = named(devices)
    place = lab.WorkFrame(origin_mm=(40.0, 40.0, 10.0))
    rig = lab.Rig(stage=stage, sensor=sensor, alignment=place, limits_mm=LIMITS)
    rows = lab.press(Block.of(4), rig, "runs", **FEW).run.rows
    depths = [round(-row.pose_mm[2], 1) for row in rows]
    assert depths == [0.5, 0.5, 1.0, 1.0]


def test_names_of_drivers_are_devices_too() -> None:
    stage = StageSettings(driver="simulated", limits_mm=LIMITS)
    rig = lab.Rig(
        stage="simulated",
        sensor="simulated",
        gauge="simulated",
        alignment=lab.WorkFrame(origin_mm=(40.0, 40.0, 10.0)),
        limits_mm=LIMITS,
    )
    assert rig.settings.stage.limits_mm == stage.limits_mm and rig.settings.gauge.driver == "simulated"


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ({}, "alignment: is missing.*nothing was moved"),
        ({"alignment": lab.WorkFrame(origin_mm=(1.0, 2.0, 3.0))}, "limits_mm: is missing"),
        ({"alignment": "nowhere.toml"}, "nowhere.toml"),
        ({"alignment": lab.WorkFrame(origin_mm=(95.0, 40.0, 10.0)), "limits_mm": LIMITS}, "limits_mm x"),
    ],
)
def test_without_a_place_and_limits_nothing_moves(
    devices: dict[str, Any], place: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    moves: list[Any] = []
    stage = devices["MyStage"]()
    monkeypatch.setattr(type(stage), "home", lambda self: moves.append("home"))
    monkeypatch.setattr(type(stage), "move", lambda self, target_mm, speed_mm_s: moves.append(target_mm))
    with pytest.raises(InputError, match=message):
        lab.press(Block.of(4), lab.Rig(stage=stage, sensor=devices["MySensor"](), **place), "runs", **FEW)
    assert moves == [] and not Path("runs").exists()


def test_an_object_without_a_method_is_refused_by_its_name(devices: dict[str, Any]) -> None:
    rig = lab.Rig(stage=object(), sensor=devices["MySensor"](), alignment="rig.toml")
    with pytest.raises(InputError, match=r"\[stage\] driver = 'builtins:object': lacks identity"):
        lab.press(Block.of(4), rig, "runs", **FEW)


def test_the_devices_stay_open_for_the_next_block(devices: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    stage, closed = devices["MyStage"](), []
    monkeypatch.setattr(type(stage), "close", lambda self: closed.append(self))
    rig = lab.Rig(stage=stage, sensor=devices["MySensor"](), alignment="rig.toml")
    for texture in (1, 4):
        assert lab.press(Block.of(texture), rig, "runs", **FEW).presses == 4
    assert closed == []


REHEARSED = """
out = "runs"
[block]
texture = 4
printer = "mk4"
filament = "pla"
[protocol]
repeats = 1
[protocol.positions]
grid = { x_mm = [4.0, 9.0], y_mm = [18.0] }
[protocol.checks]
stationary_frames = 1
[stage]
driver = "grbl"
port = "/dev/not-plugged-in"
origin_mm = [40.0, 40.0, -50.0]
limits_mm = [[0.0, 100.0], [0.0, 100.0], [-80.0, 0.0]]
[gauge]
driver = "serial"
port = "/dev/not-plugged-in-either"
[sensor]
driver = "opencv"
device = "/dev/v4l/none"
exposure = 100
"""


def test_a_rehearsal_presses_my_file_on_simulated_devices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rig.toml").write_text(REHEARSED)
    monkeypatch.chdir(tmp_path)
    assert main(["acquire", "rig.toml", "--virtual", "--speed", "1000"]) == 0
    assert "6 presses: about" in capsys.readouterr().err
    run = lab.Run.open(tmp_path / "runs-rehearsal" / "texture-4_paper_x1_mk4_pla_copy01")
    settings = run.info.stage["settings"]
    assert (settings["driver"], settings["limits_mm"][2]) == ("simulated", [-80.0, 0.0])
    assert len(run.rows) == 6 and all(row.in_band for row in run.rows) and len(run.info.simulated) == 3
    (tmp_path / "rig.toml").write_text(REHEARSED.replace("[-80.0, 0.0]", "[-52.0, 0.0]"))
    assert main(["acquire", "rig.toml", "--virtual"]) == 2
    assert "limits_mm z" in capsys.readouterr().err
