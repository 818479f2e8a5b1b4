"""Kill runs with SIGKILL at random times, also during writing; resumed runs must contain every press exactly once."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers import killed_child
from helpers.rigs import printed

from tacbench_cad.lab.runs.checking import check_run
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.text import counted

CHILD = Path(killed_child.__file__)
TESTS = CHILD.parents[1]


def session(folder: Path, seed: int, rig: str, kill_after_s: float | None) -> bool:
    """Start or resume the run in a child process; return whether it finished before it was killed."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), str(TESTS.parent)])}
    with subprocess.Popen(
        [sys.executable, str(CHILD), str(folder), str(seed), rig],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        started = process.stdout.readline()
        assert started == "ready\n", process.stderr.read()
        if kill_after_s is not None:
            time.sleep(kill_after_s)
            process.kill()
        finished = "done" in process.stdout.read()
        failure = process.stderr.read()
    assert finished or kill_after_s is not None, failure
    assert finished or process.returncode != 1, failure
    return finished


def check_complete(folder: Path) -> None:
    """Check with two readers that all presses exist exactly once and that every image matches its checksum."""
    run = Run.open(folder)
    count = len(run.info.presses)
    assert sorted(row.number for row in run.rows) == list(range(1, count + 1))
    assert len(run.by_key) == count
    for row in run.rows:
        run.frame(row, verify=True)
        if run.info.series_frames:
            assert len(run.series(row, verify=True).frames) == run.info.series_frames
    findings = check_run(folder).findings
    # The quality of the test double's images is ignored, because they do not look like a TacTip's.
    assert [finding for finding in findings if finding.kind not in ("dark", "blurred")] == []


def kill_and_resume(folder: Path, kills: int, seed: int, rig: str, span_s: float) -> int:
    """Kill a run at random times until it is complete or was killed ``kills`` times, then let it finish.

    Returns:
        The number of kills.
    """
    dice = random.Random(seed)
    killed, rows = 0, 0
    while killed < kills:
        if session(folder, killed, rig, dice.uniform(0.0, span_s)):
            break
        killed += 1
        if (folder / printed().name / "run.json").exists():
            run = Run.open(folder / printed().name)
            assert len(run.rows) >= rows, "a press was lost"
            rows = len(run.rows)
            for row in run.rows if run.info.series_frames else ():
                run.series(row, verify=True)
    else:
        assert session(folder, 999, rig, None)
    check_complete(folder / printed().name)
    return killed


def kill_repeatedly(folder: Path, kills: int, seed: int, span_s: float, rig: str = "fakes") -> int:
    """Kill runs ``kills`` times in total, with as many runs as that takes.

    Returns:
        The number of runs.
    """
    killed = runs = 0
    while killed < kills:
        runs += 1
        killed += kill_and_resume(folder, kills - killed, seed + runs, rig, span_s)
        shutil.rmtree(folder / printed().name)
    return runs


def test_a_run_that_is_killed_is_complete_in_the_end(tmp_path: Path) -> None:
    kill_repeatedly(tmp_path, 1, 1, 0.3)


@pytest.mark.long
def test_a_run_with_slides_that_is_killed_three_times_is_complete_in_the_end(tmp_path: Path) -> None:
    kill_repeatedly(tmp_path, 3, 21, 0.6, "slides")


@pytest.mark.long
def test_a_hundred_kills_of_runs_with_slides(tmp_path: Path) -> None:
    runs = kill_repeatedly(tmp_path, 100, 2000, 0.8, "slides")
    print(f"100 kills in {counted(runs, 'run')}, no press lost")


@pytest.mark.long
def test_two_hundred_kills(tmp_path: Path) -> None:
    runs = kill_repeatedly(tmp_path, 200, 1000, 0.4)
    print(f"200 kills in {counted(runs, 'run')}, no press lost")


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="the virtual rig's pseudo-terminals do not exist on Windows")
@pytest.mark.parametrize("driver", ["virtual-grbl", "virtual-marlin"])
def test_kills_on_the_virtual_rig(driver: str, tmp_path: Path) -> None:
    assert kill_and_resume(tmp_path, 12, 7, driver, 12.0) > 3
