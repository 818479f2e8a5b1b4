"""Send signals to ``tacbench acquire`` while a user's driver blocks: the sensor is lifted, and the command ends."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from helpers.blocked_sensor import WAYS
from helpers.cases import mostly_long
from helpers.rigs import printed

from tacbench_cad.extensions.virtual_rig import VirtualRig, launch
from tacbench_cad.extensions.virtual_rig.loadcell import BlockUnderDome
from tacbench_cad.lab.acquire.study_file import read_study
from tacbench_cad.lab.runs.reading import Run

pytestmark = pytest.mark.skipif(
    sys.platform == "win32", reason="the virtual rig's pseudo-terminals do not exist on Windows"
)
BLOCKING = [way for way in WAYS if way.startswith("in_")]
STUDY = """
[block]
texture = 1
printer = "bambu-p1p"
filament = "pla-minus"

[protocol]
targets.forces_n = [0.5]
targets.bands_n = [0.05]
positions.grid = {{ x_mm = [4, 9], y_mm = [14, 18, 23] }}
repeats = 1
checks.stationary_frames = 0
checks.home_every = {home_every}
steps.settle_s = 0.005
steps.force_window_s = 0.02
limits.clearance_mm = 2

[stage]
driver = "grbl"
port = "{port}"
origin_mm = [80, 80, -60]
limits_mm = [[0, 200], [0, 200], [-100, 0]]
travel_mm_s = 20

[gauge]
driver = "serial"
port = "{gauge}"

[sensor]
driver = "helpers.blocked_sensor:Sensor"
"""
TRAVEL_MM = 2.0


class Session:
    """A command in a process of its own, on a virtual rig that outlives it.

    Args:
        folder: The working folder.
        rig: The virtual rig.
        output: A descriptor for what the command prints; None for a pipe that :meth:`end` reads.
    """

    def __init__(self, folder: Path, rig: VirtualRig, output: int | None = None) -> None:
        self.folder, self.rig = folder, rig
        tests = Path(__file__).parents[1]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tacbench_cad", "acquire", "study.toml", "--out", "runs"],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tests), str(tests.parent)])},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if output is None else output,
            stderr=subprocess.STDOUT,
            text=True,
        )

    @property
    def height_mm(self) -> float:
        """The true height of the sensor above the block."""
        return self.rig.true_position()[2] + 60.0

    def wait_until(self, condition: Callable[[], bool]) -> None:
        until = time.monotonic() + 60.0
        while not condition():
            assert self.process.poll() is None, self.process.communicate()[0]
            assert time.monotonic() < until
            time.sleep(0.01)

    def end(self) -> str:
        """Wait for the end, and return the output."""
        output = self.process.communicate(timeout=60.0)[0]
        assert isinstance(output, str)
        return output

    @property
    def run(self) -> Run:
        return Run.open(self.folder / "runs" / printed().name)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Session]]:
    """Return a function that starts the command, which blocks in a given way at the fifth press."""
    sessions: list[Session] = []
    with launch("grbl", speed=50.0, gauge={"newtons": True}, resets_on_open=False) as rig:

        def started(way: str = "", home_every: int = 0, output: int | None = None) -> Session:
            path = tmp_path / "study.toml"
            path.write_text(STUDY.format(port=rig.port, gauge=rig.gauge_port, home_every=home_every))
            study = read_study(path)
            settings = study.required_rig
            rig.put(BlockUnderDome(printed=printed(), holder=settings.holder, frame=settings.stage.frame))
            if way:
                (tmp_path / "block").write_text(way)
            sessions.append(Session(tmp_path, rig, output))
            return sessions[-1]

        yield started
        for session in sessions:
            session.process.kill()
            session.process.communicate()


@pytest.mark.parametrize("way", mostly_long(BLOCKING, "in_a_call_of_c_that_no_signal_ends"))
def test_two_signals_end_a_run_whose_sensor_blocks(way: str, start: Callable[..., Session], tmp_path: Path) -> None:
    session = start(way)
    session.wait_until((tmp_path / "blocking").exists)
    assert session.height_mm < 0.1, "the sensor is in contact"
    session.process.send_signal(signal.SIGINT)
    session.wait_until(lambda: session.height_mm > TRAVEL_MM - 0.01)
    assert session.process.poll() is None, "the driver may still return"
    session.process.send_signal(signal.SIGINT)
    output = session.end()
    assert session.process.returncode == 130, output
    assert session.height_mm > TRAVEL_MM - 0.01
    last = output.splitlines()
    assert "error: interrupted; the sensor is lifted; 4 of 6 presses are saved; gave up " in last[-2]
    assert f"blocked_sensor.py, line {blocking_line()}, which did not return" in last[-2]
    assert last[-1] == "resume with: tacbench acquire study.toml --out runs"
    assert [row.number for row in session.run.rows] == [1, 2, 3, 4]
    again = start()
    assert again.end() and again.process.returncode == 0
    assert [row.number for row in again.run.rows] == [1, 2, 3, 4, 5, 6]


def blocking_line() -> int:
    """Return the line of ``read`` that blocks."""
    lines = Path(sys.modules[WAYS["in_sleep"].__module__].__file__ or "").read_text().splitlines()
    return 1 + next(index for index, line in enumerate(lines) if "WAYS[way]()" in line)


@pytest.mark.long  # the quick run sends one signal when it closes the terminal
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_one_signal_ends_a_run_whose_sensor_blocks_after_a_time(
    name: str, start: Callable[..., Session], tmp_path: Path
) -> None:
    session = start("in_a_lock")
    session.wait_until((tmp_path / "blocking").exists)
    session.process.send_signal(getattr(signal, name))
    output = session.end()
    assert session.process.returncode == 130, output
    assert "the sensor is lifted; waiting 10 s for read() in " in output
    assert session.height_mm > TRAVEL_MM - 0.01
    assert [row.number for row in session.run.rows] == [1, 2, 3, 4]


@pytest.mark.parametrize(
    ("kind", "way"),
    mostly_long(
        [("terminal", "in_a_lock"), ("terminal", "in_sleep"), ("pipe", "in_a_lock")],
        ("terminal", "in_a_lock"),
    ),
)
def test_a_lost_terminal_ends_a_run_whose_sensor_blocks(
    kind: str, way: str, start: Callable[..., Session], tmp_path: Path
) -> None:
    reader, writer = os.openpty() if kind == "terminal" else os.pipe()
    session = start(way, output=writer)
    os.close(writer)
    session.wait_until((tmp_path / "blocking").exists)
    # As if the window was closed, or as if Ctrl-C ended the other program of "tacbench acquire ... 2>&1 | tee log".
    os.close(reader)
    session.process.send_signal(signal.SIGHUP if kind == "terminal" else signal.SIGINT)
    assert session.process.wait(60.0) == 130
    assert session.height_mm > TRAVEL_MM - 0.01
    assert [row.number for row in session.run.rows] == [1, 2, 3, 4]
    last = json.loads((tmp_path / "runs" / "progress.jsonl").read_text().splitlines()[-1])
    assert last["outcome"] == "interrupted" and "the sensor is lifted; 4 of 6 presses are saved" in last["message"]


def test_an_exception_of_a_driver_says_what_became_of_the_sensor(start: Callable[..., Session]) -> None:
    session = start("by_raising")
    output = session.end().splitlines()
    assert session.process.returncode == 3
    assert "read() failed: KeyError: 'lens'" in output[-4]
    assert output[-3:] == [
        "the sensor is lifted",
        "4 of 6 presses are saved",
        "resume with: tacbench acquire study.toml --out runs",
    ]
    assert session.height_mm > TRAVEL_MM - 0.01
    again = start()
    assert again.end() and again.process.returncode == 0
    assert [row.number for row in again.run.rows] == [1, 2, 3, 4, 5, 6]
