"""Test sensors by name, and a user's sensor."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_sensor
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.study.spec import SensorSettings

OWN = """
import numpy as np

class Skin:
    name, units, shape, simulated = "skin", "pF", (3,), ""

    def __init__(self, device, gain=1.0):
        self.settings = {"requested": {"device": device, "gain": gain}, "actual": {}}

    def read(self):
        return np.arange(3.0) * self.settings["requested"]["gain"]

    def close(self): pass
    def __enter__(self): return self
    def __exit__(self, *error): self.close()

class Broken:
    pass
"""


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "own_skin.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "own_skin", raising=False)


@pytest.mark.usefixtures("own")
def test_a_users_sensor() -> None:
    settings = SensorSettings(driver="own_skin:Skin", device="usb7", options={"gain": 2.0})
    with open_sensor(settings, Clock()) as sensor:
        assert isinstance(sensor, Sensor)
        assert np.array_equal(sensor.read(), [0.0, 2.0, 4.0])
        assert sensor.settings["requested"] == {"device": "usb7", "gain": 2.0}
