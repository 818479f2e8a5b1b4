"""Test virtual rigs over pseudo-terminals and TCP, with faults at run time, and the program that runs one."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tacbench_cad.extensions.virtual_rig import launch
from tacbench_cad.extensions.virtual_rig.faults import Fault
from tacbench_cad.lab.rig.errors import DeviceLostError
from tacbench_cad.util.errors import InputError

serial = pytest.importorskip("serial")
needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
TRANSPORTS = [pytest.param(False, id="pty", marks=needs_pty), pytest.param(True, id="tcp")]
MODULE = "tacbench_cad.extensions.virtual_rig"
SPEED = 50.0


class Port:
    """A host on a serial port that reads with a time limit."""

    def __init__(self, name: str, baud: int = 115200) -> None:
        self.serial = serial.serial_for_url(name, baudrate=baud, timeout=0.005)

    def until(self, mark: bytes, timeout_s: float = 10.0) -> bytes:
        received = b""
        end = time.monotonic() + timeout_s
        while mark not in received:
            assert time.monotonic() < end, (mark, received)
            received += self.serial.read(4096)
        return received

    def ask(self, data: bytes, mark: bytes) -> bytes:
        self.serial.write(data)
        return self.until(mark)

    def quiet(self, seconds: float = 0.1) -> bytes:
        received = b""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            received += self.serial.read(4096)
        return received


def becomes_true(condition: Callable[[], bool], timeout_s: float = 10.0) -> bool:
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.01)
    return False


@pytest.mark.parametrize("tcp", TRANSPORTS)
def test_opening_resets_only_if_requested(tcp: bool) -> None:
    with launch("grbl", speed=SPEED, tcp=tcp, resets_on_open=False) as rig:
        time.sleep(2.0 / SPEED)
        port = Port(rig.port)
        assert port.quiet() == b"", "there is no banner without a reset, and earlier output is lost"
        assert port.ask(b"?", b">").startswith(b"<Alarm")
    with launch("grbl", speed=SPEED, tcp=tcp) as rig:
        for _ in range(3):
            port = Port(rig.port)
            port.until(b"unlock]\r\n")
            port.serial.close()
            time.sleep(0.05)


@pytest.mark.parametrize("tcp", TRANSPORTS)
def test_unplugging_closes_the_port_and_replugging_restores_its_name(tcp: bool) -> None:
    with launch("grbl", speed=SPEED, tcp=tcp) as rig:
        port = Port(rig.port)
        port.until(b"unlock]\r\n")
        rig.inject(Fault(kind="unplug", seconds=10.0))
        with pytest.raises(serial.SerialException):
            for _ in range(100):
                port.serial.write(b"?")
                port.quiet(0.01)
        port.serial.close()

        def back() -> bool:
            try:
                port.serial = Port(rig.port).serial
            except serial.SerialException:
                return False
            return True

        assert becomes_true(back)
        port.until(b"unlock]\r\n")


@pytest.mark.parametrize("tcp", TRANSPORTS)
def test_load_cell_follows_the_true_position(tcp: bool) -> None:
    cell = {"newtons": True, "noise_n": 0.0, "drift_n_per_min": 0.0}
    flat = {"flat_z_mm": -5.0, "n_per_mm": 2.0}
    with launch("grbl", speed=SPEED, tcp=tcp, stimulus=flat, gauge=cell) as rig:
        port, gauge = Port(rig.port), Port(rig.gauge_port)
        port.until(b"unlock]\r\n")
        port.ask(b"$H\n", b"ok\r\n")
        assert b"0.0000\n" in gauge.until(b"\n0.0000\n")
        port.ask(b"G1 Z-6 F900\n", b"ok\r\n")
        assert becomes_true(lambda: b"<Idle" in port.ask(b"?", b">"))
        assert rig.force_n() == pytest.approx(2.0, abs=0.01)
        steady = float(gauge.quiet(0.05).split(b"\n")[-2])
        assert steady == pytest.approx(rig.force_n(), abs=1e-4)
        rig.inject(Fault(kind="slip", axis="z", mm=-1.0))
        assert rig.force_n() == pytest.approx(4.0, abs=0.01)
        rig.put(None)
        assert rig.force_n() == 0.0
        rig.inject(Fault(kind="stuck"))
        assert len(set(gauge.quiet(0.1).split(b"\n")[-20:-1])) == 1
        rig.inject(Fault(kind="unplug", where="gauge"))
        with pytest.raises(serial.SerialException):
            gauge.quiet(5.0)
        assert port.ask(b"?", b">").startswith(b"<Idle"), "the stage's port is a different one"


def test_invalid_arguments_are_refused_at_once() -> None:
    with pytest.raises(InputError, match="kind"):
        launch("reprap")
    with pytest.raises(InputError, match="fire"):
        launch("grbl", faults=["fire"])
    with pytest.raises(InputError, match="flat_z"):
        launch("grbl", tcp=True, stimulus={"flat_z": 3})
    with launch("grbl", tcp=True, faults=["drop at_s=3", {"kind": "reset", "at_s": 4.0}]) as rig:
        assert rig.now_s() >= 0.0


@pytest.mark.parametrize("tcp", TRANSPORTS)
def test_closing_a_rig_ends_its_ports(tcp: bool) -> None:
    rig = launch("grbl", tcp=tcp)
    host = Port(rig.port)
    rig.close()
    rig.close()
    with pytest.raises(serial.SerialException):
        Port(rig.port)
    assert tcp or not Path(rig.port).parent.exists()
    with pytest.raises(DeviceLostError):
        rig.true_position()
    host.serial.close()


@needs_pty
def test_a_rig_that_nobody_closes_ends_with_its_program() -> None:
    code = "from tacbench_cad.extensions.virtual_rig import launch; rig = launch('grbl'); print(rig.port)"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30.0)
    assert result.returncode == 0 and not Path(result.stdout.strip()).parent.exists()


@needs_pty
@pytest.mark.parametrize(("end", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_program_reports_that_it_simulates(end: signal.Signals, code: int) -> None:
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            MODULE,
            "marlin",
            "--speed",
            "50",
            "--flat",
            "20",
            "2",
            "--gauge",
            "newtons=1",
            "--option",
            "emergency_parser=1",
        ],
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
    )
    assert process.stderr is not None
    first, second = process.stderr.readline(), process.stderr.readline()
    assert first.startswith("SIMULATED marlin stage on ") and second.startswith("SIMULATED load cell on ")
    port = Port(first.split()[-1])
    port.until(b"Settings Loaded\n")
    assert b"EMERGENCY_PARSER:1\n" in port.ask(b"M115\n", b"ok\n")
    assert b"." in Port(second.split()[-1]).until(b"\n")
    process.send_signal(end)
    assert process.wait(10) == code
    process.stderr.close()
    assert not Path(first.split()[-1]).parent.exists()
