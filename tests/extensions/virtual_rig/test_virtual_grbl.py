"""Test the virtual GRBL byte by byte: traits of GRBL 1.1h, numbered as in the tests of the driver."""

from __future__ import annotations

from helpers.firmware_host import Host, homed, near

BANNER = b"\r\nGrbl 1.1h ['$' for help]\r\n"
LOCKED = b"[MSG:'$H'|'$X' to unlock]\r\n"
LONG = b"G1 X100 F600\n"


def status(host: Host) -> bytes:
    return host.ask(b"?", 0.02)


# 1 and 2: alarms


def test_soft_limit_sends_alarm_2_and_a_late_ok_before_the_next_banner() -> None:
    host = homed("grbl")
    answer = host.ask(b"G1 X300 F600\n", 0.02)
    assert answer == b"ALARM:2\r\n"
    assert host.wait(1.0) == b"[MSG:Reset to continue]\r\n"
    assert host.ask(b"?", 5.0) == b""
    assert host.ask(b"G1 X1 F600\n$X\n", 5.0) == b""
    assert host.ask(b"\x18", 0.1) == b"ok\r\n" + BANNER + LOCKED
    assert host.ask(b"", 3.0) == b"", "queries during the alarm were answered later"
    assert status(host).startswith(b"<Alarm|")


def test_closed_end_stop_sends_alarm_1_and_silences_until_reset() -> None:
    host = homed("grbl", firmware={"settings": {20: 0}})
    host.send(b"G1 X-20 F600\n")
    assert b"ALARM:1\r\n[MSG:Reset to continue]\r\n" in host.wait(2.0)
    assert host.ask(b"????", 3.0) == b""
    assert host.ask(b"\x18", 0.1) == BANNER + b"[MSG:Check Limits]\r\n" + LOCKED
    assert b"|Pn:X" in status(host)


# 4: the reset button


def test_reset_button_in_motion_sends_only_a_banner_and_loses_the_position() -> None:
    host = homed("grbl")
    host.ask(LONG, 3.0)
    host.inject("reset")
    true = host.true
    assert host.wait(2.0) == BANNER + LOCKED
    assert true[0] > 10.0
    assert near(host.true, true, 1e-9)
    assert b"<Alarm|MPos:0.000,0.000,0.000|" in status(host)


# 5: hold and Ctrl-X


def test_ctrl_x_from_hold_0_leaves_idle_without_alarm() -> None:
    host = homed("grbl")
    host.ask(LONG, 1.0)
    host.ask(b"!", 0.01)
    assert status(host).startswith(b"<Hold:1|")
    host.wait(1.0)
    assert status(host).startswith(b"<Hold:0|")
    where = host.reported
    assert host.ask(b"\x18", 0.1) == BANNER
    assert status(host).startswith(b"<Idle|")
    assert near(host.reported, where, 1e-9)


def test_ctrl_x_in_motion_sends_alarm_3_and_a_banner_half_a_second_later() -> None:
    host = homed("grbl")
    host.ask(LONG, 1.0)
    assert host.ask(b"\x18", 0.4) == b"ALARM:3\r\n"
    assert host.wait(0.2) == BANNER + LOCKED
    assert status(host).startswith(b"<Alarm|MPos:")


# 7: the reset on open


def test_reset_on_open_loses_the_first_second_and_no_reset_means_no_banner() -> None:
    host = homed("grbl")
    host.board.opened(resets=True, now_s=host.now_s)
    assert host.ask(b"?$I\n\x18", 1.0) == b""
    assert host.wait(1.0) == BANNER + LOCKED
    host.board.opened(resets=False, now_s=host.now_s)
    assert host.wait(5.0) == b""


# 11: shortly before arrival


def test_status_after_ok_is_run_and_speed_is_0_before_arrival() -> None:
    host = homed("grbl")
    host.send(b"G1 X5 F600\n")
    answer = host.until(b"ok\r\n", step_s=0.0005)
    assert answer == b"ok\r\n"
    assert host.ask(b"?", 0.01).startswith(b"<Run|")
    still = []
    for _ in range(200):
        report = host.ask(b"?", 0.005)
        if b"<Run|" in report and b"|FS:0,0" in report:
            still.append(report)
    assert still and b"MPos:5.000," not in still[0]


# 22 and 23: motors at rest, and limits


def test_motors_lose_their_power_after_each_move_unless_setting_1_is_255() -> None:
    host = homed("grbl", firmware={"settings": {1: 25}})
    for x in (1, 2, 3):
        host.ask(b"G1 X%d F600\n" % x, 1.0)
    assert host.board.firmware.motors_off == 3
    host.ask(b"$1=255\nG1 X1 F600\n", 1.0)
    assert host.board.firmware.motors_off == 3


# grblHAL: 12, 13 and 21


def test_grblhal_refuses_lines_after_an_error_until_an_empty_line() -> None:
    host = homed("grblhal")
    assert host.ask(b"G1 X\n") == b"error:2\r\n"
    assert host.ask(b"G1 X1 F600\n") == b"error:2\r\n"
    assert host.ask(b"\n") == b"ok\r\n"
    assert host.ask(b"G1 X1 F600\n", 0.1) == b"ok\r\n"
    host.wait(1.0)
    host.ask(b"G1 X\n")
    host.ask(b"\x18", 0.5)
    assert host.ask(b"G1 X2 F600\n", 0.1) == b"ok\r\n"


def test_grblhal_sends_its_banner_and_an_error_with_fresh_memory() -> None:
    host = Host("grblhal")
    assert host.greeting == b"error:7\r\n\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n" + LOCKED
    host.inject("reset")
    assert b"error" not in host.wait(2.0)
    report = status(host)
    for name in (b"|Bf:", b"|A:", b"|H:", b"|TLR:"):
        assert name in report


def test_grblhal_reset_in_motion_sends_only_the_banner() -> None:
    host = homed("grblhal")
    host.ask(LONG, 1.0)
    assert host.ask(b"\x18", 0.1) == b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
    assert status(host).startswith(b"<Idle|")
    assert 5.0 < host.reported[0] < 11.0
