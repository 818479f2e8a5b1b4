"""Test each driver with its virtual firmware in another process, over a real pseudo-terminal and in real time."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

if sys.platform == "win32":
    pytest.skip("Windows has no pseudo-terminals", allow_module_level=True)

from tacbench_cad.extensions.virtual_rig import launch
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.devices import open_stage
from tacbench_cad.lab.study.spec import Point, StageSettings

SPEED = 50.0
UP, DOWN = (0.0, 100.0), (-100.0, 0.0)


@pytest.mark.parametrize(
    ("kind", "driver", "tcp", "z_mm"),
    [
        ("grbl", "grbl", False, DOWN),
        ("grbl", "grbl", True, DOWN),
        ("grblhal", "grbl", False, DOWN),
        ("marlin", "marlin", False, UP),
        ("arduino", "arduino", False, DOWN),
    ],
)
def test_a_stage_homes_and_moves(kind: str, driver: str, tcp: bool, z_mm: tuple[float, float]) -> None:
    center: Point = (50.0, 60.0, sum(z_mm) / 2.0)
    options = {"steps_per_mm": [400.0, 400.0, 400.0]} if kind == "arduino" else {}
    with launch(kind, speed=SPEED, tcp=tcp) as rig:
        limits = ((0.0, 200.0), (0.0, 200.0), z_mm)
        settings = StageSettings(driver=driver, port=rig.port, limits_mm=limits, options=options)
        with open_stage(settings, Clock(speed=SPEED)) as stage:
            assert stage.move(center, 20.0) == pytest.approx(center, abs=0.01)
            assert rig.true_position() == pytest.approx(center, abs=0.05)


#: A program that moves for a while, with a timeout that is shorter than its pause.
MOVING = f"""
import sys
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.grbl import GrblStage

with GrblStage(sys.argv[1], clock=Clock(speed={SPEED}), timeout_s=0.5) as stage:
    stage.home()
    print("homed", flush=True)
    for i in range(100):
        stage.move((50.0, 60.0, -30.0 - i % 2), 20.0)
"""


def test_a_pause_of_this_program_is_not_a_silence_of_the_stage() -> None:
    with launch("grbl", speed=SPEED) as rig:
        with subprocess.Popen([sys.executable, "-c", MOVING, rig.port], stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            assert program.stdout.readline() == "homed\n"
            time.sleep(0.05)
            program.send_signal(signal.SIGSTOP)
            time.sleep(1.2)
            program.send_signal(signal.SIGCONT)
            assert program.wait(timeout=20.0) == 0
        assert rig.true_position() == pytest.approx((50.0, 60.0, -31.0), abs=0.01)
