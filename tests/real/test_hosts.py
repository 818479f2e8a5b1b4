"""Programs of other projects drive the virtual firmware, which must behave like a real board.

printcore (the core of Pronterface) sends numbered Marlin lines with checksums and resends lost lines. grbl-streamer
counts characters to send several GRBL lines before the first answer. ``.ci/run`` installs both.
"""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from helpers.cases import mostly_long

from tacbench_cad.extensions.virtual_rig import VirtualRig, launch
from tacbench_cad.extensions.virtual_rig.faults import Fault

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(sys.platform == "win32", reason="a pseudo-terminal is needed; Windows has none"),
]
#: The time limit for each step of a program, in s.
MAX_SECONDS = 60.0


@pytest.fixture
def quiet() -> Iterator[None]:
    """Disable logging, because these programs log to the console."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def _print_with_printcore(rig: VirtualRig, lines: list[str], *faults: Fault) -> tuple[list[str], list[str], list[Any]]:
    """Print the lines with printcore; return the sent lines, the received lines, and the errors of printcore."""
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
        assert online.wait(MAX_SECONDS), "printcore did not connect"
        for fault in faults:
            rig.inject(fault)
        assert core.startprint(gcoder.LightGCode(lines))
        assert ended.wait(MAX_SECONDS), f"the print did not end; last received: {received[-3:]}"
        # printcore reports the end before its sender runs again, and cannot be closed before that.
        until = time.monotonic() + MAX_SECONDS
        while not (core.send_thread and core.send_thread.is_alive()) and time.monotonic() < until:
            time.sleep(0.01)
    finally:
        core.disconnect()
    return sent, received, errors


@pytest.mark.parametrize("garbled", [False, True])
def test_printcore_prints_on_the_virtual_marlin_and_resends_garbled_lines(quiet: None, garbled: bool) -> None:
    moves = [f"G1 X{10 + i % 7} Y{20 + i % 3} F6000" for i in range(100)]
    faults = [Fault(kind="garble", chance=0.002, direction="in")] if garbled else []
    with launch("marlin", speed=50.0, seed=3) as rig:
        lines = ["G90", "G28", *moves, "G1 X33 Y44 Z5 F6000", "M400"]
        sent, received, errors = _print_with_printcore(rig, lines, *faults)
        assert rig.true_position() == pytest.approx((33.0, 44.0, 5.0), abs=0.02)
    assert any(line.lower().startswith("resend") for line in received) == garbled
    assert garbled or (not errors and sum("G1 X" in line for line in sent) == 101)


@pytest.mark.parametrize("incremental", mostly_long([False, True], False))
def test_grbl_streamer_runs_a_job_on_the_virtual_grbl(quiet: None, incremental: bool) -> None:
    reason = "grbl-streamer is not installed: pip install --no-deps grbl-streamer==2.0.2 gcode-machine==1.0.3"
    grbl_streamer = pytest.importorskip("grbl_streamer", reason=reason)
    events: list[str] = []
    booted, stated, completed = threading.Event(), threading.Event(), threading.Event()

    def on_event(event: str, *data: object) -> None:
        events.append(event)
        if event == "on_boot":
            booted.set()
        # The host requests the settings and the parser state by itself. A job waits for both answers.
        if event == "on_read" and str(data[0]).startswith("[GC:"):
            stated.set()
        if event == "on_job_completed":
            completed.set()

    lines = ["G21", "G90", *(f"G1 X{10 + i % 5} Y{20 + i % 3} F6000" for i in range(60)), "G1 X12.5 Y23 F6000"]
    with launch("grbl", speed=50.0, settings={22: 0, 20: 0}) as rig:
        host = grbl_streamer.GrblStreamer(on_event)
        host.setup_logging()
        host.poll_interval = 0.1
        host.cnect(rig.port, 115200)
        try:
            assert booted.wait(MAX_SECONDS), "no banner after Ctrl-X"
            host.poll_start()
            assert stated.wait(MAX_SECONDS), "no parser state after the banner"
            host.incremental_streaming = incremental
            host.write("\n".join(lines))
            completed.clear()
            host.job_run()
            assert completed.wait(MAX_SECONDS), f"the job did not end: {events[-5:]}"
        finally:
            host.disconnect()
        assert rig.reported_position()[:2] == pytest.approx((12.5, 23.0), abs=0.02)
    assert "on_error" not in events and "on_alarm" not in events
