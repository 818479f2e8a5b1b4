"""Test the carriage: limits before any command, up before sideways, and every way of a retreat."""

from __future__ import annotations

import signal
import threading

import pytest
from helpers.fakes import FakeStage
from helpers.rigs import LIMITS, small_protocol

from tacbench_cad.lab.acquire import safety
from tacbench_cad.lab.acquire import signals as orderly
from tacbench_cad.lab.acquire.safety import Carriage, RunInterruptedError
from tacbench_cad.lab.acquire.session import require_reach, travel_height_mm
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.errors import AlarmError, DeviceLostError, NoAnswerError, OutOfRangeError
from tacbench_cad.lab.study.spec import HolderRim, Protocol, WorkFrame
from tacbench_cad.util.errors import InputError


def carriage(stage: FakeStage, z_mm: float = 0.0, **settings: bool) -> Carriage:
    return Carriage(stage, WorkFrame(origin_mm=(0.0, 0.0, z_mm)), small_protocol(), HolderRim(), **settings)


def test_travel_is_above_block_and_rim() -> None:
    assert travel_height_mm(Protocol(), HolderRim(rim_mm=1.18)) == 5.0
    assert travel_height_mm(Protocol(), HolderRim(rim_mm=-2.0)) == 7.0


def test_the_stage_moves_up_before_sideways() -> None:
    stage = FakeStage(at=(0.0, 0.0, -1.0))
    carriage(stage).over(4.0, 18.0)
    assert stage.path == [(0.0, 0.0, -1.0), (0.0, 0.0, 5.0), (4.0, 18.0, 5.0)]


def test_the_stage_moves_sideways_before_down_to_a_lower_slot() -> None:
    stage = FakeStage(at=(0.0, 0.0, 5.0))
    carriage(stage, z_mm=-10.0).over(64.0, 18.0)
    assert stage.path[1:] == [(64.0, 18.0, 5.0), (64.0, 18.0, -5.0)]


@pytest.mark.parametrize("z_mm", [-7.001, -100.0, float("nan")])
def test_nothing_is_sent_below_the_depth_limit(z_mm: float) -> None:
    stage = FakeStage()
    with pytest.raises(OutOfRangeError, match=r"below the depth limit, -7 mm"):
        carriage(stage).to_height(z_mm)
    assert len(stage.path) == 1


def test_a_stage_that_goes_deeper_than_its_target_is_stopped() -> None:
    stage = FakeStage(step_mm=4.0)
    with pytest.raises(OutOfRangeError, match=r"the stage reports z = -8\.000 mm"):
        carriage(stage).to_height(-6.5)


def test_a_successful_retreat_reports_nothing() -> None:
    stage = FakeStage(at=(1.0, 2.0, -3.0))
    assert carriage(stage).retreat() == ""
    assert stage.at == (1.0, 2.0, 5.0)


def test_a_retreat_tries_twice_and_then_homes() -> None:
    stage = FakeStage(at=(1.0, 2.0, -3.0), faults={2: NoAnswerError("silent"), 4: AlarmError("ALARM:3")})
    assert carriage(stage, may_home=True).retreat() == ""
    assert stage.homed == 1


def test_a_stage_without_end_stops_is_not_homed() -> None:
    stage = FakeStage(at=(1.0, 2.0, -3.0), faults={2: NoAnswerError("silent"), 3: AlarmError("ALARM:3")})
    assert "was not lifted (ALARM:3): lift it by hand" in carriage(stage, may_home=False).retreat()
    assert stage.homed == 0


def test_a_retreat_from_a_lost_stage_is_reported() -> None:
    stage = FakeStage(at=(1.0, 2.0, -3.0), dead_after=(2, DeviceLostError("unplugged")))
    assert "(unplugged): lift it by hand" in carriage(stage, may_home=True).retreat()


def test_a_message_that_nobody_can_receive_does_not_end_the_attempts_to_lift(monkeypatch: pytest.MonkeyPatch) -> None:
    def say(message: str) -> None:
        messages.append(message)
        raise BrokenPipeError

    messages: list[str] = []
    monkeypatch.setattr(safety, "RETRY_PAUSE_S", 0.0)
    silent = {number: NoAnswerError("silent") for number in range(2, 8)}
    stage = FakeStage(at=(1.0, 2.0, -3.0), faults=silent)
    with pytest.raises(ValueError, match="the sensor failed"), carriage(stage).safely(say):
        raise ValueError("the sensor failed")
    assert stage.at[2] == 5.0
    assert messages == ["the stage does not answer; trying to lift the sensor for 60 s"]


def test_a_failed_last_lift_is_repeated() -> None:
    stage = FakeStage(at=(1.0, 2.0, -3.0), faults={3: NoAnswerError("silent")})
    with pytest.raises(NoAnswerError), carriage(stage).safely(pytest.fail):
        pass
    assert stage.at[2] == 5.0


def test_positions_must_be_within_the_stage_in_every_slot() -> None:
    turned = WorkFrame(origin_mm=(0.0, 0.0, 0.0), quarter_turns=1)
    require_reach(small_protocol(), HolderRim(), (turned,), LIMITS)
    limits = ((0.0, 100.0), LIMITS[1], LIMITS[2])
    with pytest.raises(InputError, match=r"limits_mm x = \[0\.0, 100\.0\]: slot 1 needs -23\.000 to -18\.000 mm"):
        require_reach(small_protocol(), HolderRim(), (turned,), limits)


def test_an_interruption_of_homing_does_not_claim_that_the_sensor_is_lifted() -> None:
    error = RunInterruptedError("SIGINT")
    assert str(error) == "the sensor is lifted; 0 of 0 presses are saved"
    error.add_note("homing was stopped, so the position is unknown")
    assert str(error) == "0 of 0 presses are saved"


def test_an_interruption_before_the_first_block_does_not_claim_that_the_sensor_is_lifted() -> None:
    with Signals() as signals:
        with pytest.raises(RunInterruptedError) as before:
            signal.raise_signal(signal.SIGINT)
        moving = carriage(FakeStage(at=(0.0, 0.0, -1.0)))
        with signals.sent_to(moving), moving.safely(pytest.fail):
            pass
        with pytest.raises(RunInterruptedError) as after:
            signal.raise_signal(signal.SIGINT)
    assert str(before.value) == "0 of 0 presses are saved", "an earlier session may have left it in contact"
    before.value.gave_up = "home() in arm.py, line 3"
    assert str(before.value).endswith("which did not return; look whether the sensor is lifted")
    assert str(after.value) == "the sensor is lifted; 0 of 0 presses are saved"


def test_a_signal_during_a_lift_that_never_ends_ends_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    left, given = threading.Event(), []
    monkeypatch.setattr(orderly, "RETRY_S", 0.1)
    monkeypatch.setattr(orderly, "_leave", left.set)
    with Signals(given.append) as signals:
        with signals.ignored():
            signal.raise_signal(signal.SIGINT)
        assert not left.wait(0.3), "the lift has ended"
        with signals.ignored():
            signal.raise_signal(signal.SIGINT)
            assert left.wait(60.0)
    assert [error.signal for error in given] == ["SIGINT"]
