"""Hosts that we did not write drive the virtual firmware: what they take for a real board behaves like one.

printcore (Pronterface's core) speaks Marlin with numbered, checksummed lines and resends. grbl-streamer speaks GRBL by
counting characters, so that several lines are under way at once. ``.ci/run`` installs both.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from tacbench_cad.virtual_rig.faults import Fault
from tacbench_cad.virtual_rig.process import VirtualRig, launch

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal is needed; Windows has none"),
]
PATIENCE_S = 60.0


@pytest.fixture
def quiet() -> Iterator[None]:
    """Those hosts log to the console."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def _print_with_printcore(rig: VirtualRig, lines: list[str], *faults: Fault) -> tuple[list[str], list[str], list[Any]]:
    """Stream lines as a print; what was sent, what came back, and what printcore calls errors."""
    reason = "printcore is not installed: pip install --no-deps printrun==2.2.0"
    printcore = pytest.importorskip("printrun.printcore", reason=reason)
    gcoder = pytest.importorskip("printrun.gcoder", reason=reason)
    sent: list[str] = []
    received: list[str] = []
    errors: list[Any] = []
    online, ended = threading.Event(), threading.Event()
    core = printcore.printcore()
    core.onlinecb, core.endcb, core.errorcb = online.set, ended.set, errors.append
    core.sendcb = lambda command, _: sent.append(command)
    core.recvcb = lambda line: received.append(line.rstrip())
    core.connect(rig.port, 115200)
    try:
        assert online.wait(PATIENCE_S), "printcore never came online"
        for fault in faults:
            rig.inject(fault)
        assert core.startprint(gcoder.LightGCode(lines))
        assert ended.wait(PATIENCE_S), f"the print did not end; last heard {received[-3:]}"
        # printcore says that it ended before its sender runs again, and cannot be closed in between.
        until = time.monotonic() + PATIENCE_S
        while not (core.send_thread and core.send_thread.is_alive()) and time.monotonic() < until:
            time.sleep(0.01)
    finally:
        core.disconnect()
    return sent, received, errors


def test_printcore_prints_on_the_virtual_marlin(quiet: None) -> None:
    lines = [
        "G90",
        "G28",
        *(f"G1 X{10 + i % 7} Y{20 + i % 3} F6000" for i in range(100)),
        "G1 X33 Y44 Z5 F6000",
        "M400",
    ]
    with launch("marlin", speed=50.0) as rig:
        sent, received, errors = _print_with_printcore(rig, lines)
        assert rig.true_position() == pytest.approx((33.0, 44.0, 5.0), abs=0.02)
    assert not errors and not [line for line in received if line.lower().startswith("resend")]
    assert sum("G1 X" in line for line in sent) == 101


def test_printcore_gets_over_garbled_lines(quiet: None) -> None:
    lines = [
        "G90",
        "G28",
        *(f"G1 X{10 + i % 7} Y{20 + i % 3} F6000" for i in range(100)),
        "G1 X33 Y44 Z5 F6000",
        "M400",
    ]
    with launch("marlin", speed=50.0, seed=3) as rig:
        _, received, _ = _print_with_printcore(rig, lines, Fault(kind="garble", chance=0.002, direction="in"))
        assert rig.true_position() == pytest.approx((33.0, 44.0, 5.0), abs=0.02)
    assert [line for line in received if line.lower().startswith("resend")], "no line was garbled: nothing was tried"


@pytest.mark.parametrize("incremental", [False, True])
def test_grbl_streamer_runs_a_job_on_the_virtual_grbl(quiet: None, incremental: bool) -> None:
    reason = "grbl-streamer is not installed: pip install --no-deps grbl-streamer==2.0.2 gcode-machine==1.0.3"
    grbl_streamer = pytest.importorskip("grbl_streamer", reason=reason)
    events: list[str] = []
    booted, told, done = threading.Event(), threading.Event(), threading.Event()

    def seen(event: str, *data: object) -> None:
        events.append(event)
        if event == "on_boot":
            booted.set()
        # The host asks for the settings and the parser's state by itself: a job waits until both have come.
        if event == "on_read" and str(data[0]).startswith("[GC:"):
            told.set()
        if event == "on_job_completed":
            done.set()

    lines = ["G21", "G90", *(f"G1 X{10 + i % 5} Y{20 + i % 3} F6000" for i in range(60)), "G1 X12.5 Y23 F6000"]
    with launch("grbl", speed=50.0, settings={22: 0, 20: 0}) as rig:
        host = grbl_streamer.GrblStreamer(seen)
        host.setup_logging()
        host.poll_interval = 0.1
        host.cnect(rig.port, 115200)
        try:
            assert booted.wait(PATIENCE_S), "no banner after Ctrl-X"
            host.poll_start()
            assert told.wait(PATIENCE_S), "no parser state after the banner"
            host.incremental_streaming = incremental
            host.write("\n".join(lines))
            done.clear()
            host.job_run()
            assert done.wait(PATIENCE_S), f"the job did not end: {events[-5:]}"
        finally:
            host.disconnect()
        assert rig.reported_position()[:2] == pytest.approx((12.5, 23.0), abs=0.02)
    assert "on_error" not in events and "on_alarm" not in events
