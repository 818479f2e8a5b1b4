"""Test the virtual GRBL byte by byte: traits of GRBL 1.1h, numbered as in the tests of the driver."""

from __future__ import annotations

import re

import pytest
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


def test_soft_limit_in_motion_stops_first_and_keeps_the_position() -> None:
    host = homed("grbl")
    assert host.ask(LONG, 1.0) == b"ok\r\n"
    host.send(b"G1 X300 F600\n")
    assert b"ALARM:2" in host.wait(0.5)
    where = host.reported
    assert 5.0 < where[0] < 12.0
    host.wait(1.0)
    host.ask(b"\x18", 0.5)
    assert near(host.reported, where, 1e-9)
    assert near(host.true, where, 0.005)


def test_closed_end_stop_sends_alarm_1_and_silences_until_reset() -> None:
    host = homed("grbl", firmware={"settings": {20: 0}})
    host.send(b"G1 X-20 F600\n")
    assert b"ALARM:1\r\n[MSG:Reset to continue]\r\n" in host.wait(2.0)
    assert host.ask(b"????", 3.0) == b""
    assert host.ask(b"\x18", 0.1) == BANNER + b"[MSG:Check Limits]\r\n" + LOCKED
    assert b"|Pn:X" in status(host)


def test_reset_during_the_pause_of_an_alarm_is_lost() -> None:
    host = homed("grbl")
    host.ask(b"G1 X300 F600\n", 0.1)
    assert host.ask(b"\x18", 3.0) == b"[MSG:Reset to continue]\r\n"


def test_waiting_line_causes_ok_between_alarm_3_and_banner() -> None:
    host = homed("grbl")
    for i in range(25):
        host.send(b"G1 X%d F600\n" % (i + 1))
        host.wait(0.02)
    assert host.ask(b"\x18", 2.0) == b"ALARM:3\r\nok\r\n" + BANNER + LOCKED


# 3: homing


def test_homing_answers_only_one_query_and_late() -> None:
    host = Host("grbl")
    assert host.ask(b"$H\n", 0.1) == b""
    for _ in range(8):
        assert host.ask(b"?", 0.5) == b""
    end = host.until(b"ok")
    assert end == b"<Home|MPos:0.000,0.000,0.000|FS:0,0|WCO:0.000,0.000,0.000>\r\nok\r\n"
    assert near(host.true, (0.0, 0.0, 0.0), 0.005)


def test_homing_with_a_dead_motor_sends_an_alarm_and_ok() -> None:
    host = Host("grbl")
    host.inject("stall", axis="x")
    host.send(b"$H\n")
    assert host.until(b"unlock]") == b"ALARM:9\r\nok\r\n" + BANNER + LOCKED


def test_ctrl_x_during_homing_sends_alarm_6() -> None:
    host = Host("grbl")
    host.ask(b"$H\n", 1.0)
    assert host.ask(b"\x18", 2.0) == b"ALARM:6\r\nok\r\n" + BANNER + LOCKED


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


def test_reset_without_homing_ends_in_idle() -> None:
    host = homed("grbl")
    assert host.ask(b"$22=0\n", 0.1) == b"ok\r\n"
    host.ask(LONG, 3.0)
    host.inject("reset")
    assert host.wait(2.0) == BANNER
    assert b"<Idle|MPos:0.000,0.000,0.000|" in status(host)


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


def test_hold_and_resume_reach_the_end_of_the_line() -> None:
    host = homed("grbl")
    host.ask(b"G1 X20 F600\nG1 X20 Y10\n", 1.0)
    host.ask(b"!", 5.0)
    held = host.reported
    assert host.wait(5.0) == b"" and host.reported == held
    host.send(b"~")
    host.wait(10.0)
    assert status(host).startswith(b"<Idle|MPos:20.000,10.000,0.000|")


# 6: errors


def test_errors_and_their_causes() -> None:
    host = Host("grbl")
    assert host.ask(b"G1 X1 F100\n") == b"error:9\r\n"
    assert host.ask(b"$J=G91 X1 F100\n") == b"error:8\r\n"
    host = homed("grbl")
    assert host.ask(b"$J=G91 X500 F600\n") == b"error:15\r\n"
    assert status(host).startswith(b"<Idle|")
    assert host.ask(b"$22=0\n") == b"ok\r\n"
    assert host.ask(b"$20=1\n") == b"error:10\r\n"
    assert host.ask(b"$22=1\n$20=1\n") == b"ok\r\nok\r\n"


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"5X1", 1), (b"G1 X", 2), (b"$abc", 3), (b"$20=-1", 4), (b"G2 X1 I1", 20), (b"G0 G1 X1", 21), (b"G1 X1", 22),
        (b"X1 X2", 25), (b"G92", 26), (b"G4", 28), (b"$J=G1 X1 F1", 16), (b"$J=X1", 22), (b"X" + b"1" * 90, 11),
    ],
)  # fmt: skip
def test_refused_lines(line: bytes, code: int) -> None:
    host = homed("grbl")
    assert host.ask(line + b"\n") == b"error:%d\r\n" % code


# 7: the reset on open


def test_reset_on_open_loses_the_first_second_and_no_reset_means_no_banner() -> None:
    host = homed("grbl")
    host.board.opened(resets=True, now_s=host.now_s)
    assert host.ask(b"?$I\n\x18", 1.0) == b""
    assert host.wait(1.0) == BANNER + LOCKED
    host.board.opened(resets=False, now_s=host.now_s)
    assert host.wait(5.0) == b""


# 8: the receive buffer


def test_most_of_sixty_lines_sent_at_once_are_lost_without_an_error() -> None:
    host = homed("grbl")
    for i in range(60):
        host.send(b"G1 X%.3f Y%.3f F500\n" % (1 + i % 2 * 10, 1.0 + i))
    answers = host.wait(600.0)
    assert b"error" not in answers and b"ALARM" not in answers
    assert 18 <= answers.count(b"ok") <= 26


def test_buffer_holds_128_bytes() -> None:
    host = homed("grbl")
    for i in range(16):
        host.ask(b"G1 X%d F60\n" % (i + 1), 0.02)
    host.send(b"\n" * 300)
    assert host.wait(60.0).count(b"ok") == 128 + 1


# 9: real-time bytes


def test_jog_cancel_is_one_raw_byte_and_its_utf8_form_is_two() -> None:
    for data in (b"\x85", "\x85".encode()):
        host = homed("grbl")
        host.ask(b"$J=G91 X100 F600\n", 2.0)
        host.send(data)
        assert len(data) == (1 if data == b"\x85" else 2)
        host.wait(1.0)
        assert status(host).startswith(b"<Idle|")
        assert 10.0 < host.reported[0] < 25.0
        assert host.ask(b"G91 G1 X1 F600\n", 0.1) == b"ok\r\n"


def test_bytes_above_127_are_removed_from_lines() -> None:
    host = homed("grbl")
    assert host.ask(b"\xc2\xffG91\xfe\n") == b"ok\r\n"


def test_real_time_bytes_work_inside_a_line() -> None:
    host = homed("grbl")
    assert re.fullmatch(rb"<Idle\|[^>]*>\r\nok\r\n", host.ask(b"G9?1\n"))


# 10: damaged lines


def test_line_without_its_first_bytes_can_be_answered_with_ok() -> None:
    host = homed("grbl")
    host.ask(b"G1 X10 Y10 F3000\n", 3.0)
    host.inject("drop", direction="in", count=8)
    assert host.ask(b"G1 X120 Y30\n", 8.0) == b"ok\r\n", "X120 was lost without a message"
    assert near(host.reported, (10.0, 30.0, 0.0))


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


# Lines


def test_line_ends_and_comments() -> None:
    host = homed("grbl")
    assert host.ask(b"G91\r\n") == b"ok\r\nok\r\n", "GRBL reads CR and LF as the ends of two lines"
    assert host.ask(b"\n") == b"ok\r\n"
    assert host.ask(b"(hello $H) g90 ; bye\n") == b"ok\r\n"
    assert host.ask(b"$G\n") == b"[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]\r\nok\r\n"


def test_settings_and_identity() -> None:
    host = homed("grbl")
    listed = host.ask(b"$$\n", 1.0)
    assert b"$100=400.000\r\n" in listed and b"$130=200.000\r\n" in listed and listed.endswith(b"ok\r\n")
    assert host.ask(b"$I\n") == b"[VER:1.1h.20190830:SIMULATED]\r\n[OPT:VZ,15,128]\r\nok\r\n"
    assert b"[G54:0.000,0.000,0.000]\r\n" in host.ask(b"$#\n", 0.2)
    host.ask(LONG, 0.5)
    assert host.ask(b"$$\n") == b"error:8\r\n"


def test_offsets_change_work_but_not_machine_coordinates() -> None:
    host = homed("grbl")
    host.ask(b"G1 X10 Y10 F3000\n", 3.0)
    assert host.ask(b"G92 X0\n") == b"ok\r\n"
    host.ask(b"G1 X5\n", 3.0)
    assert near(host.reported, (15.0, 10.0, 0.0))
    host.ask(b"G53 G1 X5\n", 3.0)
    assert near(host.reported, (5.0, 10.0, 0.0))
    host.ask(b"G92.1\nG10 L2 P1 Y1\nG1 Y3\n", 3.0)
    assert near(host.reported, (5.0, 4.0, 0.0))
    assert host.ask(b"G10 L20 P1 Z0\n", 0.1) == b"ok\r\n"


def test_inches_and_relative_moves() -> None:
    host = homed("grbl")
    host.ask(b"G20 G91 G1 X1 F60\n", 3.0)
    host.ask(b"X-0.5\n", 3.0)
    assert near(host.reported, (12.7, 0.0, 0.0))


def test_dwell_and_program_end_wait_for_the_motion() -> None:
    host = homed("grbl")
    assert host.ask(b"G1 X10 F600\nG4 P0.5\n", 1.2) == b"ok\r\n"
    assert host.until(b"ok") == b"ok\r\n"
    assert host.reported[0] == 10.0
    assert host.ask(b"M2\n") == b"[MSG:Pgm End]\r\nok\r\n"


def test_status_contains_offsets_and_overrides_periodically() -> None:
    host = homed("grbl")
    reports = [status(host) for _ in range(20)]
    assert sum(b"|WCO:" in report for report in reports) == 2
    assert sum(b"|Ov:" in report for report in reports) == 2
    assert all(
        re.fullmatch(rb"<Idle\|MPos:0\.000,0\.000,0\.000\|FS:0,0(\|(WCO|Ov):[0-9.,]+)?>\r\n", r) for r in reports
    )


def test_report_mask_selects_work_position_and_buffer() -> None:
    host = homed("grbl")
    host.ask(b"$10=2\n")
    assert b"|WPos:0.000,0.000,0.000|Bf:15,128|" in status(host)


# 22 and 23: motors at rest, and limits


def test_motors_lose_their_power_after_each_move_unless_setting_1_is_255() -> None:
    host = homed("grbl", firmware={"settings": {1: 25}})
    for x in (1, 2, 3):
        host.ask(b"G1 X%d F600\n" % x, 1.0)
    assert host.board.firmware.motors_off == 3
    host.ask(b"$1=255\nG1 X1 F600\n", 1.0)
    assert host.board.firmware.motors_off == 3


def test_moves_that_follow_at_once_keep_the_motors_powered() -> None:
    host = homed("grbl", firmware={"settings": {1: 25}})
    host.ask(b"G1 X1 F600\nG1 X2 F600\n", 1.0)
    assert host.board.firmware.motors_off == 1


def test_a_quiet_limit_is_reported_only_after_the_banner() -> None:
    host = homed("grbl", firmware={"quiet_limits": True, "settings": {20: 0}})
    host.send(b"G1 X-20 F600\n")
    assert host.wait(2.0) == b"ok\r\n" + BANNER + b"[MSG:Check Limits]\r\n" + LOCKED
    assert status(host).startswith(b"<Alarm|")


def test_a_stuck_switch_raises_an_alarm_and_homing_moves_away_from_it() -> None:
    host = homed("grbl")
    host.ask(b"G1 Z-50 F900\n", 6.0)
    host.inject("switch", axis="z")
    assert b"ALARM:1" in host.wait(1.0)
    assert host.ask(b"\x18", 0.1) == BANNER + b"[MSG:Check Limits]\r\n" + LOCKED
    assert b"|Pn:Z" in status(host)
    host.send(b"$H\n")
    assert b"ALARM:8" in host.until(b"unlock]")
    assert near(host.true, (0.0, 0.0, -51.0), 0.01)


def test_the_default_build_counts_from_the_switches() -> None:
    # The switches scatter. With this seed, the one of z closes just below 0.
    host = homed("grbl", origin="switch", seed=4)
    assert near(host.reported, (-199.0, -199.0, -1.0))
    assert b"[OPT:V,15,128]" in host.ask(b"$I\n")
    assert b"ALARM:1" in host.ask(b"G1 Z0 F60\n", 2.0)


def test_replies_come_late_and_in_order() -> None:
    host = homed("grbl", late_s=(0.3, 1.0))
    host.send(b"G91\n?G90\n")
    assert host.wait(0.29) == b""
    assert re.fullmatch(rb"(ok\r\n|<Idle[^>]*>\r\n){3}", host.wait(3.0))


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


def test_grblhal_answers_in_alarm_2() -> None:
    host = homed("grblhal")
    assert b"ALARM:2\r\n" in host.ask(b"G1 X300 F600\n", 0.2)
    assert status(host).startswith(b"<Alarm|")


def test_grblhal_reset_in_motion_sends_only_the_banner() -> None:
    host = homed("grblhal")
    host.ask(LONG, 1.0)
    assert host.ask(b"\x18", 0.1) == b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
    assert status(host).startswith(b"<Idle|")
    assert 5.0 < host.reported[0] < 11.0


def test_grblhal_merges_two_queries() -> None:
    host = homed("grblhal")
    assert host.ask(b"??", 0.05).count(b"<Idle") == 1
    assert host.ask(b"?", 0.05).count(b"<Idle") == 1
