"""Test the virtual Marlin byte by byte: traits of Marlin 2.1, numbered as in the tests of the driver."""

from __future__ import annotations

from functools import reduce
from operator import xor

import pytest
from helpers.firmware_host import Host, homed, near

#: The end stops close between two whole steps.
STEP = 1.0 / 80.0 + 1e-6


def numbered(number: int, command: str, wrong: int = 0) -> bytes:
    text = f"N{number} {command}".encode()
    return text + b"*%d\n" % (reduce(xor, text, 0) ^ wrong)


def where(host: Host) -> bytes:
    return host.ask(b"M114\n", 0.05)


# 14: ok means queued


def test_ok_and_m114_are_sent_when_a_move_is_queued() -> None:
    host = homed("marlin")
    assert host.ask(b"G1 X100 Y50 F600\n", 0.05) == b"ok\n"
    assert where(host) == b"X:100.00 Y:50.00 Z:100.00 E:0.00 Count X:8000 Y:4000 Z:40000\nok\n"
    assert host.true[0] < 2.0
    host.send(b"M400\n")
    assert host.wait(1.5) == b""
    answer = host.until(b"ok\n")
    assert answer.replace(b"echo:busy: processing\n", b"") == b"ok\n"
    assert near(host.true, (100.0, 50.0, 100.0), STEP)


# 15: end stops


# 16: line numbers


def test_checksum_mismatch_requests_a_resend_and_sends_ok() -> None:
    host = homed("marlin")
    assert host.ask(numbered(0, "M110 N0")) == b"ok\n"
    assert host.ask(numbered(1, "G91")) == b"ok\n"
    assert host.ask(numbered(2, "G1 X5 F600", wrong=4)) == (b"Error:checksum mismatch, Last Line: 1\nResend: 2\nok\n")
    assert host.ask(numbered(2, "G1 X5 F600")) == b"ok\n"


def test_repeated_line_gets_no_answer() -> None:
    host = homed("marlin")
    host.ask(numbered(0, "M110 N0") + numbered(1, "G91") + numbered(2, "G1 X5 F600"))
    assert host.ask(numbered(2, "G1 X5 F600"), 5.0) == b""
    assert host.ask(numbered(1, "G91"), 5.0) == b""
    assert where(host).startswith(b"X:5.00")
    assert host.ask(numbered(7, "G90")) == (
        b"Error:Line Number is not Last Line Number+1, Last Line: 2\nResend: 3\nok\n"
    )
    assert host.ask(b"N3 G90\n") == b"Error:No Checksum with line number, Last Line: 2\nResend: 3\nok\n"


# 17: the quick stop


def test_m410_stops_at_once_and_then_ignores_input_for_a_second() -> None:
    host = homed("marlin")
    host.ask(b"G1 X100 F600\n", 2.0)
    assert host.ask(b"M410\n", 0.9) == b""
    assert not host.board.firmware.carriage.moving
    assert host.wait(0.3) == b"ok\n"
    x = host.true[0]
    assert 10.0 < x < 30.0
    reported = float(where(host).split(b" ")[0][2:])
    assert abs(reported - x) < 0.02


# 18: unknown commands, M112, reset


@pytest.mark.parametrize("emergency_parser", [False, True])
def test_m112_halts_until_a_reset_that_forgets_the_position(emergency_parser: bool) -> None:
    host = homed("marlin", firmware={"emergency_parser": emergency_parser})
    host.ask(b"G1 X100 F600\n", 2.0)
    assert host.ask(b"M112\n") == b"Error:Printer halted. kill() called!\n"
    true = host.true
    assert host.ask(b"M114\nM115\n", 30.0) == b""
    assert host.true == true
    host.inject("reset")
    greeting = host.wait(3.0)
    assert greeting.startswith(b"start\nMarlin 2.1.2.7\n") and b"rror" not in greeting
    assert where(host).startswith(b"X:0.00 Y:0.00 Z:0.00 ")
    assert host.true == true


# 19: busy lines, line ends, baud


def test_long_commands_send_busy_every_two_seconds_and_lines_end_with_lf() -> None:
    host = Host("marlin")
    host.send(b"G28\n")
    answer = host.until(b"ok\n")
    assert answer.endswith(b"X:0.00 Y:0.00 Z:100.00 E:0.00 Count X:0 Y:0 Z:40000\nok\n")
    busy = answer.count(b"echo:busy: processing\n")
    assert busy >= 2 and answer.startswith(b"echo:busy: processing\n")
    assert b"\r" not in host.greeting + answer
    assert near(host.true, (0.0, 0.0, 100.0), STEP)
    host.ask(b"G1 X190 F1200\n", 0.1)
    host.send(b"M400\n")
    assert host.until(b"ok\n").count(b"busy") == 4


# 20: short moves, and the wait of a single move


def test_moves_under_six_motor_steps_are_withheld_and_add_up() -> None:
    host = homed("marlin")
    host.ask(b"G1 Z90 F600\nM400\n", 10.0)
    home_error = host.true[2] - 90.0
    for z, count in ((b"89.9975", b"36000"), (b"89.9875", b"36000"), (b"89.9850", b"35994")):
        answer = host.ask(b"G1 Z%s\nM400\nM114\n" % z, 2.0)
        assert answer.startswith(b"ok\nok\nX:0.00 Y:0.00 Z:%.2f " % float(z)), answer
        assert b"Z:%s\n" % count in answer
        assert host.true[2] == pytest.approx(float(count) / 400.0 + home_error)
    # A longer motion of another axis carries the withheld steps with it.
    host.ask(b"G1 X0.05 Z89.9825\nM400\n", 2.0)
    assert host.true[2] == pytest.approx(89.985 + home_error)
    host.ask(b"G1 X10\nM400\n", 2.0)
    assert host.true[2] == pytest.approx(89.9825 + home_error)


# 22: idle motors


def test_idle_motors_are_switched_off_after_two_minutes_and_z_drops() -> None:
    host = homed("marlin")
    host.ask(b"G1 Z90 F600\nM400\n", 119.0)
    assert near(host.true, (0.0, 0.0, 90.0), STEP)
    host.wait(5.0)
    assert host.true[2] == pytest.approx(89.7, abs=STEP)
    assert b" Z:90.00 " in where(host), "the firmware does not notice it"
