"""The sketch for load cells, compiled by avr-gcc with Arduino's own library and run by simavr, with our driver."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.checkout import ROOT
from helpers.outsiders import program

from tacbench_cad.lab.rig.calibration import CalibrationPoint, fit, weight_n
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import NoAnswerError, RigError
from tacbench_cad.lab.rig.loadcell import LoadCell, LoadCellOptions, open_load_cell

pytestmark = pytest.mark.real

SKETCH = ROOT / "examples" / "rigs" / "hx711" / "hx711.ino"
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
#: The files of Arduino's library that the sketch uses.
CORE = ("wiring.c", "wiring_digital.c", "hooks.c", "main.cpp", "HardwareSerial.cpp", "HardwareSerial0.cpp", "Print.cpp")
NANO = ("-mmcu=atmega328p", "-DF_CPU=16000000L", "-DARDUINO=10819", "-DARDUINO_AVR_NANO", "-DARDUINO_ARCH_AVR", "-Os")
#: The counts per gram of the emulated load cell, and its counts without a mass.
COUNTS_PER_GRAM, FREE_COUNTS = -417.3, 84_000


class Board:
    """The board in simavr.

    Args:
        process: The emulator.
        port: The path of the board's serial port.
    """

    def __init__(self, process: subprocess.Popen[str], port: str) -> None:
        self.process, self.port = process, port

    def measure(self, counts: float | str) -> None:
        """Set the counts that the amplifier measures, or unplug it with ``off``."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{counts if isinstance(counts, str) else round(counts)}\n")
        self.process.stdin.flush()

    def cell(self, **settings: float) -> LoadCell:
        return open_load_cell(self.port, None, clock=Clock(), options=LoadCellOptions(), **settings)


@pytest.fixture(scope="module")
def emulator(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the command that runs the compiled sketch."""
    compiler = program("avr-gcc", "gcc-avr avr-libc")
    host = program("gcc", "gcc libc6-dev")
    if not ARDUINO.is_dir():
        pytest.skip("Arduino's library is not installed: apt-get install arduino-core-avr")
    if not Path("/usr/include/simavr").is_dir():
        pytest.skip("simavr is not installed: apt-get install libsimavr-dev libelf-dev")
    folder = tmp_path_factory.mktemp("sketch")
    library = [f"-I{ARDUINO / 'cores' / 'arduino'}", f"-I{ARDUINO / 'variants' / 'eightanaloginputs'}"]
    options = [*NANO, *library, "-ffunction-sections", "-fdata-sections"]
    # Arduino's builder does the same: C++ for a sketch, with Arduino.h included first.
    sketch = ["-std=gnu++11", "-x", "c++", "-include", "Arduino.h", "-Wall", "-Wextra", "-Werror", "-c", SKETCH]
    compiler([*options, *sketch, "-o", folder / "sketch.o"])
    objects = [folder / "sketch.o"]
    for name in CORE:
        objects.append(folder / f"{name}.o")
        standard = "-std=gnu11" if name.endswith(".c") else "-std=gnu++11"
        compiler([*options, standard, "-w", "-c", ARDUINO / "cores" / "arduino" / name, "-o", objects[-1]])
    compiler([*NANO, "-Wl,--gc-sections", "-o", folder / "sketch.elf", *objects])
    board = ROOT / "tests" / "helpers" / "hx711_board.c"
    host(["-O2", "-Wall", "-Wextra", "-Werror", "-o", folder / "board", board, "-lsimavr", "-lelf"])
    return [str(folder / "board"), str(folder / "sketch.elf")]


@pytest.fixture
def board(emulator: list[str]) -> Iterator[Board]:
    """Return a running board whose amplifier measures the free load cell."""
    with subprocess.Popen(emulator, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        # simavr prints what it loads before.
        port = next(line.strip() for line in process.stdout if line.startswith("/"))
        running = Board(process, port)
        running.measure(FREE_COUNTS)
        yield running
        process.stdin.close()
        assert process.wait(timeout=30) == 0


@pytest.mark.parametrize("counts", [0, 84_000, -1_000_000, 8_388_000, -8_388_000])
def test_the_counts_arrive_with_their_sign_and_all_bits(board: Board, counts: int) -> None:
    board.measure(counts)
    with board.cell() as cell:
        mean = cell.mean(0.5)
        assert cell.garbled == 0
    assert mean.samples >= 8
    # The noise has a standard deviation of 5 counts.
    assert mean.mean == pytest.approx(counts, abs=4.0)
    assert 2.0 < mean.spread < 7.0


def test_three_known_masses_calibrate_the_cell(board: Board, tmp_path: Path) -> None:
    points = []
    with board.cell() as cell:
        for mass_g in (0.0, 50.0, 100.0, 200.0):
            board.measure(FREE_COUNTS + COUNTS_PER_GRAM * mass_g)
            cell.mean(0.1)  # samples that were under way
            raw = cell.mean(0.5)
            points.append(
                CalibrationPoint(mass_g=mass_g, counts=raw.mean, spread_counts=raw.spread, samples=raw.samples)
            )
    calibration = fit(tuple(points), date_utc="2026-01-01T00:00:00Z", device="simavr", falling=True)
    for mass_g in (20.0, 150.0):
        assert calibration.newtons(FREE_COUNTS + COUNTS_PER_GRAM * mass_g) == pytest.approx(weight_n(mass_g), abs=5e-4)


@pytest.mark.parametrize("counts", [9_000_000, -9_000_000])
def test_a_saturated_amplifier_is_reported(board: Board, counts: int) -> None:
    with board.cell() as cell:
        board.measure(counts)
        with pytest.raises(RigError, match=r"saturated at -?83886"):
            for _ in range(20):
                cell.mean(0.1)


def test_a_wire_that_came_off_is_reported_as_silence(board: Board) -> None:
    with board.cell(timeout_s=1.0) as cell:
        assert cell.mean(0.2).samples > 0
        board.measure("off")
        with pytest.raises(NoAnswerError):
            for _ in range(20):
                cell.mean(0.2)
