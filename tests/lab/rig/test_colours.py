"""Test the colours of a sensor of one's own: it states their order, and the stored image has the colour that it saw."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from PIL import Image

from tacbench_cad.extensions.conformance.checks import check_sensor
from tacbench_cad.lab import Closing
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_sensor
from tacbench_cad.lab.runs.frame_files import write_png
from tacbench_cad.lab.study.spec import SensorSettings
from tacbench_cad.util.errors import InputError

#: The colour that the sensor sees, in the order red, green, blue.
ORANGE = (250, 120, 10)


class Eye(Closing):
    """A camera that sees orange, and delivers it in the order ``delivers``."""

    delivers = "rgb"
    shape: tuple[int, ...] = (12, 16, 3)

    def __init__(self) -> None:
        self.name, self.units, self.simulated = "eye", "counts", "sensor (test)"
        self.settings: dict[str, Any] = {"requested": {}, "actual": {}}
        self.is_open = True

    def read(self) -> Any:
        noise = np.random.default_rng().integers(-5, 6, self.shape)
        colour = ORANGE if self.delivers == "rgb" else ORANGE[::-1]
        return (np.array(colour)[: self.shape[-1]] + noise).astype(np.uint8)

    def grab(self) -> Any:
        frame = self.read()
        return lambda: frame

    def close(self) -> None:
        self.is_open = False


class Red(Eye):
    """Says that red is first."""

    channels = "rgb"


class Blue(Eye):
    """Says that blue is first."""

    delivers = channels = "bgr"


class Wrong(Eye):
    """Says something else."""

    channels = "RGB888"


class Grey(Eye):
    """Has no colours."""

    shape = (12, 16)


class Taxels(Eye):
    """Has three axes, but is too small for an image."""

    shape = (4, 4, 3)


@pytest.fixture(autouse=True)
def eyes(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType("eyes")
    vars(module).update(Eye=Eye, Red=Red, Blue=Blue, Wrong=Wrong, Grey=Grey, Taxels=Taxels)
    monkeypatch.setitem(sys.modules, "eyes", module)


def opened(name: str, channels: Any = None) -> Any:
    return open_sensor(SensorSettings(driver=f"eyes:{name}", channels=channels), Clock())


@pytest.mark.parametrize(
    ("name", "channels"), [("Red", None), ("Blue", None), ("Eye", "rgb"), ("Blue", "bgr"), ("Red", "rgb")]
)
@pytest.mark.parametrize("way", ["read", "grab"])
def test_the_stored_image_has_the_colour_that_the_sensor_saw(
    name: str, channels: Any, way: str, tmp_path: Path
) -> None:
    with opened(name, channels) as sensor:
        write_png(tmp_path / "image.png", sensor.read() if way == "read" else sensor.grab()())
    red, green, blue = np.asarray(Image.open(tmp_path / "image.png")).reshape(-1, 3).mean(axis=0)
    assert (abs(red - 250) < 5, abs(green - 120) < 5, abs(blue - 10) < 5) == (True, True, True)


def test_a_sensor_in_colours_that_does_not_state_their_order_is_refused() -> None:
    with pytest.raises(InputError, match=r'channels: is missing; .*\(12, 16, 3\).*channels = "rgb" or "bgr"'):
        opened("Eye")
    with pytest.raises(InputError, match=r"RGB888.*rgb, bgr"):
        opened("Wrong")
    with opened("Wrong", "rgb"), opened("Grey"), opened("Taxels"):
        pass


@pytest.mark.parametrize(
    ("name", "channels", "good"), [("Eye", None, False), ("Eye", "rgb", True), ("Red", None, True)]
)
def test_the_test_of_a_driver_asks_for_the_order(name: str, channels: Any, good: bool) -> None:
    checks = {check.name: check for check in check_sensor({"Eye": Eye, "Red": Red}[name](), Clock(), channels)}
    assert (checks["colours"].result == "passed") is good, checks["colours"].detail
