"""Test the drivers of study files that start emulated firmware."""

from __future__ import annotations

import sys

import pytest
from helpers.emulated import emulated_study

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_gauge, open_rig
from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.lab.study.spec import GaugeSettings
from tacbench_cad.util.errors import InputError


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
@pytest.mark.parametrize("driver", ["virtual-grbl", "virtual-marlin"])
def test_stage_and_load_cell_are_emulated_and_say_so(driver: str) -> None:
    file = emulated_study(driver, speed=100.0)
    settings = file.required_rig
    with open_rig(settings, file.study.blocks[0].printed, settings.stage.frame) as rig:
        assert rig.clock.speed == 100.0 and rig.gauge is not None
        assert rig.stage.simulated == f"stage ({driver})"
        assert rig.gauge.simulated == "load cell of the virtual rig"
        assert rig.gauge.read(0.2).mean_n == pytest.approx(0.0, abs=0.05)
        assert "speed" not in rig.info["stage"]["settings"]["options"]
        virtual = rig.following[0].rig  # type: ignore[attr-defined]
        x, y, z = settings.stage.origin_mm
        rig.stage.move((x, y, z + 20.0), 50.0)
        assert virtual.true_position() == pytest.approx((x, y, z + 20.0), abs=0.1)
    with pytest.raises(DeviceLostError):  # the firmware ends with the rig
        virtual.now_s()


def test_the_emulated_load_cell_needs_an_emulated_stage() -> None:
    with pytest.raises(InputError, match="works only with a stage that has emulated firmware"):
        open_gauge(GaugeSettings(driver="virtual-serial"), Clock())
