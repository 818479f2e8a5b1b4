"""Test depth mode: first touch by gauge, by a change of the sensor and as taught, and stated depths below it."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.fakes import Plate
from helpers.rigs import AT_ONCE, FakeRig, small_protocol

from tacbench_cad.lab.acquire.press import Presser
from tacbench_cad.lab.acquire.touch import SensorChange, by_gauge, by_sensor, taught
from tacbench_cad.lab.rig.errors import OutOfRangeError
from tacbench_cad.lab.study.presses import plan_presses
from tacbench_cad.util.errors import InputError

BUMPY = Plate(top=lambda x, y: 0.1 * x - 1.0)


def depths(rig: FakeRig, presser: Presser) -> list[float]:
    """Return the depth below the plate's top of each press of the plan, in mm."""
    depths_mm = []
    for press in plan_presses(presser.protocol, (1, 2), "block"):
        contact = presser.press(press)
        assert contact.in_band is None
        depths_mm.append(rig.plate.top(press.x_mm, press.y_mm) - contact.pose_mm[2])
        presser.carriage.lift()
    return depths_mm


@pytest.mark.parametrize("touch", ["gauge", "sensor"])
def test_presses_reach_stated_depths_below_first_touch(touch: str) -> None:
    rig = FakeRig(plate=BUMPY, gauge=touch == "gauge")
    protocol = small_protocol(contact="depth", touch=touch)
    presser = rig.presser(protocol)
    if presser.force is not None:
        presser.touch = by_gauge(presser.carriage, protocol, presser.force)
    else:
        presser.touch = by_sensor(presser.carriage, protocol, rig.sensor, AT_ONCE)
    measured = depths(rig, presser)
    expected = [press.depth_mm for press in plan_presses(protocol, (1, 2), "block")]
    # The error of first touch is a fine step plus the depth at which the gauge (5 mN) or the image shows a change.
    assert measured == pytest.approx(expected, abs=0.12 if touch == "gauge" else 0.2)
    assert float(np.std(np.subtract(measured, expected))) < 0.03


def test_a_contact_without_a_gauge_has_no_force() -> None:
    rig = FakeRig(gauge=False)
    protocol = small_protocol(contact="depth", touch="taught")
    presser = rig.presser(protocol)
    presser.touch = taught([0.0], 4)
    contact = presser.press(plan_presses(protocol, (1,), "block")[0])
    assert contact.measured is None
    assert contact.pose_mm[2] == pytest.approx(-0.35)


def test_taught_heights_are_one_or_one_for_each_position() -> None:
    assert taught([1.0], 4)(3, lambda _: 0.0) == 1.0
    assert taught([1.0, 2.0, 3.0, 4.0], 4)(3, lambda _: 0.0) == 3.0
    for wrong in ([], [1.0, 2.0], [float("nan")]):
        with pytest.raises(InputError, match="first touch"):
            taught(wrong, 4)


def test_a_depth_below_the_limit_is_refused() -> None:
    rig = FakeRig(gauge=False)
    protocol = small_protocol(contact="depth", touch="taught")
    presser = rig.presser(protocol)
    presser.touch = taught([-6.9], 4)
    with pytest.raises(OutOfRangeError):
        presser.press(plan_presses(protocol, (1,), "block")[0])
    assert min(z for _, _, z in rig.stage.path) >= -7.0


def test_the_search_ends_at_the_depth_limit_if_the_sensor_never_changes() -> None:
    rig = FakeRig(plate=Plate(top=lambda x, y: -40.0), gauge=False)
    protocol = small_protocol(contact="depth", touch="sensor")
    presser = rig.presser(protocol)
    presser.touch = by_sensor(presser.carriage, protocol, rig.sensor, AT_ONCE)
    with pytest.raises(OutOfRangeError):
        presser.press(plan_presses(protocol, (1,), "block")[0])


@pytest.mark.parametrize("shape", [(40, 50), (16,)])
def test_a_change_in_a_few_numbers_exceeds_the_noise_of_free_frames(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(0)

    def frame(more: float) -> np.ndarray:
        values = (100.0 + random.standard_normal(shape)).astype(np.float32)
        values.flat[:4] += more
        return values

    change = SensorChange()
    change.learn([frame(0.0) for _ in range(8)])
    assert sum(change.seen(frame(0.0)) for _ in range(200)) <= 2
    assert all(change.seen(frame(12.0)) for _ in range(20))
