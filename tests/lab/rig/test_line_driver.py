"""Test lines over serial ports with time and size limits, and the parsers of firmware messages on arbitrary bytes."""

from __future__ import annotations

import math
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tacbench_cad.lab.rig import arduino, grbl_replies, marlin_replies
from tacbench_cad.lab.rig import line as line_module
from tacbench_cad.lab.rig.errors import DeviceLostError, NoAnswerError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.util.errors import InputError

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


@pytest.fixture
def wire() -> Iterator[tuple[Line, int]]:
    """Return a line and the file descriptor of its far end."""
    if sys.platform == "win32":
        pytest.skip("Windows has no pseudo-terminals")
    import pty
    import tty

    far, near = pty.openpty()
    tty.setraw(near)
    with Line(os.ttyname(near), baud=115200, what="stage") as line:
        os.close(near)
        yield line, far
    os.close(far)


def test_lines_are_complete_and_without_their_ends(wire: tuple[Line, int]) -> None:
    line, far = wire
    os.write(far, b"one\r\n\r\n  two \n\x00three")
    assert [line.read_line(0.5), line.read_line(0.5), line.read_line(0.05)] == ["one", "two", None]
    os.write(far, b"\xff!\n")
    assert line.read_line(0.5) == "three�!"


def test_a_pause_of_this_program_is_not_a_silence_of_the_device(
    wire: tuple[Line, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    line, far = wire
    clock = {"now": time.monotonic()}
    monkeypatch.setattr(line_module, "time", SimpleNamespace(monotonic=lambda: clock["now"]))
    waits = 0

    def paused(*args: object) -> tuple[list[int], list[int], list[int]]:
        """Suspend the program for 12 s during the third wait. The answer comes in the fifth."""
        nonlocal waits
        waits += 1
        clock["now"] += 12.0 if waits == 3 else line_module.WAIT_S
        if waits == 5:
            os.write(far, b"late\n")
        return ([1], [], []) if waits >= 5 else ([], [], [])

    monkeypatch.setattr(line_module, "select", SimpleNamespace(select=paused))
    before = line.now_s()
    assert line.read_line(1.0) == "late"
    assert line.now_s() - before == pytest.approx(4 * line_module.WAIT_S + line_module.MAX_COUNTED_S, abs=0.02)


def test_writing_to_a_device_that_reads_nothing_ends() -> None:
    if sys.platform == "win32":
        pytest.skip("Windows has no pseudo-terminals")
    import pty
    import tty

    far, near = pty.openpty()
    tty.setraw(near)
    with Line(os.ttyname(near), baud=115200, what="stage", write_timeout_s=0.2) as line:
        with pytest.raises(NoAnswerError, match="accepts no data"):
            for _ in range(1000):
                line.write(b"x" * 1000)
        assert line.torn
        line.write_now(b"!")
    os.close(near)
    os.close(far)


@needs_pty
def test_an_unplugged_device_is_reported_and_stopping_it_never_raises() -> None:
    import pty

    far, near = pty.openpty()
    with Line(os.ttyname(near), baud=115200, what="stage") as line:
        os.close(near)
        os.close(far)
        with pytest.raises(DeviceLostError, match="is gone"):
            line.read_line(1.0)
        with pytest.raises(DeviceLostError, match="is gone"):
            line.write(b"?")
        line.write_now(b"!")
    line.write_now(b"!")
    with pytest.raises(DeviceLostError):
        line.read_line(0.1)
    line.close()


@needs_pty
def test_a_port_can_be_opened_only_once() -> None:
    import pty

    far, near = pty.openpty()
    with (
        Line(os.ttyname(near), baud=115200, what="stage"),
        pytest.raises(InputError, match="in use by another program"),
    ):
        Line(os.ttyname(near), baud=115200, what="gauge")
    os.close(near)
    os.close(far)


def test_a_missing_port_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="stage port") as caught:
        Line(str(tmp_path / "ttyUSB7"), baud=115200, what="stage")
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("port", ["socket://127.0.0.1:1", "nonsense://x", "socket://x:notaport"])
def test_an_unreachable_url_is_an_input_error(port: str) -> None:
    with pytest.raises(InputError, match="cannot be opened"):
        Line(port, baud=115200, what="stage")


@pytest.mark.filterwarnings("ignore:set:DeprecationWarning")
def test_a_port_over_rfc_2217_is_stopped_without_its_lock() -> None:
    import serial
    import serial.rfc2217

    class Writer:
        def __init__(self, far: socket.socket) -> None:
            self.write = far.sendall

    def serve() -> None:
        far, _ = server.accept()
        with far, serial.serial_for_url("loop://", timeout=0) as device:
            manager = serial.rfc2217.PortManager(device, Writer(far))
            while data := far.recv(1024):
                device.write(b"".join(manager.filter(data)))
                far.sendall(b"".join(manager.escape(device.read(1024))))

    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=serve, daemon=True).start()
        with Line(f"rfc2217://127.0.0.1:{server.getsockname()[1]}", baud=115200, what="stage") as line:
            line.write(b"echo\n")
            assert line.read_line(2.0) == "echo"
            with line._serial._write_lock:
                line.write_now(b"stop\n")
            assert line.read_line(2.0) == "stop"


# Parsers: they accept any bytes and never take a damaged line for a report.

arbitrary = st.one_of(st.binary(max_size=120).map(lambda raw: raw.decode("ascii", "replace")), st.text(max_size=120))
number = st.integers(-999_999, 999_999).map(lambda micro: micro / 1000.0)
point = st.tuples(number, number, number)
REPORT = "<Run|MPos:1.000,-2.500,3.125|FS:500,0|WCO:0.000,0.000,0.000>"


@given(arbitrary)
@example("<Idle|MPos:nan,inf,1e9>")
@example("<Idle|MPos:1.000,2.000,3.000|MPos:1.000,2.000,4.000>")
@example("ALARM:99999999999")
@example("$130=1e999")
@example("[VER:]")
def test_grbl_replies_accept_any_text(text: str) -> None:
    report = grbl_replies.status(text)
    if report is not None:
        assert report.machine_mm is None or all(map(math.isfinite, report.machine_mm))
    for parse in (grbl_replies.alarm, grbl_replies.error, grbl_replies.version, grbl_replies.is_banner):
        parse(text)
    assert all(math.isfinite(value) for value in grbl_replies.settings([text]).values())


@given(arbitrary)
@example("X:nan Y:0.00 Z:0.00")
@example("Resend: 99999999999999999999")
def test_marlin_replies_accept_any_text(text: str) -> None:
    place = marlin_replies.place(text)
    assert place is None or all(math.isfinite(value) for value in place.planned_mm)
    for parse in (
        marlin_replies.resend,
        marlin_replies.firmware,
        marlin_replies.per_axis,
        marlin_replies.is_ok,
        marlin_replies.unknown,
    ):
        parse(text)
    for tell in (marlin_replies.is_busy, marlin_replies.is_banner, marlin_replies.is_halted):
        assert tell(text) in (True, False)


@given(arbitrary)
def test_arduino_replies_accept_any_text(text: str) -> None:
    counters = arduino.counters(text)
    assert counters is None or len(counters) == 3
    assert arduino.is_done(text) in (True, False)


@given(st.sampled_from(["Idle", "Run", "Hold:0", "Alarm:2"]), point, st.booleans())
def test_reports_round_trip(state: str, at: tuple[float, float, float], extra: bool) -> None:
    more = "|Bf:15,128|FS:0,0|Pn:PZ|A:S|H:1|TLR:0" if extra else "|FS:0,0"
    report = grbl_replies.status("<{}|MPos:{:.3f},{:.3f},{:.3f}{}>".format(state, *at, more))
    assert report is not None and report.machine_mm == at
    assert report.state == state.split(":")[0]


@given(point)
def test_positions_round_trip(at: tuple[float, float, float]) -> None:
    x, y, z = (round(coordinate, 2) for coordinate in at)
    place = marlin_replies.place(f"X:{x:.2f} Y:{y:.2f} Z:{z:.2f} E:0.00 Count X: 1 Y: 2 Z: 3")
    assert place is not None and place.planned_mm == (x, y, z) and place.steps == (1, 2, 3)


@given(st.integers(0, len(REPORT) - 1))
def test_a_report_without_a_character_gives_no_wrong_position(at: int) -> None:
    damaged = REPORT[:at] + REPORT[at + 1 :]
    report = grbl_replies.status(damaged)
    within = REPORT.index("MPos:") + 5 <= at < REPORT.index("|FS")
    assert report is None or within or report.machine_mm == (1.0, -2.5, 3.125)
    # A report without its decimal point is refused, because positions always have three decimals.
    assert not (report is not None and REPORT[at - 1 : at] == ".")


@given(st.integers(0, 10**6), st.text(alphabet=st.characters(min_codepoint=32, max_codepoint=126), max_size=60))
def test_a_frames_checksum_is_the_exclusive_or_of_its_bytes(line: int, command: str) -> None:
    body, _, checksum = marlin_replies.framed(line, command).rpartition(b"*")
    value = 0
    for byte in body:
        value ^= byte
    assert int(checksum) == value and checksum.endswith(b"\n")
