"""Test rigs of mixed devices: a user's own stage with a simulated gauge and a simulated sensor that follow it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.rigs import LIMITS, printed, small_protocol, study_of

from tacbench_cad.cli import main
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.rig.devices import open_rig
from tacbench_cad.lab.rig.errors import RigError
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.simulate.contact import contact_for
from tacbench_cad.lab.study.spec import GaugeSettings, RigSettings, SensorSettings, StageSettings, WorkFrame
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError

ORIGIN = (30.0, 10.0, -5.0)
RIG = RigSettings(
    stage=StageSettings(driver="helpers.fakes:FakeStage", limits_mm=LIMITS, origin_mm=ORIGIN, quarter_turns=1),
    gauge=GaugeSettings(driver="simulated"),
    sensor=SensorSettings(driver="simulated", options={"seed": 1}),
)


def test_simulated_devices_follow_a_users_stage(tmp_path: Path) -> None:
    protocol = small_protocol(
        grid=PressGrid(x_mm=(4.0,), y_mm=(18.0,)),
        forces_n=(0.5,),
        bands_n=(0.02,),
        repeats=1,
        stationary_frames=1,
        clearance_mm=0.5,
        settle_s=0.0,
    )
    study = study_of(protocol, 4)
    acquire_study(
        study,
        RIG,
        tmp_path,
        person=Typing(lambda _: "", lambda _: None),
        progress=PressProgress(),
        durable=False,
    )
    run = Run.open(tmp_path / printed(4).name)
    assert run.info.simulated == (
        "stage: fake stage",
        "gauge: simulated load cell",
        "sensor: simulated TacTip",
    )
    contact = contact_for(printed(4), RIG.holder)
    for row in run.rows:
        # The tolerance is the band, plus a quarter of it for the zero, plus the noise of eight samples.
        assert contact.force_n(*row.pose_mm) == pytest.approx(0.5, abs=0.02 + 0.005 + 0.001)


def test_a_device_that_fails_to_open_closes_the_others() -> None:
    from helpers.fakes import FakeStage

    stages: list[FakeStage] = []
    close = FakeStage.close
    frame = WorkFrame(origin_mm=ORIGIN)
    broken = replace(RIG, sensor=SensorSettings(driver="simulated", options={"colours": True}))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(FakeStage, "close", lambda self: (stages.append(self), close(self))[1])
        with pytest.raises(InputError, match='did you mean "colour"'), open_rig(broken, printed(), frame):
            pass
    assert stages
    assert stages[0].closed


def test_a_missing_gauge_is_reported() -> None:
    settings = replace(RIG, gauge=GaugeSettings(driver="serial", port="/dev/no-such-gauge"))
    with (
        pytest.raises((InputError, RigError), match="/dev/no-such-gauge"),
        open_rig(settings, printed(), WorkFrame(origin_mm=ORIGIN)),
    ):
        pass


OWN = """
import numpy as np
from pathlib import Path
from tacbench_cad.lab import Force

class Stage:
    identity, simulated = "own stage", "stage"
    at = (0.0, 0.0, 20.0)
    def home(self): self.at = (0.0, 0.0, 20.0)
    def move(self, target_mm, speed_mm_s):
        self.at = tuple(target_mm)
        Path("at.txt").write_text(str(self.at[2]))
        return self.at
    def position(self): return self.at
    def stop(self): pass
    def close(self): pass

class Gauge:
    identity, simulated, calibration, count = "own gauge", "gauge", {}, 0
    def read(self, window_s):
        self.count += 1
        return Force(mean_n=0.0, spread_n=0.001, samples=3)
    def tare(self): pass
    def close(self): pass

class LostGauge(Gauge):
    def read(self, window_s):
        if self.count == 60:
            raise OSError(19, "No such device")
        return super().read(window_s)

class Sensor:
    name, units, shape, simulated, settings = "own sensor", "counts", (4,), "sensor", {}
    def read(self): return np.random.default_rng().normal(size=4)
    def close(self): pass

class LostSensor(Sensor):
    def read(self): raise ZeroDivisionError("a driver's own mistake")
"""
OWN_STUDY = """
out = "runs"
[block]
texture = 1
printer = "bambu-p1p"
filament = "pla-minus"
[protocol]
limits.clearance_mm = 5.0
steps.settle_s = 0.0
checks.stationary_frames = 0
[stage]
driver = "own_rig:Stage"
origin_mm = [0, 0, 0]
limits_mm = [[-50, 50], [-50, 50], [-20, 20]]
[gauge]
driver = "own_rig:{gauge}"
[sensor]
driver = "own_rig:{sensor}"
"""


@pytest.mark.parametrize(
    ("gauge", "sensor", "message"),
    [
        ("LostGauge", "Sensor", "[gauge] driver own_rig:LostGauge: read() failed: OSError: [Errno 19] No such device"),
        ("Gauge", "LostSensor", "read() failed: ZeroDivisionError: a driver's own mistake"),
    ],
)
def test_an_exception_of_a_users_driver_lifts_the_sensor_and_takes_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    gauge: str,
    sensor: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_rig", raising=False)
    Path("own_rig.py").write_text(OWN)
    Path("study.toml").write_text(OWN_STUDY.format(gauge=gauge, sensor=sensor))
    assert main(["acquire", "study.toml"]) == 3
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("error"))
    assert message in line and f"({tmp_path / 'own_rig.py'}, line " in line
    assert float(Path("at.txt").read_text()) >= 5.0


@pytest.mark.parametrize("command", [["acquire"], ["rig", "align"]])
def test_a_missing_driver_is_reported_with_both_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_rig", raising=False)
    Path("own_rig.py").write_text(OWN)
    Path("study.toml").write_text(OWN_STUDY.format(gauge="Gauges", sensor="Sensor"))
    assert main([*command, "study.toml"]) == 2
    own = tmp_path / "own_rig.py"
    expected = f"study.toml: [gauge] driver = 'own_rig:Gauges': {own} has no Gauges; did you mean \"Gauge\"?"
    assert expected in capsys.readouterr().err
