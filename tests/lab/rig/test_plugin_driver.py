"""Test users' stages by ``module:name``, and every way in which the name can be wrong."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest
from helpers import example_stage

from tacbench_cad.lab.rig import plugin
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_gauge, open_sensor, open_stage
from tacbench_cad.lab.rig.errors import OutOfRangeError, RigError
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.study.spec import GaugeSettings, SensorSettings, StageSettings
from tacbench_cad.util import packages
from tacbench_cad.util.errors import InputError

HERE = Path(example_stage.__file__).parent
LIMITS = ((0.0, 100.0), (0.0, 100.0), (0.0, 100.0))


def settings(driver: str, **more: object) -> StageSettings:
    return StageSettings(driver=driver, limits_mm=LIMITS, **more)  # type: ignore[arg-type]


def test_the_example_is_a_stage_within_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    with open_stage(settings("example_stage:ExampleStage", port="10.0.0.7")) as stage:
        assert isinstance(stage.stage, Stage)
        assert stage.identity == "example arm 1.0 at 10.0.0.7"
        assert stage.position() == (0.0, 0.0, 50.0)
        assert stage.move((1.0, 2.0, 3.0), 5.0) == (1.0, 2.0, 3.0)
        with pytest.raises(OutOfRangeError):
            stage.move((1.0, 2.0, -3.0), 5.0)


def test_a_driver_that_would_end_the_program_has_failed() -> None:
    device = plugin.OwnDevice(SimpleNamespace(read=sys.exit, stop=sys.exit, close=sys.exit), "[sensor] driver a:B", {})
    with pytest.raises(RigError, match=r"\[sensor\] driver a:B: read\(\) failed: SystemExit: 3"):
        device.read(3)
    device.stop()
    device.close()
    with pytest.raises(InputError, match=r"cannot be opened: SystemExit: 1"):
        plugin.opened(partial(sys.exit, 1), "a:B")


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        ("example_stage:", "must be module:name"),
        (":Arm", "must be module:name"),
        ("../evil:Arm", "must be module:name"),
        ("no_such_module_here:Arm", "cannot be imported: ModuleNotFoundError"),
        ("example_stage:ExampleStag", 'did you mean "ExampleStage"'),
        ("tacbench_cad.lab.rig.stage:__doc__", "is not callable"),
        ("pathlib:Path", "lacks identity"),
    ],
)
def test_wrong_names_are_explained(driver: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(HERE)
    with pytest.raises(InputError, match=message):
        open_stage(settings(driver))


def test_a_missing_package_of_an_extra_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(packages, "has_module", lambda name: False)
    (tmp_path / "needs_torch.py").write_text("raise ModuleNotFoundError('No module named torch', name='torch')\n")
    with pytest.raises(InputError, match=r'needs torch, not installed: run pip install "tacbench-cad\[cnn\]"'):
        plugin.load("needs_torch:Model")


@pytest.mark.parametrize("driver", ["gbrl", "virtual-gbrl", "octoprint"])
def test_unknown_drivers_are_refused_with_a_suggestion(driver: str) -> None:
    with pytest.raises(InputError, match=r"grbl"):
        open_stage(settings(driver, port="/dev/null"))


def test_unknown_options_are_refused_with_a_suggestion() -> None:
    with pytest.raises(InputError, match='did you mean "home_timeout_s"'):
        open_stage(settings("grbl", port="/dev/null", options={"home_timeot_s": 3}))


OWN = """
import numpy as np
from tacbench_cad.lab.rig.gauge import Force

class Arm:
    identity, simulated = "arm", ""
    wrong = None
    def __init__(self, fails="", gives=(0.0, 0.0, 50.0)):
        self.fails, self.gives = fails, gives
    def _do(self, name):
        if name == self.fails:
            raise OSError(5, "Input/output error")
    def home(self): self._do("home")
    def position(self):
        self._do("position")
        return self.gives
    def move(self, target_mm, speed_mm_s):
        return 1.0 / 0.0 if self.fails == "move" else target_mm
    def stop(self): self._do("stop")
    def close(self): self._do("close")

class Cell:
    identity, simulated, calibration = "cell", "", {}
    def read(self, window_s): return 0.1
    def tare(self): pass
    def close(self): pass

class Skin:
    name, units, shape, simulated, settings = "skin", "pF", (3,), "", {}
    def read(self): return None
    def close(self): pass
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "own_rig.py"
    path.write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_rig", raising=False)
    return path


@pytest.mark.parametrize(
    ("fails", "line", "text"),
    [("home", 12, "OSError: .*Input/output error"), ("position", 12, "OSError"), ("move", 18, "ZeroDivisionError")],
)
def test_an_exception_of_a_users_driver_is_reported_in_one_line_with_its_file(
    own: Path, fails: str, line: int, text: str
) -> None:
    values = ((1.0, 1.0, 1.0), 5.0) if fails == "move" else ()
    with (
        open_stage(settings("own_rig:Arm", home=False, options={"fails": fails})) as stage,
        pytest.raises(RigError, match=text) as caught,
    ):
        getattr(stage, fails)(*values)
    assert str(caught.value).endswith(f"({own}, line {line})")
    assert f"[stage] driver own_rig:Arm: {fails}() failed: " in str(caught.value)
    assert "\n" not in str(caught.value) and caught.value.exit_code == 3


@pytest.mark.parametrize("fails", ["stop", "close"])
@pytest.mark.usefixtures("own")
def test_stop_and_close_of_a_users_driver_never_raise(fails: str) -> None:
    with open_stage(settings("own_rig:Arm", home=False, options={"fails": fails})) as stage:
        stage.stop()


@pytest.mark.parametrize("gives", [None, (1.0, 2.0), (0.0, float("nan"), 1.0), "abc"])
def test_an_invalid_position_is_an_error_of_the_driver(own: Path, gives: object) -> None:
    with (
        open_stage(settings("own_rig:Arm", home=False, options={"gives": gives})) as stage,
        pytest.raises(RigError, match=str(own)),
    ):
        stage.position()


def test_an_invalid_force_or_frame_is_an_error_of_the_driver(own: Path) -> None:
    gauge = open_gauge(GaugeSettings(driver="own_rig:Cell"), Clock())
    with pytest.raises(RigError, match=r"\[gauge\] driver own_rig:Cell: read\(\) failed: .*0.1 is not a Force"):
        gauge.read(0.1)
    sensor = open_sensor(SensorSettings(driver="own_rig:Skin"), Clock())
    with pytest.raises(RigError, match=rf"a NoneType is not an array of numbers \({own}\)"):
        sensor.read()
