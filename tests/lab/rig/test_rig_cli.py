"""Test ``tacbench rig``: probe, align and calibrate-force, with scripted answers."""

from __future__ import annotations

import io
import json
import signal
import sys
import time
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE, Popen
from types import SimpleNamespace
from typing import IO, Any

import numpy as np
import pytest

from tacbench_cad.cli import rig
from tacbench_cad.lab.rig import loadcell, ports, probing
from tacbench_cad.lab.rig.aligning import highest_point_mm
from tacbench_cad.lab.rig.calibration import read_calibration
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import NoAnswerError, OutOfRangeError
from tacbench_cad.lab.rig.firmware_settings import grbl_settings
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.rig.loadcell import LoadCell, LoadCellOptions
from tacbench_cad.lab.rig.ports import PortCandidate
from tacbench_cad.lab.rig.stage import Closing, LimitedStage
from tacbench_cad.lab.study.spec import Point, PrintedBlock, RigSettings, StageSettings, WorkFrame
from tacbench_cad.util.errors import CheckFailedError, InputError

Capture = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


def run(*argv: str) -> None:
    rig.command(list(argv), prog_name="tacbench rig", standalone_mode=False)


def typed(monkeypatch: Patch, *lines: str) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(line + "\n" for line in lines)))


# --- calibrate-force ---


class Scale:
    """The lines of a cell on which a person puts a new mass at each prompt."""

    def __init__(self, counts_per_g: float = 4_000.0, masses: Sequence[float] = (0.0, 50.0, 100.0, 200.0)) -> None:
        self.counts_per_g = counts_per_g
        self.masses = list(masses)
        self.random = np.random.default_rng(5)
        self.on = -1
        self.left = 0

    def now_s(self) -> float:
        return time.monotonic()

    def read_line(self, timeout_s: float) -> str | None:
        mass = self.masses[max(self.on, 0)]
        return str(round(84_000.0 + self.counts_per_g * mass + self.random.normal(0.0, 30.0)))

    def forget(self) -> None:
        self.on += 1

    def close(self) -> None:
        self.left += 1


@pytest.fixture
def scale(monkeypatch: Patch) -> Scale:
    script = Scale()

    def opened(port: str, baud: int | None, *, clock: Clock, options: LoadCellOptions) -> LoadCell:
        script.port, script.baud, script.options = port, baud, options  # type: ignore[attr-defined]
        return LoadCell(script, name="cell", options=options, timeout_s=0.1, clock=clock)

    monkeypatch.setattr(loadcell, "open_load_cell", opened)
    monkeypatch.setattr(loadcell, "STILL_S", 0.02)
    return script


def test_known_masses_give_a_calibration(scale: Scale, tmp_path: Path, monkeypatch: Patch, capsys: Capture) -> None:
    typed(monkeypatch, "", "", "", "")
    path = tmp_path / "gauge.json"
    run("calibrate-force", "--port", "P", "--masses", "0,50,100,200", "-o", str(path), "--baud", "57600")
    calibration = read_calibration(path)
    assert calibration.newtons_per_count == pytest.approx(9.80665e-3 / 4_000.0, rel=1e-3)
    assert calibration.device == "P" and [point.mass_g for point in calibration.points] == [0.0, 50.0, 100.0, 200.0]
    assert calibration.date_utc.endswith("Z")
    out, err = capsys.readouterr()
    assert "remove everything" in out and "put 200 g on" in out and "residual" in out and "warning" not in err
    assert (scale.port, scale.baud, scale.left) == ("P", 57600, 1)  # type: ignore[attr-defined]


def test_masses_in_the_wrong_order_are_not_stored(scale: Scale, tmp_path: Path, monkeypatch: Patch) -> None:
    scale.masses = [200.0, 100.0, 50.0, 0.0]
    typed(monkeypatch, *[""] * 4)
    path = tmp_path / "gauge.json"
    argv = ("calibrate-force", "--port", "P", "--masses", "0,50,100,200", "-o", str(path))
    with pytest.raises(InputError, match="counts decrease as the mass increases"):
        run(*argv)
    assert not path.exists()
    scale.masses, scale.counts_per_g, scale.on = [0.0, 50.0, 100.0, 200.0], -4_000.0, -1
    typed(monkeypatch, *[""] * 4)
    run(*argv, "--falling")
    assert read_calibration(path).newtons_per_count < 0.0


def test_an_input_that_ends_early_stores_nothing(scale: Scale, tmp_path: Path, monkeypatch: Patch) -> None:
    typed(monkeypatch, "")
    with pytest.raises(InputError, match="ended before you answered"):
        run("calibrate-force", "--port", "P", "--masses", "0,50,100", "-o", str(tmp_path / "gauge.json"))
    assert list(tmp_path.iterdir()) == [] and scale.left == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--masses", "0,100"), "at least 3 different masses"),
        (("--masses", "0,1,x"), "masses = 'x': must be a number"),
        (("--masses", "0,1,-5"), "from 0 to 10000 g"),
        (("--masses", "0,1,nan"), "from 0 to 10000 g"),
        (("--masses", "0,1,2", "--column", "3/2"), "I from 1 to N"),
        (("--masses", "0,1,2", "--column", "2"), "must be I/N"),
        (("--masses", "0,1,2", "--baud", "fast"), "must be a whole number"),
    ],
)
def test_invalid_options_are_refused_before_weighing(
    scale: Scale, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        run("calibrate-force", "--port", "P", "-o", str(tmp_path / "gauge.json"), *options)
    assert scale.on == -1


def test_a_calibration_is_not_overwritten(scale: Scale, tmp_path: Path) -> None:
    path = tmp_path / "gauge.json"
    path.write_text("old")
    with pytest.raises(InputError, match="exists already"):
        run("calibrate-force", "--port", "P", "--masses", "0,1,2", "-o", str(path))
    with pytest.raises(InputError, match="folder does not exist"):
        run("calibrate-force", "--port", "P", "--masses", "0,1,2", "-o", str(tmp_path / "no" / "gauge.json"))
    assert path.read_text() == "old" and scale.on == -1


# --- probe ---

PORT = PortCandidate(name="/dev/serial/by-id/usb-A", device="/dev/ttyUSB0", description="A board", stable=True)


class Camera:
    def __init__(self, opened: bool = True) -> None:
        self.opened = opened
        self.released = False

    def isOpened(self) -> bool:  # noqa: N802
        return self.opened

    def get(self, prop: int) -> float:
        return {3: 640.0, 4: 480.0}[prop]

    def release(self) -> None:
        self.released = True


@pytest.fixture
def plugged(monkeypatch: Patch) -> list[str]:
    probed: list[str] = []

    def answer(port: str, stage: StageSettings | None = None) -> probing.PortAnswer:
        probed.append(port)
        settings = grbl_settings({1: 25.0, 22: 1.0, 23: 3.0}, counts_from_switch=True, stage=stage)
        return probing.PortAnswer(identity="grbl: 1.1h", settings=settings)

    monkeypatch.setattr(ports, "candidates", lambda: [PORT])
    monkeypatch.setattr(probing, "cameras", lambda folders: ("/dev/v4l/by-id/usb-C-video-index0",))
    monkeypatch.setattr(probing, "identify", answer)
    monkeypatch.setattr(probing.plugged_cameras, "__defaults__", (lambda name: Camera(),))
    return probed


def test_probe_lists_devices_without_contacting_them(plugged: list[str], capsys: Capture) -> None:
    run("probe")
    out = capsys.readouterr().out
    assert "/dev/serial/by-id/usb-A" in out and "A board" in out
    assert "/dev/v4l/by-id/usb-C-video-index0" in out and "640 x 480" in out
    assert plugged == []


def test_probe_contacts_the_named_ports(plugged: list[str], capsys: Capture) -> None:
    run("probe", "--ask", "P1", "--ask", "P2", "--json")
    document = json.loads(capsys.readouterr().out)
    assert document["asked"] == {"P1": "grbl: 1.1h", "P2": "grbl: 1.1h"} and plugged == ["P1", "P2"]
    assert document["ports"][0]["name"] == PORT.name
    assert document["cameras"] == [{"name": "/dev/v4l/by-id/usb-C-video-index0", "size_px": [640, 480]}]


def test_probe_lists_the_settings_of_a_firmware_and_what_to_change(
    plugged: list[str], tmp_path: Path, capsys: Capture, monkeypatch: Patch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    run("probe", "--ask", "P1", "--study", str(path))
    out = capsys.readouterr().out
    assert "$1=255" in out and "the sensor must not press without power" in out
    assert "but this build allows only" in out or "longer than the travel" in out
    assert "settings to change" in out
    run("probe", "--ask", "P1", "--json")
    settings = json.loads(capsys.readouterr().out)["settings"]["P1"]
    assert settings[0] == {
        "name": "$1",
        "value": "25",
        "meaning": "time until the motors lose their power, in ms; 255: never",
        "change": "$1=255",
        "reason": "the sensor must not press without power",
    }


# --- align ---

STUDY = """# kept
[block]
texture = 1
printer = "bambu-p1p"
filament = "pla-minus"

[stage]
driver = "grbl"
port = "P"
origin_mm = [1, 2, -60]  # to be taught
limits_mm = [[0, 200], [0, 200], [-100, 0]]

[gauge]
driver = "serial"
port = "Q"

[sensor]
driver = "opencv"
exposure = 100
"""


class FakeStage(Closing):
    identity, simulated = "fake", "stage"

    def __init__(self) -> None:
        self.here: Point = (70.0, 70.0, -40.0)

    def home(self) -> None: ...

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        self.here = target_mm
        return target_mm

    def position(self) -> Point:
        return self.here

    def stop(self) -> None: ...


class FakeGauge(Closing):
    identity, simulated = "fake", "gauge"
    tared = 0

    def read(self, window_s: float) -> Force:
        return Force(mean_n=0.0123, spread_n=0.0, samples=3)

    def tare(self) -> None:
        self.tared += 1


@pytest.fixture
def stage(monkeypatch: Patch) -> FakeStage:
    from tacbench_cad.lab.rig import devices

    fake, gauge = FakeStage(), FakeGauge()

    @contextmanager
    def opened(settings: RigSettings, printed: PrintedBlock, frame: WorkFrame) -> Iterator[Any]:
        assert settings.sensor.driver == "simulated", "the camera is not opened"
        yield SimpleNamespace(stage=LimitedStage(fake, settings.stage.limits_mm), gauge=gauge)
        assert gauge.tared == 1

    monkeypatch.setattr(devices, "open_rig", opened)
    return fake


def answers(off_mm: float = 0.0) -> list[str]:
    """Return lines that teach a frame at 80.5, 79.25, -61 with a quarter turn; the stage starts at 70, 70, -40."""
    from tacbench_cad.spec.block import Block

    frame = WorkFrame(origin_mm=(80.5, 79.25, -61.0), quarter_turns=1)
    places = [frame.to_stage((x, y, 0.0)) for x, y in ((4.0, 18.0), (9.0, 18.0), (4.0, 23.0), (9.0, 23.0))]
    lines: list[str] = []
    here = (70.0, 70.0)
    for i, (x, y, _) in enumerate(places):
        if i < 2:
            lines.append(f"x {x - here[0] + (off_mm if i == 0 else 0.0):.6f} y {y - here[1]:.6f}")
            here = (x, y) if off_mm == 0.0 or i else (x + off_mm, y)
        lines.append("ok")
    x, y, _ = frame.to_stage((*highest_point_mm(Block.of("1", "paper")), 0.0))
    return [*lines, "ok", "z -2", *[""] * 29, "z -1", "ok"]


@pytest.mark.parametrize("origin", ["[1, 2, -60]", "[]"])
def test_align_stores_the_frame(
    stage: FakeStage, tmp_path: Path, monkeypatch: Patch, capsys: Capture, origin: str
) -> None:
    """The origin may still be empty, as ``acquire --init`` leaves it."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY.replace("[1, 2, -60]", origin))
    typed(monkeypatch, *answers())
    run("align", str(path))
    text = path.read_text()
    assert text.startswith("# kept\n") and "# to be taught" in text
    table = tomllib.loads(text)["stage"]
    assert table["origin_mm"] == pytest.approx([80.5, 79.25, -61.0], abs=1e-3) and table["quarter_turns"] == 1
    out = capsys.readouterr().out
    assert "marker 25" in out and "0.012 N" in out and "largest error of a marker 0.000 mm" in out
    assert "0.012 N] z -2\n" in out, "the lines of a script are shown like those of a person"


@pytest.mark.parametrize(
    ("lines", "error", "message"),
    [
        (answers()[:3], InputError, "ended before you answered"),
        (["quit"], InputError, "stopped"),
        (answers(off_mm=3.0), CheckFailedError, "nothing is stored"),
    ],
)
def test_align_stores_nothing_unless_it_succeeds(
    stage: FakeStage, tmp_path: Path, monkeypatch: Patch, lines: list[str], error: type[Exception], message: str
) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    typed(monkeypatch, *lines)
    with pytest.raises(error, match=message):
        run("align", str(path))
    assert path.read_text() == STUDY
    assert stage.here[2] == 0.0


@pytest.mark.skipif(sys.platform == "win32", reason="the virtual rig's pseudo-terminals do not exist on Windows")
@pytest.mark.parametrize(
    "name", ["SIGHUP", *(pytest.param(name, marks=pytest.mark.long) for name in ("SIGTERM", "SIGINT"))]
)
def test_a_signal_lifts_the_stage(tmp_path: Path, name: str) -> None:
    """GRBL's default build has the switch of z at 0. With this seed, a lift to 0 would close it."""
    from tacbench_cad.extensions.virtual_rig import launch

    path = tmp_path / "study.toml"
    with launch("grbl", speed=100.0, origin="switch", seed=4) as rig:
        text = STUDY.replace('"P"', f'"{rig.port}"').replace("[[0, 200], [0, 200]", "[[-200, 0], [-200, 0]")
        path.write_text(text.replace('driver = "serial"\nport = "Q"', 'driver = "simulated"'))
        command = [sys.executable, "-m", "tacbench_cad", "rig", "align", str(path)]
        with Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True) as align:
            assert align.stdin is not None and align.stdout is not None and align.stderr is not None
            for typed_line, prompt in (("x 20 y 20", "marker 1 "), ("z -2", "-1.000 mm"), ("ok", "-3.000 mm")):
                wait_for(align.stdout, prompt)
                align.stdin.write(typed_line + "\n")
                align.stdin.flush()
            wait_for(align.stdout, "-1.000 mm")
            align.stdin.write("z -2\n")
            align.stdin.flush()
            wait_for(align.stdout, "-3.000 mm")
            align.send_signal(getattr(signal, name))
            assert align.wait(timeout=10.0) == 130
            message = align.stderr.read()
        assert rig.true_position()[2] == pytest.approx(-1.0, abs=0.01)
    assert message == "error: interrupted; the sensor is lifted\n"


def wait_for(stream: IO[str], text: str) -> None:
    shown = ""
    while text not in shown:
        letter = stream.read(1)
        assert letter, shown
        shown += letter


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("[holder]\nrim_mm = -60\n", r"needs -68\.000 to 4\.000 mm .*; nothing is stored"),
        ("[protocol]\nlimits.depth_limit_mm = 50.0\n", r"limits_mm z .*needs -111\.000"),
    ],
)
def test_align_refuses_unreachable_positions(
    stage: FakeStage, tmp_path: Path, monkeypatch: Patch, line: str, message: str
) -> None:
    """The rule is that of ``acquire``: the travel height over a rim higher than the block counts as well."""
    path = tmp_path / "study.toml"
    path.write_text(STUDY + line)
    typed(monkeypatch, *answers())
    with pytest.raises(OutOfRangeError, match=message):
        run("align", str(path))
    assert path.read_text() == STUDY + line


def test_align_refuses_invalid_tolerances_and_studies_without_a_rig(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY[: STUDY.index("[stage]")])
    for value in ("0", "-1", "nan", "six"):
        with pytest.raises(InputError, match="tolerance mm"):
            run("align", str(path), "--tolerance-mm", value)
    with pytest.raises(InputError, match=r"\[stage\]"):
        run("align", str(path))


# --- identify, over real ports ---


@pytest.mark.usefixtures("rig_time")
@pytest.mark.parametrize("kind", ["grbl", "marlin"])
def test_firmware_and_gauge_are_identified(kind: str) -> None:
    from helpers.rig_here import launch

    options = {"settings": {1: 25}} if kind == "grbl" else {}
    with launch(kind, speed=20.0, **options) as virtual:
        answer = probing.identify(virtual.port)
        assert answer.identity.startswith(f"{kind}: ")
        if kind.startswith("grbl"):
            assert [setting.change for setting in answer.settings if setting.change] == ["$1=255"]
        assert "sends samples of 1 number" in probing.identify(virtual.gauge_port).identity


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_a_silent_port_is_not_an_error(monkeypatch: Patch) -> None:
    import os

    def silent(port: str, **options: Any) -> Any:
        raise NoAnswerError(port)

    monkeypatch.setattr(probing, "_START_S", 0.05)
    monkeypatch.setattr("tacbench_cad.lab.rig.grbl.GrblStage", silent)
    monkeypatch.setattr("tacbench_cad.lab.rig.marlin.MarlinStage", silent)
    master, slave = os.openpty()
    assert probing.identify(os.ttyname(slave)).identity == "sends no samples and answers neither as GRBL nor as Marlin"
    os.close(master)
    os.close(slave)
