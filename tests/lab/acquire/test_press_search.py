"""Test the search for a force: within the band on loads of every kind, with bounded steps, and always from above."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import pytest
from helpers.fakes import Plate
from helpers.rigs import FakeRig, small_protocol

from tacbench_cad.lab.acquire.force_search import KnownGrowth, Slope
from tacbench_cad.lab.acquire.touch import taught
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import ContactError, OutOfRangeError, RigError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import plan_presses
from tacbench_cad.lab.study.spec import Protocol

PLATES = {
    "dome": Plate(),
    "winkler": Plate(stiffness=0.66, power=2.0),
    "linear": Plate(stiffness=2.0, power=1.0),
    "texture": Plate(top=lambda x, y: math.sin(3.0 * x) - 2.0),
}


def pressed(rig: FakeRig, protocol: Protocol) -> list[bool | None]:
    """Press the whole plan and return whether each press was in its band."""
    presser = rig.presser(protocol)
    in_band = []
    for press in plan_presses(protocol, (1, 2), "block"):
        contact = presser.press(press)
        assert contact.pose_mm == pytest.approx((press.x_mm, press.y_mm, rig.stage.at[2]))
        if contact.in_band:
            assert contact.measured is not None
            assert press.target_n is not None
            assert press.band_n is not None
            assert abs(contact.measured.mean_n - press.target_n) <= press.band_n
        presser.carriage.lift()
        in_band.append(contact.in_band)
    return in_band


@pytest.mark.parametrize("name", PLATES)
@pytest.mark.parametrize("step_mm", [0.0, 0.0025])
@pytest.mark.parametrize("noise_n", [0.0, 0.0005])
def test_every_target_is_reached(name: str, step_mm: float, noise_n: float) -> None:
    rig = FakeRig(plate=PLATES[name], step_mm=step_mm)
    assert rig.gauge is not None
    rig.gauge.noise_n = noise_n
    in_band = pressed(rig, small_protocol())
    # 2 N/mm and steps of 2.5 micrometres: at 0.08 N some places have no step inside a band of 3.9 mN.
    allowed = 2 if name == "linear" and step_mm else 0
    assert in_band.count(False) <= allowed


def test_a_step_in_contact_is_longer_only_far_from_the_target() -> None:
    rig = FakeRig()
    protocol = small_protocol()
    pressed(rig, protocol)
    long_steps = 0
    for (x, y, before), (_, _, after) in zip(rig.stage.path, rig.stage.path[1:], strict=False):
        if after < 0.0 and before - after > protocol.steps.approach_step_mm + 1e-9:
            long_steps += 1
            low_n = max(protocol.targets.forces_n) - max(protocol.targets.bands_n)
            start_n, end_n = (rig.plate.force_n((x, y, z)) for z in (before, after))
            assert start_n > 0.0, "the sensor was in contact"
            assert start_n + 2.0 * (end_n - start_n) < low_n
    presses = len(plan_presses(protocol, (2,), "block"))
    assert presses / 2 <= long_steps <= 4 * presses


@pytest.mark.parametrize("times", [1.0, 2.0, 4.0, 10.0, 100.0])
def test_a_contact_that_has_become_stiffer_stays_below_the_hard_limit(times: float) -> None:
    rig = FakeRig()
    assert rig.gauge is not None
    protocol = small_protocol()
    presser = rig.presser(protocol)
    press = plan_presses(protocol, (2,), "block")[0]
    presser.press(press)
    presser.carriage.lift()
    rig.gauge.plate = Plate(stiffness=times * rig.plate.stiffness)
    rig.gauge.readings.clear()
    assert presser.press(press).in_band
    assert max(rig.gauge.readings) < protocol.limits.hard_limit_n


def test_a_gauge_that_gets_stuck_in_contact_allows_one_longer_step() -> None:
    rig = FakeRig()
    gauge = rig.gauge
    assert gauge is not None
    protocol = small_protocol()
    presser = rig.presser(protocol)
    press = plan_presses(protocol, (2,), "block")[0]
    presser.press(press)
    presser.carriage.lift()
    read, before = gauge.read, len(rig.stage.path)

    def stuck(window_s: float) -> Force:
        force = read(window_s)
        return replace(force, mean_n=min(force.mean_n, 0.05))

    gauge.read = stuck  # type: ignore[method-assign]
    with pytest.raises(OutOfRangeError):
        presser.press(press)
    heights = [z for _, _, z in rig.stage.path[before:]]
    lengths = [a - b for a, b in itertools.pairwise(heights) if b < -0.01]
    assert sum(length > protocol.steps.approach_step_mm + 1e-9 for length in lengths) == 1


def test_the_known_growth_is_the_largest_at_each_depth() -> None:
    known = KnownGrowth(step_mm=0.1)
    for depth_mm, force_n in ((0.1, 0.01), (0.2, 0.05), (0.3, 0.2), (0.4, 0.5), (0.6, 9.0), (0.2, 0.03), (0.1, 0.06)):
        known.add(depth_mm, force_n)
    assert known.largest_n == [0.06, 0.06, 0.2, 0.5]
    assert known.safe_steps(0.05, 0.1, 1.0, max_steps=9) == (1, pytest.approx(0.14))
    assert known.safe_steps(0.05, 0.1, 2.0, max_steps=9) == (2, pytest.approx(0.44))
    assert known.safe_steps(0.05, 0.1, 2.0, max_steps=1) == (1, pytest.approx(0.14))
    assert known.safe_steps(0.15, 0.1, 1.0, max_steps=9) == (0, 0.0), "the force shows a larger depth"
    assert known.safe_steps(0.19, 0.1, 9.0, max_steps=9) == (0, 0.0), "the contact is stiffer than known"
    assert known.safe_steps(0.0, 0.7, 9.0, max_steps=9) == (0, 0.0), "nothing is known at this depth"
    known.add(0.5, 0.1)
    assert known.largest_n[-1] == 0.5
    assert known.safe_steps(0.45, 0.3, 1.3, max_steps=9) == (0, 0.0), "a contact does not become softer"
    assert known.safe_steps(0.45, 0.3, 1.5, max_steps=9) == (1, pytest.approx(0.3))


def test_a_known_press_waits_only_near_the_target(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = FakeRig()
    protocol = small_protocol()
    presser = rig.presser(protocol)
    press = plan_presses(protocol, (2,), "block")[0]
    waits: list[float] = []
    monkeypatch.setattr(Clock, "sleep", lambda _, seconds: waits.append(presser.carriage.at[2]))
    for _ in range(2):
        waits.clear()
        contact = presser.press(press)
        assert contact.in_band
        presser.carriage.lift()
    assert 1 <= len(waits) <= 3
    assert max(waits) - contact.pose_mm[2] < protocol.steps.approach_step_mm, "the steady zero is read without a wait"


def test_a_zero_that_is_not_steady_is_read_again_after_a_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = FakeRig()
    assert rig.gauge is not None
    presser = rig.presser(small_protocol())
    waits: list[float] = []
    monkeypatch.setattr(Clock, "sleep", lambda _, seconds: waits.append(seconds))
    assert presser.force is not None
    presser.force.follow_zero()
    assert waits == []
    rig.gauge.drift_n = lambda _: 0.01
    presser.force.follow_zero()
    assert waits == [0.2]
    assert presser.force.zero_n == pytest.approx(0.01, abs=0.002)


def test_the_last_move_of_every_press_goes_down() -> None:
    rig = FakeRig()
    presser = rig.presser(small_protocol())
    for press in plan_presses(small_protocol(), (1, 2), "block"):
        presser.press(press)
        assert rig.stage.path[-1][2] < rig.stage.path[-2][2]
        presser.carriage.lift()


def test_the_first_approach_takes_steps_from_the_travel_height() -> None:
    rig = FakeRig(plate=Plate(top=lambda x, y: 4.95))
    protocol = small_protocol()
    presser = rig.presser(protocol)
    presser.press(plan_presses(protocol, (1,), "block")[0])
    assert max(rig.gauge.readings if rig.gauge else []) < 0.2


def test_the_best_approach_is_kept_if_the_stage_cannot_reach_the_band() -> None:
    rig = FakeRig(plate=Plate(stiffness=10.0, power=1.0, top=lambda x, y: 0.0003), step_mm=0.005)
    protocol = small_protocol(search_steps=12)
    presser = rig.presser(protocol)
    contact = presser.press(plan_presses(protocol, (1,), "block")[0])
    assert contact.in_band is False
    assert contact.measured is not None
    # At the two heights next to the target the force is 0.053 and 0.103 N.
    assert contact.measured.mean_n == pytest.approx(0.103, abs=0.003)


def test_a_target_out_of_reach_ends_at_the_depth_limit() -> None:
    rig = FakeRig(plate=Plate(top=lambda x, y: -40.0))
    protocol = small_protocol()
    presser = rig.presser(protocol)
    with pytest.raises(OutOfRangeError, match=r"below the depth limit, -7 mm"):
        presser.press(plan_presses(protocol, (1,), "block")[0])
    assert min(z for _, _, z in rig.stage.path) >= -protocol.limits.depth_limit_mm


def test_a_drifting_gauge_is_zeroed_before_each_press() -> None:
    rig = FakeRig()
    assert rig.gauge is not None
    rig.gauge.noise_n = 0.0
    rig.gauge.drift_n = lambda count: 0.00001 * count
    presser = rig.presser(small_protocol())
    for press in plan_presses(small_protocol(), (1, 2), "block"):
        presser.press(press)
        assert press.target_n is not None
        assert press.band_n is not None
        true_n = rig.plate.force_n(rig.stage.at)
        # A press takes 30 to 80 samples, so the zero drifts by at most 0.8 mN; a quarter of a band is added.
        assert abs(true_n - press.target_n) <= press.band_n + 0.0008 + 0.0005
        presser.carriage.lift()


def test_a_force_on_a_free_sensor_is_refused() -> None:
    rig = FakeRig()
    assert rig.gauge is not None
    rig.gauge.drift_n = lambda count: 0.7 if count > 100 else 0.0
    presser = rig.presser(small_protocol())
    with pytest.raises(ContactError, match=r"0\.70\d N at the travel height"):
        for press in plan_presses(small_protocol(), (1,), "block"):
            presser.press(press)


def test_a_slow_drift_to_a_large_force_is_refused() -> None:
    rig = FakeRig()
    assert rig.gauge is not None
    presses = 0
    rig.gauge.drift_n = lambda _: 0.02 * presses
    presser = rig.presser(small_protocol())
    press = plan_presses(small_protocol(), (1,), "block")[0]
    with pytest.raises(RigError, match=r"at the travel height, where the sensor is free \(at most 0\.5 N"):
        for _ in range(30):
            presses += 1
            presser.press(press)
            presser.carriage.lift()
    assert presses in (25, 26), "the noise decides"


def test_the_force_is_read_on_the_way_down() -> None:
    rig = FakeRig()
    protocol = small_protocol()
    presser = rig.presser(protocol)
    press = plan_presses(protocol, (2,), "block")[0]
    presser.press(press)
    presser.carriage.lift()
    # The z motor stands still during a later lift, so the sensor is 3 mm nearer to the block than reported.
    rig.stage.true = (*rig.stage.true[:2], rig.stage.true[2] - 3.0)
    with pytest.raises(ContactError, match=r"touches something at z = .* was free down to 0\.000 mm before"):
        presser.press(press)
    assert max(rig.gauge.readings if rig.gauge else []) < 2.5


@pytest.mark.parametrize("error_mm", [0.0, 0.3, 1.5, -1.0])
def test_a_new_position_is_approached_in_few_moves(error_mm: float) -> None:
    """The second position is higher than the formula says by an error."""
    rig = FakeRig(plate=Plate(top=lambda x, _: -1.0 - 0.1 * x + (error_mm if x > 5.0 else 0.0)))
    protocol = small_protocol()
    presser = rig.presser(protocol)
    presser.nominal_mm = lambda x, _: 3.0 - 0.1 * x
    lengths = []
    for press in plan_presses(protocol, (2,), "block")[:2]:
        before = len(rig.stage.path)
        contact = presser.press(press)
        assert contact.in_band
        presser.carriage.lift()
        lengths.append(len(rig.stage.path) - before)
    assert lengths[1] < lengths[0] - (40 if error_mm in (0.0, 0.3) else 30)
    assert max(rig.gauge.readings if rig.gauge else []) < 2.5


def test_a_known_position_is_approached_in_few_moves() -> None:
    rig = FakeRig()
    protocol = small_protocol()
    presser = rig.presser(protocol)
    press = plan_presses(protocol, (2,), "block")[0]
    lengths = []
    for _ in range(2):
        before = len(rig.stage.path)
        presser.press(press)
        presser.carriage.lift()
        lengths.append(len(rig.stage.path) - before)
    # 5 mm in steps of 0.1 mm are saved, and replaced by moves whose length is that of a safe press.
    assert lengths[1] < lengths[0] - 40


def test_a_force_that_is_not_a_number_is_refused() -> None:
    rig = FakeRig()
    assert rig.gauge is not None
    presser = rig.presser(small_protocol())
    rig.gauge.faults[30] = math.nan
    with pytest.raises(RigError, match="reads nan N"):
        presser.press(plan_presses(small_protocol(), (1,), "block")[0])


def test_the_slope_needs_two_heights_and_a_force_that_grows_with_depth() -> None:
    slope = Slope(reach_mm=0.1, min_mm=0.002)
    assert slope.at(0.0) is None
    slope.add(0.0, 0.1)
    assert slope.at(0.0) is None
    slope.add(-0.001, 0.1005)
    assert slope.at(0.0) is None
    slope.add(-0.05, 0.125)
    assert slope.at(0.0) == pytest.approx(0.5, rel=0.02)
    slope.add(-1.0, 50.0)
    assert slope.at(0.0) == pytest.approx(0.5, rel=0.02), "heights far away are ignored"
    falling = Slope(reach_mm=0.1, min_mm=0.002, seen=[(0.0, 0.2), (-0.05, 0.1)])
    assert falling.at(0.0) is None


@pytest.mark.parametrize("contact", ["force", "depth"])
def test_the_search_ends_if_steps_are_smaller_than_the_stages_resolution(contact: str) -> None:
    rig = FakeRig(step_mm=0.05)
    protocol = small_protocol(contact=contact, touch="taught", approach_step_mm=0.02, search_steps=5)
    presser = rig.presser(protocol)
    presser.touch = taught([0.013], 4)
    presser.press(plan_presses(protocol, (1,), "block")[0])
    assert rig.stage.at[2] == pytest.approx(-0.3, abs=0.1)
