"""Test the Marlin driver against a scripted peer: every trait of real firmware and every possible end of a move."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator

import pytest
from helpers.rig_here import clock
from helpers.scripted_marlin import ScriptedMarlin

from tacbench_cad.lab.rig.errors import (
    AlarmError,
    NoAnswerError,
    PositionLostError,
    RigError,
)
from tacbench_cad.lab.rig.marlin import MarlinStage
from tacbench_cad.lab.study.spec import Point

THERE: Point = (10.0, 20.0, 5.0)
TIMEOUT_S = 0.3


@contextlib.contextmanager
def opened(script: ScriptedMarlin, *, home: bool = True) -> Iterator[MarlinStage]:
    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S) as stage:
        if home:
            stage.home()
        yield stage


pytestmark = pytest.mark.usefixtures("rig_time")


def test_identity_names_driver_version_and_port() -> None:
    script = ScriptedMarlin()
    with script.peer() as peer, MarlinStage(peer.port) as stage:
        assert stage.identity == f"marlin: Marlin 2.1.2.7 at {peer.port}"
        assert stage.position() == (10.0, 20.0, 30.0)


def test_z_is_homed_first_if_its_end_stop_is_at_the_top() -> None:
    script = ScriptedMarlin()
    with opened(script) as stage:
        assert [command for command in script.accepted if command.startswith(b"G28")] == [b"G28 Z", b"G28 X", b"G28 Y"]
        assert stage.position() == (0.0, 0.0, 100.0)


def test_the_sensor_is_raised_before_z_is_homed_downwards() -> None:
    script = ScriptedMarlin()
    script.top = False
    with opened(script):
        begin = script.accepted.index(b"G91")
        assert script.accepted[begin : begin + 6] == [
            b"G91", b"G1 Z5.000 F300", b"G90", b"G28 X", b"G28 Y", b"G28 Z",
        ]  # fmt: skip


@pytest.mark.parametrize(("steps_per_mm", "z_mm"), [((80.0, 80.0, 400.0), 5.0025), (None, 5.0)])
def test_positions_have_the_resolution_that_the_firmware_reports(
    steps_per_mm: tuple[float, float, float] | None, z_mm: float
) -> None:
    script = ScriptedMarlin()
    script.steps_per_mm = steps_per_mm
    with opened(script) as stage:
        assert stage.move((10.0, 20.0, 5.0031), 20.0) == (10.0, 20.0, z_mm)


WRONG_PLACE = b"X:10.00 Y:20.00 Z:5.00 E:0.00 Count X:800 Y:1600 Z:9999\nok\n"


@pytest.mark.parametrize(
    ("disturb", "target", "kind", "message"),
    [
        (lambda script: script.on.update({b"M114": lambda line: [WRONG_PLACE]}), THERE, RigError, "motors"),  # trait 14
        (lambda script: setattr(script, "soft", 0.0), (-20.0, 20.0, 5.0), RigError, "soft end stops"),  # trait 15
        (
            lambda script: script.on.update({b"G1": lambda line: [b'echo:Unknown command: "G1"\nok\n']}),  # trait 18
            THERE,
            RigError,
            "does not know G1",
        ),
        (lambda script: script.reset(), THERE, PositionLostError, "expects line 1"),  # trait 18: without a banner
    ],
)
def test_a_move_that_does_not_arrive_has_its_reason(
    disturb: Callable[[ScriptedMarlin], object], target: Point, kind: type[RigError], message: str
) -> None:
    script = ScriptedMarlin()
    with opened(script) as stage:
        disturb(script)
        with pytest.raises(kind, match=message):
            stage.move(target, 20.0)


def test_trait_14_a_move_ends_only_with_m400() -> None:
    script = ScriptedMarlin()
    script.on[b"M400"] = lambda line: [0.3, b"ok\n"]
    with opened(script) as stage:
        before = clock().monotonic()
        stage.move(THERE, 20.0)
        assert clock().monotonic() - before >= 0.3
        words = [command.split(b" ")[0] for command in script.accepted]
        assert words[-3:] == [b"G1", b"M400", b"M114"]


def test_trait_15_nothing_moves_before_homing() -> None:
    script = ScriptedMarlin()
    script.reset()
    with opened(script, home=False) as stage:
        with pytest.raises(PositionLostError, match="home the stage first"):
            stage.move((-20.0, 20.0, 5.0), 20.0)
        assert not any(command.startswith(b"G1") for command in script.accepted)


def test_trait_16_a_garbled_line_is_sent_again_and_its_ok_is_not_counted() -> None:
    script = ScriptedMarlin()
    garbled = 0

    def once(line: bytes) -> Iterator[bytes]:
        nonlocal garbled
        garbled += 1
        if garbled > 1:
            return script.obey(line)
        script.last -= 1
        return iter([script.refusal("checksum mismatch")])

    with opened(script) as stage:
        script.on[b"G1"] = once
        assert stage.move(THERE, 20.0) == THERE
        assert garbled == 1 + 3, "a move has three parts"


def test_trait_16_a_lost_ok_does_not_cause_endless_resends() -> None:
    script = ScriptedMarlin()

    def silent(line: bytes) -> Iterator[bytes]:
        script.go(line)
        return iter(())

    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S) as stage:
        stage.home()
        script.on[b"G1"] = silent
        assert stage.move(THERE, 20.0) == THERE
        assert set(Counter(line for line in peer.lines if b"G1" in line).values()) == {2}


def test_trait_16_a_refusal_after_a_line_was_accepted_is_not_taken_for_a_reset() -> None:
    script = ScriptedMarlin()
    moves = 0

    def accepted(line: bytes) -> Iterator[bytes]:
        nonlocal moves
        moves += 1
        list(script.obey(line))
        # A disturbance has changed the ok, and has made a line of its own that is refused.
        return iter([b"o\xeb\n", script.refusal("checksum mismatch")])

    with opened(script) as stage:
        script.on[b"G1"] = accepted
        assert stage.move(THERE, 20.0) == THERE == script.at
        assert moves in (1, 2, 3), "each part of the move was made once"


GARBLED = {
    "refused": lambda script: script.refusal("checksum mismatch"),
    "taken for an unknown command": lambda script: b'echo:Unknown command: "?1000 M110 N1000*97"\nok\n',
    "taken for a command without output": lambda script: b"ok\n",
}


@pytest.mark.parametrize("how", GARBLED)
def test_garbled_line_number_resets_are_repeated(how: str) -> None:
    script = ScriptedMarlin()
    left = 2
    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S) as stage:
        stage.home()
        obey = script.answer

        def disturbed(line: bytes) -> Iterator[bytes | float]:
            nonlocal left
            if b"M110" not in line or not left:
                return obey(line)
            left -= 1
            return iter([GARBLED[how](script)])

        peer.answer = disturbed
        stage.home()
        assert left == 0
        assert stage.move(THERE, 20.0) == THERE


def test_line_number_resets_that_are_never_accepted_cause_an_error() -> None:
    script = ScriptedMarlin()
    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S) as stage:
        stage.home()
        obey = script.answer
        peer.answer = lambda line: iter([b"ok\n"]) if b"M110" in line else obey(line)
        with pytest.raises(RigError, match="new line numbers"):
            stage.home()
        with pytest.raises(PositionLostError):
            stage.position()
        peer.answer = obey
        stage.home()
        assert stage.move(THERE, 20.0) == THERE


def test_a_line_whose_number_was_garbled_is_sent_again() -> None:
    script = ScriptedMarlin()
    left = 1
    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S) as stage:
        stage.home()
        obey = script.answer

        def disturbed(line: bytes) -> Iterator[bytes | float]:
            nonlocal left
            if b"G1" not in line or not left:
                return obey(line)
            left -= 1
            return iter([b'echo:Unknown command: "x' + line[1:] + b'"\nok\n'])

        peer.answer = disturbed
        assert stage.move(THERE, 20.0) == THERE
        moves = [command for command in script.accepted if command.startswith(b"G1")]
        assert len(moves) == len(set(moves)) == 3


def test_trait_17_a_stop_ends_the_move_and_nothing_is_sent_in_the_pause_after_it() -> None:
    script = ScriptedMarlin()
    stopped_at = 0.0
    arrivals: list[float] = []
    answer = script.answer

    def noted(line: bytes) -> Iterator[bytes | float]:
        if stopped_at and line not in (b"", b"M410"):
            arrivals.append(clock().monotonic())
        return answer(line)

    def until_stopped(line: bytes) -> Iterator[bytes | float]:
        script.at = (3.0, 4.0, 50.0)
        return iter(())

    def stop(line: bytes) -> Iterator[bytes | float]:
        nonlocal stopped_at
        stopped_at = clock().monotonic()
        script.on.clear()
        # The interrupted M400 sends ok far from the target; M410 itself is never acknowledged.
        return iter([b"ok\n"])

    script.answer = noted  # type: ignore[method-assign]
    with script.peer() as peer, MarlinStage(peer.port, baud=115200, timeout_s=3.0) as stage:
        stage.home()
        script.on = {b"M400": until_stopped, b"M410": stop}
        clock().after(0.1, stage.stop)
        with pytest.raises(RigError, match="stopped on request"):
            stage.move(THERE, 20.0)
        assert stage.position() == (3.0, 4.0, 50.0)
        assert arrivals[0] - stopped_at > 1.0
        assert stage.move(THERE, 20.0) == THERE


def test_trait_18_a_halt_is_an_alarm_followed_by_silence() -> None:
    script = ScriptedMarlin()

    def halt(line: bytes) -> Iterator[bytes]:
        script.mute = True
        return iter([b"Error:Printer halted. kill() called!\n"])

    with opened(script) as stage:
        script.on[b"M400"] = halt
        with pytest.raises(AlarmError, match="reset button"):
            stage.move(THERE, 20.0)
        with pytest.raises(PositionLostError):
            stage.position()
        with pytest.raises(NoAnswerError, match="needs a reset"):
            stage.home()


def test_trait_18_after_a_reset_in_motion_the_position_is_lost_until_homing() -> None:
    script = ScriptedMarlin()
    with opened(script) as stage:
        script.on[b"M400"] = lambda line: [script.reset()]
        with pytest.raises(PositionLostError, match="was reset"):
            stage.move(THERE, 20.0)
        with pytest.raises(PositionLostError, match="home the stage first"):
            stage.move(THERE, 20.0)
        script.on.clear()
        stage.home()
        assert stage.move(THERE, 20.0) == THERE


def test_trait_19_busy_restarts_the_timeout() -> None:
    script = ScriptedMarlin()
    busy = [0.25, b"echo:busy: processing\n"]
    script.on[b"G28"] = lambda line: [*busy * (4 if line.endswith(b"Z") else 0), *script.obey(line)]
    with opened(script) as stage:
        assert stage.position() == (0.0, 0.0, 100.0)


def test_trait_19_both_baud_rates_are_attempted(monkeypatch: pytest.MonkeyPatch) -> None:
    script = ScriptedMarlin()
    baud_rates: list[int] = []

    def set_baud(line: object, baud: int) -> None:
        baud_rates.append(baud)
        script.mute = baud != 115200

    monkeypatch.setattr("tacbench_cad.lab.rig.line.Line.set_baud", set_baud)
    script.mute = True
    with script.peer() as peer, MarlinStage(peer.port) as stage:
        assert baud_rates == [250000, 115200]
        assert stage.position() == (10.0, 20.0, 30.0)


def test_opening_a_port_that_resets_waits_for_the_end_of_the_boot() -> None:
    script = ScriptedMarlin()
    script.mute = True

    def boot() -> None:
        peer.say(script.reset())
        script.mute = False

    with script.peer() as peer:
        clock().after(0.5, boot)
        with MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S) as stage:
            with pytest.raises(PositionLostError, match="opening the port"):
                stage.position()
            stage.home()
            assert stage.move(THERE, 20.0) == THERE


def test_a_late_ok_does_not_count_for_the_next_command() -> None:
    script = ScriptedMarlin()
    with opened(script, home=False) as stage:
        # The link repeats the line and asks for the position before the acknowledgement arrives. If a later ok counted
        # for M119, its answer would be lost, and z would be homed downwards.
        script.on[b"M203"] = lambda line: [2.2 * TIMEOUT_S, b"ok\n"]
        script.on[b"M114"] = lambda line: [0.05, script.report(), b"ok\n"]
        stage.home()
        assert next(command for command in script.accepted if command.startswith(b"G28")) == b"G28 Z"


def test_a_closed_switch_far_below_the_top_prevents_homing() -> None:
    script = ScriptedMarlin()
    with opened(script) as stage:
        script.on[b"M119"] = lambda line: [b"Reporting endstop status\nx_min: open\nz_max: TRIGGERED\nok\n"]
        stage.home()
        stage.move(THERE, 20.0)
        moves = len(script.accepted)
        with pytest.raises(AlarmError, match=r"95\.0 mm below it, so homing would press the sensor deeper"):
            stage.home()
        assert not any(command.startswith(b"G28") for command in script.accepted[moves:])
        with pytest.raises(PositionLostError, match="stays closed"):
            stage.position()


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"FIRMWARE_NAME:Repetier_1.0.3 FIRMWARE_URL:x\nok\n", "not Marlin 2"),
        (b'echo:Unknown command: "M15"\nok\n', "answers no question, so the line is disturbed"),
        (b"FIRMWARE_NA\xcdE:Marlin 2.1\xae2.7 (x)\nok\n", "sent unreadable text, so the line is disturbed"),
        (b"FIMWARENAE:Mrin 2.\nok\n", "or the line is disturbed; it sent 'FIMWARENAE:Mrin 2.'"),
    ],
)
def test_another_firmware_and_a_disturbed_line_are_distinguished(answer: bytes, message: str) -> None:
    script = ScriptedMarlin()
    script.on[b"M115"] = lambda line: [answer]
    with script.peer() as peer, pytest.raises(RigError, match=message):
        MarlinStage(peer.port, baud=115200, timeout_s=TIMEOUT_S)
