"""Test faults of the line, the board and the motors, and send arbitrary bytes to every firmware."""

from __future__ import annotations

from typing import Any

import pytest
from helpers.firmware_host import Host, homed, near
from hypothesis import given, settings
from hypothesis import strategies as st

from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.extensions.virtual_rig.setup import KINDS
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError

ASK = {"grbl": b"$G\n", "grblhal": b"$G\n", "marlin": b"M105\n", "arduino": b"SHOW\n"}


@pytest.mark.parametrize("kind", KINDS)
def test_output_bytes_are_dropped_doubled_and_garbled(kind: str) -> None:
    host = homed(kind)
    answer = host.ask(ASK[kind])
    assert answer
    host.inject("drop", count=3)
    assert host.ask(ASK[kind]) == answer[3:]
    host.inject("double", count=2)
    assert host.ask(ASK[kind]) == answer[:1] * 2 + answer[1:2] * 2 + answer[2:]
    host.inject("garble")
    garbled = host.ask(ASK[kind])
    assert garbled[1:] == answer[1:] and garbled[:1] != answer[:1]
    assert host.ask(ASK[kind]) == answer, "the fault is over"


@pytest.mark.parametrize("kind", KINDS)
def test_silence_blocks_both_directions_for_its_duration(kind: str) -> None:
    host = homed(kind)
    host.inject("silence", seconds=2.0)
    assert host.ask(ASK[kind], 1.9) == b""
    host.wait(0.2)
    assert host.ask(ASK[kind]) != b""


def test_faults_begin_at_the_given_time_or_byte() -> None:
    host = Host("grbl", faults=(Fault(kind="reset", at_s=10.0), Fault(kind="drop", after_bytes=6, count=2)))
    assert host.ask(b"$G\n", 0.1).startswith(b"[GC:")
    assert host.ask(b"$G\n", 0.1).startswith(b"C:G0")
    assert host.wait(6.8) == b""
    assert b"Grbl 1.1h" in host.wait(3.0)


@pytest.mark.parametrize("kind", KINDS)
def test_reset_forgets_and_alarm_halts(kind: str) -> None:
    host = homed(kind)
    host.inject("alarm")
    message = host.wait(1.0)
    assert {"grbl": b"ALARM:1", "grblhal": b"ALARM:1", "marlin": b"halted", "arduino": b""}[kind] in message
    host.inject("reset")
    host.wait(3.0)
    assert host.reported == (0.0, 0.0, 0.0)


def test_slip_changes_only_the_true_position() -> None:
    host = homed("grbl")
    host.ask(b"G1 Z-20 F900\n", 5.0)
    host.inject("slip", axis="z", mm=-1.5)
    assert b"|MPos:0.000,0.000,-20.000|" in host.ask(b"?")
    assert near(host.true, (0.0, 0.0, -21.5), 0.01)


def test_unplugging_blocks_the_line_while_the_firmware_keeps_running() -> None:
    host = homed("grbl")
    host.ask(b"G1 X50 F600\n", 1.0)
    host.inject("unplug", seconds=10.0)
    assert not host.board.plugged
    assert host.ask(b"?", 9.0) == b""
    host.wait(1.1)
    assert host.board.plugged and host.ask(b"?").startswith(b"<Idle|MPos:50.000")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kind": "fire"}, "fault"),
        ({"kind": "drop", "chance": 2.0}, "chance"),
        ({"kind": "drop", "count": -1}, "count"),
        ({"kind": "drop", "count": 1.5}, "count"),
        ({"kind": "drop", "at_s": float("nan")}, "at_s"),
        ({"kind": "drop", "at_s": -1.0}, "at_s"),
        ({"kind": "drop", "at_s": 1.0, "after_bytes": 4}, "not both"),
        ({"kind": "drop", "where": "gauge", "after_bytes": 4}, "no bytes"),
        ({"kind": "slip", "axis": "w"}, "axis"),
        ({"kind": "slip", "mm": "far"}, "mm"),
        ({"kind": "drop", "when": 3}, "when"),
        ({}, "kind: is missing"),
    ],
)
def test_invalid_faults_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Fault.of(values)


def test_faults_from_text_and_from_values() -> None:
    fault = Fault.parse("drop at_s=12 count=3 direction=in chance=0.5")
    assert fault == Fault(kind="drop", at_s=12, count=3, direction="in", chance=0.5)
    assert Fault.of(to_plain(fault)) == fault
    for text in ("", "drop count", "drop count=few"):
        with pytest.raises(InputError):
            Fault.parse(text)


# Arbitrary bytes


def lines(kind: str) -> st.SearchStrategy[bytes]:
    """Return a strategy for bytes that reach deeper than noise: shuffled pieces of the protocol, mixed with noise."""
    own = {
        "grbl": rb"$H|;$X|;G1;G0;G91;G20;X10;Y-5.5;Z-1;F600;$J=;|;G4P1;?;!;~;G92;G10L2P1;$22=0|;$20=0|;$$|;$#|;M0|;M2|",
        "marlin": rb"G28|;G1 ;G91|;X10 ;Y-5.5 ;Z-1 ;F600;|;M400|;M410|;M114|;N1 ;N2 ;*33;M110 N0|;M112|;G4 S1|;M154S1|",
        "arduino": rb"RESET|;MOVE,;100,;-5,;|;SHOW|;ZERO|;CENTRE|;CALIB|",
    }
    pieces = own["grbl" if kind == "grblhal" else kind].replace(b"|", b"\n").split(b";")
    pieces += [b"\x18", b"\x85"]
    return st.lists(st.one_of(st.sampled_from(pieces), st.binary(max_size=12)), max_size=40).map(b"".join)


def check_arbitrary_bytes(kind: str, data: st.DataObject) -> None:
    """Send drawn bytes with pauses and check the invariants of the firmware."""
    host = Host(kind)
    board, firmware = host.board, host.board.firmware
    for _ in range(data.draw(st.integers(1, 4))):
        host.send(data.draw(lines(kind)))
        sent = host.wait(data.draw(st.sampled_from([0.0, 0.01, 0.3, 5.0])))
        assert all(byte < 0x80 for byte in sent)
        assert len(firmware._rx) <= firmware.rx_bytes
        assert firmware.carriage.queued <= 16
        assert board.room >= 0
        for axis, value in zip(firmware.carriage.axes, host.true, strict=True):
            low, high = axis.ends_mm
            assert low - 1e-9 <= value <= high + 1e-9
    host.inject("reset")
    host.wait(3.0)
    assert host.ask(ASK[kind], 0.5) or kind == "arduino", "the firmware does not answer after a reset"


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_arbitrary_bytes_break_no_firmware_and_memory_is_bounded(kind: str, data: st.DataObject) -> None:
    check_arbitrary_bytes(kind, data)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=3000, deadline=None)
@given(data=st.data())
def test_many_arbitrary_bytes_break_no_firmware(kind: str, data: st.DataObject) -> None:
    check_arbitrary_bytes(kind, data)
