"""The command ``tacbench acquire``: the first settings file, a virtual run, resuming, errors and exit codes."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tacbench_cad.cli import main
from tacbench_cad.lab.runs.reading import Run

Capture = pytest.CaptureFixture[str]

needs_pty = pytest.mark.skipif(
    sys.platform == "win32", reason="the virtual rig's pseudo-terminals do not exist on Windows"
)
NAME = "texture-2_paper_x1_bambu-p1p_pla-minus_copy01"
VIRTUAL = """
out = "runs"
[block]
texture = 2
printer = "bambu"
filament = "PLA-"
[protocol]
positions.grid = { x_mm = [4.0, 9.0], y_mm = [18.0] }
targets.forces_n = [0.5]
targets.bands_n = [0.02]
repeats = REPEATS
checks.stationary_frames = 1
limits.clearance_mm = 1.0
[stage]
driver = "virtual-grbl"
options = { speed = 100.0 }
[gauge]
driver = "virtual-serial"
[sensor]
driver = "simulated"
"""


def virtual_file(folder: Path, repeats: int = 1, **changes: str) -> Path:
    text = VIRTUAL.replace("REPEATS", str(repeats))
    for old, new in changes.items():
        text = re.sub(rf"(?m)^((?:\w+\.)?{old}) = .*$", rf"\g<1> = {new}", text)
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_init_writes_a_file_and_never_overwrites(tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "study.toml"
    assert main(["acquire", "--init", str(path)]) == 0
    assert "[protocol]" in path.read_text()
    path.write_text("mine")
    assert main(["acquire", "--init", str(path)]) == 2
    assert "already exists" in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.usefixtures("rig_time")
def test_a_virtual_rig_records_a_run_and_resumes_it(tmp_path: Path, capsys: Capture) -> None:
    path = virtual_file(tmp_path)
    assert main(["acquire", str(path)]) == 0
    shown = capsys.readouterr()
    assert shown.out == f"1 run complete in {tmp_path / 'runs'}\nNext: tacbench check-runs {tmp_path / 'runs'}\n"
    assert f"{NAME}  2/2" in shown.err
    folder = tmp_path / "runs" / NAME
    run = Run.open(folder)
    assert len(run.rows) == 2
    assert len(run.info.simulated) == 3
    assert (tmp_path / "runs" / "last.png").read_bytes() == (folder / "sensor_images" / "image_2.png").read_bytes()
    # One row is lost: only its press is repeated.
    targets = folder / "targets.csv"
    targets.write_text("".join(targets.read_text().splitlines(keepends=True)[:-1]))
    assert main(["acquire", str(path)]) == 0
    assert f"{NAME}: 1 of 2 presses done" in capsys.readouterr().err
    assert len(Run.open(folder).rows) == 2
    # The run is complete: no device is opened.
    assert main(["acquire", str(path)]) == 0
    assert "complete: 1 of 1 block\n" in capsys.readouterr().err
    assert main(["acquire", str(virtual_file(tmp_path, forces_n="[0.6]"))]) == 2
    assert "protocol.targets.forces_n was [0.5], is now [0.6]" in capsys.readouterr().err


@needs_pty
def test_ctrl_c_ends_with_130_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    path = virtual_file(tmp_path, repeats=100)
    command = [sys.executable, "-c", "import sys; from tacbench_cad.cli import main; sys.exit(main())"]
    with subprocess.Popen([*command, "acquire", str(path)], stderr=subprocess.PIPE, text=True) as process:
        targets = tmp_path / "runs" / NAME / "targets.csv"
        deadline = time.monotonic() + 30.0
        while time.monotonic() < deadline and not (targets.exists() and len(targets.read_bytes().splitlines()) > 2):
            time.sleep(0.05)
        os.kill(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=30.0)
    assert process.returncode == 130, error
    assert "Traceback" not in error
    saved = len(Run.open(tmp_path / "runs" / NAME).rows)
    assert saved >= 2
    assert error.splitlines()[-2:] == [
        f"error: interrupted; the sensor is lifted; {saved} of 200 presses are saved",
        f"resume with: tacbench acquire {path}",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "name a study file"),
        (["missing.toml"], "cannot be read"),
        (["x.toml", "--virtual"], "x.toml"),
        (["x.toml", "--virtual", "--texture", "3"], "is only for --virtual without a file"),
        (["x.toml", "--texture", "3"], "is only for --virtual"),
        (["x.toml", "--driver", "virtual-grbl"], "is only for --virtual"),
        (["x.toml", "--speed", "3"], "is only for --virtual"),
        (["--virtual", "--init", "x.toml"], "cannot be combined with other options"),
        (["--virtual"], "name the folder"),
        (["--virtual", "--out", "o", "--speed", "fast"], "must be a number"),
        (["--virtual", "--out", "o", "--speed", "0"], "must be from 0.1 to 1000"),
        (["--virtual", "--out", "o", "--speed", "nan"], "must be from 0.1 to 1000"),
        (["--virtual", "--out", "o", "--driver", "grbl"], "virtual-grbl, virtual-marlin"),
        (["--virtual", "--out", "o", "--texture", "7"], "texture"),
        (["--virtual", "--out", "o", "--host", "192.168.1.20"], "are only for --page"),
        (["--virtual", "--out", "o", "--no-browser"], "are only for --page"),
    ],
)
def test_bad_input_ends_with_2(
    arguments: list[str], message: str, tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["acquire", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"forces_n": "[6.0]"}, "must be below 5 N, the hard limit"),
        ({"grid": "{ x_mm = [4.0, 90.0], y_mm = [18.0] }"}, "the block is too small for the press grid"),
        ({"clearance_mm": "150.0"}, "limits_mm z"),
        ({"stationary_frames": "1\nchecks.setle_s = 1.0"}, 'did you mean "settle_s"?'),
        ({"driver": '"none"'}, "driver"),
    ],
)
def test_bad_files_end_with_2(changes: dict[str, str], message: str, tmp_path: Path, capsys: Capture) -> None:
    assert main(["acquire", str(virtual_file(tmp_path, **changes))]) == 2
    assert message in capsys.readouterr().err


def test_a_missing_device_is_named(tmp_path: Path, capsys: Capture) -> None:
    path = virtual_file(tmp_path)
    text = path.read_text().replace('driver = "virtual-grbl"', 'driver = "grbl"\nport = "/dev/no-such-port"')
    text = text.replace(
        "options = { speed = 100.0 }", "origin_mm = [80, 80, -60]\nlimits_mm = [[0, 200], [0, 200], [-100, 0]]"
    )
    path.write_text(text.replace('driver = "virtual-serial"', 'driver = "serial"\nport = "/dev/no-such-gauge"'))
    assert main(["acquire", str(path)]) in (2, 3)
    assert "/dev/no-such-port" in capsys.readouterr().err


@needs_pty
@pytest.mark.long
@pytest.mark.parametrize("driver", ["virtual-grbl", "virtual-marlin"])
def test_virtual_gives_150_presses(driver: str, tmp_path: Path, capsys: Capture) -> None:
    assert main(["acquire", "--virtual", "--texture", "4", "--driver", driver, "--out", str(tmp_path)]) == 0
    (folder,) = (path for path in tmp_path.iterdir() if path.is_dir())
    rows = Run.open(folder).rows
    assert len(rows) == 150
    assert all(row.in_band for row in rows)
    assert main(["check-runs", str(tmp_path)]) == 0
