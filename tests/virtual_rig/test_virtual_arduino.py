"""The authors' Arduino firmware, byte by byte, as far as its protocol is known."""

from __future__ import annotations

from helpers.firmware_host import Host, homed, near


def test_it_says_nothing_by_itself_and_answers_with_done() -> None:
    host = Host("arduino")
    assert host.greeting == b""
    assert host.ask(b"SHOW\n") == b"0,0,0\ndone\n"
    assert host.ask(b"what\n\nSHO") == b""
    assert host.ask(b"W\r\n") == b"0,0,0\ndone\n"


def test_reset_homes_and_done_comes_on_arrival() -> None:
    host = Host("arduino")
    assert host.ask(b"RESET\n", 1.0) == b""
    assert host.until(b"done\n") == b"done\n"
    assert near(host.true, (0.0, 0.0, 0.0), 0.01)
    host.send(b"MOVE,4000,8000,-400,100\n")
    assert host.wait(0.5) == b""
    assert host.until(b"done") == b"done\n"
    assert near(host.true, (10.0, 20.0, -1.0), 0.01)
    assert host.ask(b"SHOW\n") == b"4000,8000,-400\ndone\n"


def test_it_reads_nothing_in_motion_but_what_64_bytes_hold() -> None:
    host = homed("arduino")
    host.send(b"MOVE,40000,0,0,10\n")
    host.wait(0.5)
    host.send(b"SHOW\n" * 30)
    assert host.wait(20.0) == b"done\n" + b"40000,0,0\ndone\n" * 12


def test_a_mutilated_move_goes_elsewhere_and_says_done() -> None:
    host = homed("arduino")
    assert host.ask(b"MOVE,4000,\n", 5.0) == b"done\n"
    assert near(host.true, (10.0, 0.0, 0.0), 0.01)


def test_it_runs_into_its_frame() -> None:
    host = homed("arduino")
    assert host.ask(b"MOVE,-4000,0,0,10\n", 5.0) == b"done\n"
    assert host.ask(b"SHOW\n") == b"-4000,0,0\ndone\n"
    assert -3.0 < host.true[0] < -1.0


def test_reset_finds_the_same_zero_after_a_run_into_the_frame() -> None:
    host = homed("arduino")
    host.ask(b"MOVE,-4000,-8000,0,10\n", 5.0)
    assert host.true[1] < -1.0
    assert host.ask(b"RESET\nSHOW\n", 60.0) == b"done\n0,0,0\ndone\n"
    assert near(host.true, (0.0, 0.0, 0.0), 0.01)


def test_zero_centre_and_calib() -> None:
    host = homed("arduino")
    host.ask(b"MOVE,400,400,-400,10\n", 5.0)
    assert host.ask(b"ZERO\nSHOW\n") == b"done\n0,0,0\ndone\n"
    assert host.ask(b"CALIB\nSHOW\n", 60.0) == b"done\n40000,40000,0\ndone\n"
    host.ask(b"MOVE,0,0,-400,10\nCENTRE\n", 60.0)
    assert near(host.true, (100.0, 100.0, -1.0), 0.01)


def test_a_hung_sketch_is_mute_until_reset() -> None:
    host = homed("arduino")
    host.inject("alarm")
    assert host.ask(b"SHOW\n", 10.0) == b""
    host.inject("reset")
    host.wait(2.0)
    assert host.ask(b"SHOW\n") == b"0,0,0\ndone\n"
