"""Test the driver of the paper's firmware against a scripted peer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pytest
from helpers.rig_here import clock
from helpers.scripted_peer import Peer

from tacbench_cad.lab.rig.arduino import ArduinoStage
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.rig.errors import NoAnswerError, PositionLostError, RigError
from tacbench_cad.lab.study.spec import Point, StageSettings
from tacbench_cad.util.errors import InputError

THERE: Point = (2.0, 4.0, -1.0)
TIMEOUT_S = 0.3

pytestmark = pytest.mark.usefixtures("rig_time")


class Script:
    """A firmware that arrives at once."""

    def __init__(self, shows: bool = True) -> None:
        self.steps = [0, 0, 0]
        self.shows = shows
        self.moves: list[bytes] = []
        self.pauses: list[bytes | float] = [b"done\n"]
        self.obeys = True
        self.mute = False

    def peer(self) -> Peer:
        return Peer(self.answer, realtime=b"")

    def answer(self, line: bytes) -> Iterator[bytes | float]:
        word, *rest = line.split(b",")
        if self.mute or not word:
            return
        if word == b"RESET":
            self.steps = [0, 0, 0]
            yield b"homing\nall done\n"
        elif word == b"SHOW":
            yield b"%d,%d,%d\n" % tuple(self.steps) if self.shows else b"ready\n"
            yield b"done\n"
        elif word == b"MOVE":
            self.moves.append(line)
            if self.obeys:
                self.steps = [int(word) for word in rest[:3]]
            yield from self.pauses


def opened(peer: Peer, *, timeout_s: float = TIMEOUT_S, speed: float = 1.0) -> ArduinoStage:
    clock = Clock(speed=speed)
    return ArduinoStage(peer.port, steps_per_mm=(100.0, -200.0, 400.0), clock=clock, timeout_s=timeout_s)


def test_moves_are_in_whole_steps_with_signs_and_a_pause() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        assert stage.move(THERE, 20.0) == THERE == stage.position()
        # 4.58 mm at 20 mm/s take 0.229 s, in which the axis with the most steps makes 800.
        assert script.moves == [b"MOVE,200,-800,-400,286"]
        assert stage.move((2.0, 4.0, -1.0011), 20.0) == pytest.approx((2.0, 4.0, -1.0))
        assert len(script.moves) == 1


def test_without_positions_done_means_arrival() -> None:
    script = Script(shows=False)
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        assert stage.position() == (0.0, 0.0, 0.0)
        assert stage.move(THERE, 20.0) == THERE == stage.position()


def test_nothing_moves_before_homing() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        with pytest.raises(PositionLostError, match="not homed"):
            stage.move(THERE, 20.0)
        assert script.moves == []


def test_counters_are_trusted_when_a_port_is_opened() -> None:
    script = Script()
    script.steps = [100, -200, 400]
    with script.peer() as peer, opened(peer) as stage:
        assert stage.position() == (1.0, 1.0, 1.0)


def test_done_without_motion_is_not_an_arrival() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        stage.move(THERE, 20.0)
        script.obeys = False
        with pytest.raises(RigError, match="instead of"):
            stage.move((3.0, 4.0, -1.0), 20.0)
        assert stage.position() == THERE


def test_a_garbled_target_makes_the_position_unknown() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        obey = script.answer
        peer.answer = lambda line: obey(line.replace(b"MOVE,2", b"MOVE,22"))
        with pytest.raises(RigError, match="instead of"):
            stage.move(THERE, 20.0)
        peer.answer = obey
        with pytest.raises(PositionLostError, match="went to a wrong position"):
            stage.move(THERE, 20.0)
        stage.home()
        assert stage.move(THERE, 20.0) == THERE


@pytest.mark.parametrize("order", [b"RESET", b"MOVE", b"SHOW"])
def test_a_garbled_command_is_sent_again(order: bytes) -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        stage.move(THERE, 20.0)
        obey, garbled = script.answer, 0

        def once(line: bytes) -> Iterable[bytes | float]:
            nonlocal garbled
            if not line.startswith(order) or garbled:
                return obey(line)
            garbled += 1
            return []

        peer.answer = once
        stage.move((3.0, 4.0, -1.0), 20.0)
        stage.home()
        assert stage.position() == (0.0, 0.0, 0.0)
        assert garbled == 1


def test_a_long_homing_is_not_started_twice() -> None:
    script = Script()
    orders: list[bytes] = []
    with script.peer() as peer, opened(peer) as stage:
        obey = script.answer

        def slow(line: bytes) -> Iterator[bytes | float]:
            orders.append(line)
            if line == b"RESET":
                yield 2.5 * TIMEOUT_S
            yield from obey(line)

        peer.answer = slow
        stage.home()
        assert stage.move(THERE, 20.0) == THERE
    assert orders.count(b"RESET") == 1


@pytest.mark.parametrize("damaged", [b"1,2,3", b"201,-800,-400"])
def test_a_single_damaged_position_is_not_trusted(damaged: bytes) -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        stage.move(THERE, 20.0)
        obey, shows = script.answer, 0

        def answer(line: bytes) -> Iterable[bytes | float]:
            nonlocal shows
            shows += line == b"SHOW"
            return [damaged + b"\ndone\n"] if line == b"SHOW" and shows == 1 else obey(line)

        peer.answer = answer
        assert stage.position() == THERE
        assert shows >= 2


def test_a_position_that_changes_each_time_is_refused() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        stage.move(THERE, 20.0)
        others = iter(range(100))
        peer.answer = lambda line: [b"7,8,%d\ndone\n" % next(others)]
        with pytest.raises(RigError, match="each time"):
            stage.position()


def test_a_lost_done_does_not_hide_an_arrival_if_show_reports_positions() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        script.pauses = [b"d\xefne\n"]
        assert stage.move(THERE, 200.0) == THERE


def test_a_silent_reset_is_detected_by_the_counters() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        stage.move(THERE, 20.0)
        script.steps = [0, 0, 0]
        with pytest.raises(PositionLostError, match="0, 0, 0"):
            stage.move((3.0, 4.0, -1.0), 20.0)
        stage.home()
        assert stage.move(THERE, 20.0) == THERE


def test_a_firmware_that_hangs_causes_a_timeout() -> None:
    script = Script()
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        script.mute = True
        with pytest.raises(NoAnswerError):
            stage.move(THERE, 200.0)


def test_opening_waits_for_the_boot_loader() -> None:
    script = Script()
    script.mute = True
    clock().after(0.7, lambda: setattr(script, "mute", False))
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        assert stage.position() == (0.0, 0.0, 0.0)


def test_a_stop_from_a_signal_handler_ends_the_move_after_the_current_piece() -> None:
    script = Script()
    script.pauses = [0.1, b"done\n"]
    with script.peer() as peer, opened(peer) as stage:
        stage.home()
        clock().after(0.25, stage.stop)
        with pytest.raises(RigError, match="stopped on request"):
            stage.move((20.0, 4.0, -1.0), 4.0)
        # The plan had ten pieces of half a second each.
        assert 1 <= len(script.moves) <= 6
        assert stage.position()[0] < 15.0


def test_another_firmware_is_refused() -> None:
    def marlin(line: bytes) -> Iterator[bytes]:
        return iter([b'echo:Unknown command: "SHOW"\nok done\n'])

    with Peer(marlin, realtime=b"") as peer, pytest.raises(RigError, match="not the paper's"):
        opened(peer)


@pytest.mark.parametrize("steps", [None, [1, 2], [1, 2, 0], "abc", [1, 2, "3"], [1.0, 2.0, float("nan")], [1, 2, True]])
def test_steps_per_mm_are_checked_before_anything_is_opened(steps: object) -> None:
    with pytest.raises(InputError, match="steps_per_mm"):
        options = {} if steps is None else {"steps_per_mm": steps}
        open_stage(StageSettings(driver="arduino", port="/dev/null", limits_mm=((0.0, 1.0),) * 3, options=options))
