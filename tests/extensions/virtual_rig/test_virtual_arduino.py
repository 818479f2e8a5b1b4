"""Test the virtual copy of the authors' Arduino firmware byte by byte, as far as its protocol is known."""

from __future__ import annotations

from helpers.firmware_host import Host, homed, near


def test_sends_nothing_unrequested_and_answers_done() -> None:
    host = Host("arduino")
    assert host.greeting == b""
    assert host.ask(b"SHOW\n") == b"0,0,0\ndone\n"
    assert host.ask(b"what\n\nSHO") == b""
    assert host.ask(b"W\r\n") == b"0,0,0\ndone\n"


def test_reset_homes_and_done_is_sent_on_arrival() -> None:
    host = Host("arduino")
    assert host.ask(b"RESET\n", 1.0) == b""
    assert host.until(b"done\n") == b"done\n"
    assert near(host.true, (0.0, 0.0, 0.0), 0.01)
    host.send(b"MOVE,4000,8000,-400,100\n")
    assert host.wait(0.5) == b""
    assert host.until(b"done") == b"done\n"
    assert near(host.true, (10.0, 20.0, -1.0), 0.01)
    assert host.ask(b"SHOW\n") == b"4000,8000,-400\ndone\n"


def test_carriage_runs_into_the_frame() -> None:
    host = homed("arduino")
    assert host.ask(b"MOVE,-4000,0,0,10\n", 5.0) == b"done\n"
    assert host.ask(b"SHOW\n") == b"-4000,0,0\ndone\n"
    assert -3.0 < host.true[0] < -1.0
