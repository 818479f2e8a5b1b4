"""Test the GRBL driver against a scripted peer: every trait of real firmware and every possible end of a move."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import pytest
from helpers.rig_here import clock
from helpers.scripted_grbl import BANNER, SETTINGS, ScriptedGrbl

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    DeviceLostError,
    OutOfRangeError,
    PositionLostError,
    RigError,
)
from tacbench_cad.lab.rig.grbl import GrblStage
from tacbench_cad.lab.study.spec import Point

THERE: Point = (-10.0, -20.0, -5.0)
TIMEOUT_S = 0.4


pytestmark = pytest.mark.usefixtures("rig_time")


@contextlib.contextmanager
def opened(script: ScriptedGrbl, *, home: bool = True) -> Iterator[GrblStage]:
    with script.peer() as peer, GrblStage(peer.port, clock=Clock(speed=50.0), timeout_s=TIMEOUT_S) as stage:
        if home:
            stage.home()
        yield stage


def moving(script: ScriptedGrbl, *then: bytes | float) -> None:
    """Let moves be accepted without an arrival and be followed by the bytes ``then``."""

    def on_move(target: Point) -> Iterator[bytes | float]:
        script.state = "Run"
        yield b"ok\r\n"
        yield from then

    script.on_move = on_move


def test_moves_use_machine_coordinates_and_report_their_end() -> None:
    script = ScriptedGrbl()
    with script.peer() as peer, GrblStage(peer.port) as stage:
        assert stage.identity == f"grbl: GRBL 1.1h.20190825 at {peer.port}" and stage.simulated == ""
        stage.home()
        assert stage.move(THERE, 20.0) == THERE == stage.position()
        sent = next(line for line in peer.lines if b"X-10" in line)
        assert b"G53" in sent and b"G90" in sent and b"G21" in sent and b"F1200" in sent
        assert not any(word in line for line in peer.lines for word in (b"G92", b"G54", b"G10"))


@pytest.mark.parametrize(
    ("state", "answer", "kind", "message", "lost"),
    [
        ("Run", [b"ALARM:2\r\nok\r\n"], AlarmError, "ALARM:2", True),  # trait 1
        ("Run", [b"ALARM:3\r\nok\r\n"], AlarmError, "ALARM:3", True),
        ("Run", [b"ok\r\n", BANNER], PositionLostError, "was reset", True),  # traits 4 and 13
        ("Run", [b"ok\r\n", b"ALARM:3\r\n", 0.5, BANNER], AlarmError, "steps were lost", True),  # trait 5
        ("Idle", [b"error:15\r\n"], OutOfRangeError, "error:15", False),  # trait 6
        ("Idle", [b"error:9\r\n"], AlarmError, "error:9", True),
        ("Idle", [b"error:10\r\n"], RigError, "error:10", False),
        ("Idle", [b"ok\r\n"], RigError, "ended at x -1", False),  # trait 10
        ("Run", [b"ok\r\n"], RigError, "stays at", False),
    ],
)
def test_a_move_that_does_not_arrive_has_its_reason(
    state: str, answer: list[bytes | float], kind: type[RigError], message: str, lost: bool
) -> None:
    script = ScriptedGrbl()

    def on_move(target: Point) -> Iterator[bytes | float]:
        script.state = state
        yield from answer

    with opened(script) as stage:
        script.on_move = on_move
        with pytest.raises(kind, match=message):
            stage.move(THERE, 20.0)
        script.on_move = None
        if lost:
            with pytest.raises(PositionLostError, match="home the stage first"):
                stage.move(THERE, 20.0)
        else:
            assert stage.position() == (-1.0, -1.0, -1.0)


@pytest.mark.parametrize(
    ("answer", "state", "off_mm"),
    [
        ([0.3, b"ok\r\n", 0.05], "Idle", None),  # it stands still before the acknowledgement
        ([b"ok\r\n", 0.15], "Run", 0.01),  # trait 11: shortly before the end, its speed is 0
        ([b"k\r\n"], "Idle", 0.0),  # the acknowledgement is damaged
    ],
)
def test_a_move_ends_at_its_target(answer: list[bytes | float], state: str, off_mm: float | None) -> None:
    script = ScriptedGrbl()

    def on_move(target: Point) -> Iterator[bytes | float]:
        script.state = state
        if off_mm is not None:
            script.at = (target[0], target[1], target[2] + off_mm)
        yield from answer
        script.state, script.at = "Idle", target

    with opened(script) as stage:
        script.on_move = on_move
        assert stage.move(THERE, 20.0) == THERE


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("version", b"FIRMWARE_NAME:Marlin 2.1.2.7\nok\n", "is Marlin, not GRBL"),
        ("settings", b"$1=25\r\n" + SETTINGS, r"\(\$1=25\).*send it \$1=255"),  # trait 22
        ("settings", SETTINGS.replace(b"$13=0", b"$13=1"), r"\$13=0"),
        (
            "on_status",
            lambda: [b"<Idle|WPos:1.000,2.000,3.000|FS:0,0>\r\n"],
            r"reports work coordinates; send it \$10=1",
        ),
    ],
)
def test_a_firmware_that_cannot_be_used_is_refused(name: str, value: object, message: str) -> None:
    script = ScriptedGrbl()
    setattr(script, name, value)
    with script.peer() as peer, pytest.raises(RigError, match=message):
        GrblStage(peer.port, timeout_s=TIMEOUT_S)


def test_trait_01_homing_after_an_alarm_restores_the_stage() -> None:
    script = ScriptedGrbl()
    with opened(script) as stage:
        moving(script, b"ALARM:2\r\nok\r\n")
        with pytest.raises(AlarmError):
            stage.move(THERE, 20.0)
        script.on_move = None
        script.on_reset = lambda: [b"ok\r\n", script.banner, b"[MSG:'$H'|'$X' to unlock]\r\n"]
        stage.home()
        assert stage.move(THERE, 20.0) == THERE


def test_trait_02_silence_after_a_garbled_alarm_is_an_alarm() -> None:
    script = ScriptedGrbl()

    def on_move(target: Point) -> Iterator[bytes | float]:
        script.deaf = True
        yield b"ok\r\nAL\xf2RM:1\r\n"

    with opened(script) as stage:
        script.on_move = on_move
        with pytest.raises(AlarmError, match="but after a reset"):
            stage.move(THERE, 20.0)
        with pytest.raises(PositionLostError):
            stage.position()


def test_trait_03_homing_waits_despite_silence_and_an_old_report() -> None:
    script = ScriptedGrbl()
    script.on_home = lambda: [0.7, b"<Home|MPos:-3.000,-9.000,-1.000|FS:0,0>\r\n", b"ok\r\n"]
    with opened(script) as stage:
        assert stage.position() == (-1.0, -1.0, -1.0)


def test_trait_04_a_reset_without_a_banner_is_detected_by_the_position() -> None:
    script = ScriptedGrbl()
    with opened(script) as stage:
        stage.move(THERE, 20.0)
        script.at = (0.0, 0.0, 0.0)
        with pytest.raises(PositionLostError, match="0, 0, 0"):
            stage.move((-11.0, -20.0, -5.0), 20.0)


def test_trait_05_a_stop_holds_and_the_next_move_resumes_with_a_known_position() -> None:
    script = ScriptedGrbl()
    with opened(script) as stage:
        moving(script)
        clock().after(0.1, stage.stop)
        with pytest.raises(RigError, match="stopped on request"):
            stage.move(THERE, 20.0)
        script.on_move = None
        assert stage.position() == (-1.0, -1.0, -1.0)
        assert stage.move(THERE, 20.0) == THERE


def test_trait_21_an_empty_line_precedes_the_repetition_of_a_refused_move() -> None:
    script = ScriptedGrbl()
    answer, refusing, moves = script.answer, False, 0

    def refuse_until_an_empty_line(command: bytes) -> Iterator[bytes | float]:
        nonlocal refusing, moves
        moves += command.startswith(b"G21")
        if command == b"":
            refusing = False
            yield b"ok\r\n"
        elif command.startswith(b"G") and (refusing or moves == 1):
            refusing = True
            yield b"error:2\r\n"
        else:
            yield from answer(command)

    script.answer = refuse_until_an_empty_line  # type: ignore[method-assign]
    with opened(script) as stage:
        assert stage.move(THERE, 20.0) == THERE
        assert moves == 2


def test_a_hold_is_left_when_the_stage_is_opened() -> None:
    script = ScriptedGrbl()
    script.state = "Hold:0"
    with opened(script, home=False) as stage:
        assert stage.position() == (-1.0, -1.0, -1.0)
        assert stage.move(THERE, 20.0) == THERE


def test_unplugging_while_homing_warns_that_the_carriage_may_still_move() -> None:
    script = ScriptedGrbl()
    script.on_home = list
    with script.peer() as peer, GrblStage(peer.port, timeout_s=TIMEOUT_S) as stage:
        clock().after(0.2, peer.unplug)
        with pytest.raises(DeviceLostError, match="the carriage may still move"):
            stage.home()


@pytest.mark.parametrize("answer", [b"error:3\r\n", b"error:9\r\n", b"ok\r\n", b""])
def test_a_garbled_homing_command_is_sent_again(answer: bytes) -> None:
    script = ScriptedGrbl()
    orders = 0

    def on_home() -> Iterator[bytes]:
        nonlocal orders
        orders += 1
        if orders == 1:
            script.state = "Alarm"
            return iter([answer] if answer else [])
        script.state, script.at = "Idle", (-1.0, -1.0, -1.0)
        return iter([b"<Home|MPos:-1.000,-1.000,-1.000|FS:0,0>\r\nok\r\n"])

    script.on_home = on_home
    with opened(script) as stage:
        assert orders == 2
        assert stage.position() == (-1.0, -1.0, -1.0)


def test_a_position_that_changes_each_time_is_refused() -> None:
    script = ScriptedGrbl()
    with opened(script) as stage:
        places = iter(range(100))
        script.on_status = lambda: [f"<Idle|MPos:{next(places)}.000,5.000,-1.000|FS:0,0>\r\n".encode()]
        with pytest.raises(RigError, match="each time"):
            stage.position()
        script.on_status = None
        assert stage.position() == (-1.0, -1.0, -1.0)


def test_trait_07_a_reset_on_opening_loses_the_first_second_and_the_position() -> None:
    script = ScriptedGrbl()
    awake = clock().monotonic() + 0.6

    def boot() -> None:
        script.deaf = False
        peer.say(script.banner)

    script.deaf = True
    with script.peer() as peer:
        clock().after(awake - clock().monotonic(), boot)
        with GrblStage(peer.port, timeout_s=TIMEOUT_S) as stage:
            with pytest.raises(PositionLostError, match="opening the port"):
                stage.position()
            stage.home()
            assert stage.position() == (-1.0, -1.0, -1.0)


def test_trait_08_only_one_line_is_unanswered_at_a_time() -> None:
    script = ScriptedGrbl()
    in_flight: list[int] = []
    pending = 0

    def on_move(target: Point) -> Iterator[bytes | float]:
        nonlocal pending
        pending += 1
        in_flight.append(pending)
        yield 0.02
        script.at = target
        pending -= 1
        yield b"ok\r\n"

    with opened(script) as stage:
        script.on_move = on_move
        for step in range(20):
            stage.move((-10.0, -20.0, -5.0 - 0.1 * step), 20.0)
        assert in_flight == [1] * 20


def test_trait_09_real_time_bytes_are_raw() -> None:
    script = ScriptedGrbl()
    with script.peer() as peer, GrblStage(peer.port, timeout_s=TIMEOUT_S) as stage:
        stage._line.write_now(b"\x85")
        stage.stop()
        stage.position()
        assert b"\x85!" in bytes(peer.received) and b"\xc2" not in bytes(peer.received)


def test_trait_10_ok_without_homing_is_not_trusted() -> None:
    script = ScriptedGrbl()
    script.at = (-50.0, -50.0, -50.0)
    script.on_home = lambda: [b"ok\r\n"]
    with script.peer() as peer, GrblStage(peer.port, timeout_s=TIMEOUT_S) as stage:
        with pytest.raises(PositionLostError, match="did not home"):
            stage.home()
        with pytest.raises(PositionLostError):
            stage.move(THERE, 20.0)


def test_trait_12_grblhal_and_its_fresh_memory_are_recognised() -> None:
    script = ScriptedGrbl()
    script.banner = b"error:7\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
    script.version = b"[VER:1.1f.20230101:]\r\n[OPT:VNMSL,35,1024,3,0]\r\n[FIRMWARE:grblHAL]\r\nok\r\n"
    script.on_status = lambda: [
        script.report().replace(b"|FS:0,0>", b"|Bf:35,1024|FS:0,0|WCO:0.000,0.000,0.000|A:|H:1,7|TLR:0>")
    ]
    with opened(script) as stage:
        assert stage.identity.startswith("grbl: grblHAL 1.1f")
        assert stage.move(THERE, 20.0) == THERE


def test_trait_13_grblhal_reports_its_alarm_in_the_status_and_may_skip_answers() -> None:
    script = ScriptedGrbl()
    query_count = 0

    def every_other() -> Iterator[bytes]:
        nonlocal query_count
        query_count += 1
        return iter([script.report()] if query_count % 2 else [])

    def on_move(target: Point) -> Iterator[bytes | float]:
        script.state = "Alarm:2"
        yield b"ok\r\n"

    with opened(script) as stage:
        script.on_status = every_other
        stage.move(THERE, 20.0)
        script.on_move = on_move
        with pytest.raises(AlarmError, match="state Alarm"):
            stage.move((-11.0, -20.0, -5.0), 20.0)


def test_a_carriage_that_leaves_its_line_is_stopped() -> None:
    script = ScriptedGrbl()

    def on_move(target: Point) -> Iterator[bytes | float]:
        script.state, script.at = "Run", (-1.0, -1.0, -9.0)
        yield b"ok\r\n"

    with script.peer() as peer, GrblStage(peer.port, timeout_s=TIMEOUT_S) as stage:
        stage.home()
        script.on_move = on_move
        with pytest.raises(RigError, match="off the line to"):
            stage.move((-1.0, -1.0, -2.0), 20.0)
        stage.position()
        assert b"!" in bytes(peer.received)


def test_an_interruption_in_a_move_stops_the_carriage() -> None:
    script = ScriptedGrbl()
    with opened(script) as stage:
        moving(script)
        clock().interrupt(0.15)
        with pytest.raises(KeyboardInterrupt):
            stage.move(THERE, 20.0)
        script.on_move = None
        assert stage.position() == (-1.0, -1.0, -1.0)


def test_stop_during_homing_resets_and_the_position_is_unknown() -> None:
    script = ScriptedGrbl()
    with script.peer() as peer, GrblStage(peer.port, timeout_s=TIMEOUT_S) as stage:
        script.on_home = list
        script.on_reset = lambda: [b"ALARM:6\r\n", script.banner] if peer.lines[-1] == b"$H" else [script.banner]
        clock().after(0.3, stage.stop)
        with pytest.raises(AlarmError, match="ALARM:6"):
            stage.home()
        with pytest.raises(PositionLostError):
            stage.move(THERE, 20.0)
