"""A process that presses a block on test doubles, or on the virtual rig, until it is killed.

python killed_child.py FOLDER SEED fakes|slides|virtual-grbl|virtual-marlin
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from helpers.emulated import emulated_study
from helpers.fakes import FakeSensor
from helpers.rigs import FakeRig, info_of, printed, small_protocol
from tacbench_cad.lab.acquire.block_presses import press_block
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.acquire.signals import Signals
from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.study.motion import MotionSettings
from tacbench_cad.lab.study.spec import Protocol


def on_doubles(folder: Path, seed: int) -> None:
    """Make the paper's 150 presses on a rig that is so fast that encoding and writing take most of the time."""
    doubles = FakeRig()
    doubles.sensor = FakeSensor(doubles.stage, doubles.plate, size=(120, 160), seed=seed)
    rig = doubles.rig()
    rig.clock = Clock(speed=1e6)
    info = info_of(rig, Protocol().changed(reference_every_s=1e7))
    print("ready", flush=True)
    with Signals() as signals:
        press_block(rig, info, folder / printed().name, signals=signals, progress=PressProgress())


def sliding(folder: Path, seed: int) -> None:
    """Make eight presses with a slide on test doubles."""
    doubles = FakeRig(slides=True)
    doubles.sensor = FakeSensor(doubles.stage, doubles.plate, size=(120, 160), seed=seed)
    rig = doubles.rig()
    slide = MotionSettings(name="slide", frames=5, options={"length_mm": 4.0})
    values: dict[str, Any] = {"forces_n": (1.0,), "bands_n": (0.01,), "depths_mm": (1.0,), "stationary_frames": 1}
    info = info_of(rig, small_protocol(motion=slide, **values))
    print("ready", flush=True)
    with Signals() as signals:
        press_block(rig, info, folder / printed().name, signals=signals, progress=PressProgress())


def on_virtual_rig(folder: Path, driver: str) -> None:
    """Press a block through a driver and a pseudo-terminal."""
    chosen = emulated_study(driver, speed=100.0, out=folder)
    print("ready", flush=True)
    person = Typing(lambda prompt: "", lambda message: None)
    acquire_study(chosen.study, chosen.required_rig, folder, person=person, progress=PressProgress())


if __name__ == "__main__":
    if sys.argv[3] == "fakes":
        on_doubles(Path(sys.argv[1]), int(sys.argv[2]))
    elif sys.argv[3] == "slides":
        sliding(Path(sys.argv[1]), int(sys.argv[2]))
    else:
        on_virtual_rig(Path(sys.argv[1]), sys.argv[3])
    print("done", flush=True)
