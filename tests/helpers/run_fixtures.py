"""Fixtures for a small run: 2 x 2 positions, 2 forces, 2 repeats, images of 24 x 32 pixels."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

START = datetime(2026, 1, 31, 12, 0, tzinfo=UTC)
MakeInfo = Callable[..., RunInfo]


@pytest.fixture(scope="session")
def make_info() -> MakeInfo:
    """Return a function that makes the small run's info with the given changes."""

    def make(shape: tuple[int, ...] = (24, 32), sensor: dict[str, Any] | None = None, **changes: Any) -> RunInfo:
        protocol = Protocol().changed(
            forces_n=(0.5, 1.0),
            bands_n=(0.1, 0.1),
            grid=PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0)),
            stationary_frames=2,
        )
        values: dict[str, Any] = {
            "printed": PrintedBlock(block=Block.of(4), printer="bambu-p1p", filament="pla-minus", copy=2),
            "levels": (1, 2),
            "protocol": protocol,
            "grid_spacing": "own",
            "holder": HolderRim(),
            "frame": WorkFrame(origin_mm=(80.0, 80.0, -60.0)),
            "slot": 0,
            "stage": {
                "identity": "virtual GRBL on /dev/pts/3",
                "simulated": "stage model",
                "settings": {"driver": "grbl"},
            },
            "gauge": {"identity": "cell 7", "simulated": "", "calibration": {"scale_n_per_count": 0.001}},
            "sensor": {
                "name": "camera",
                "simulated": "",
                "units": "counts",
                "shape": shape,
                "settings": {"requested": {"exposure": 5}, "actual": {"exposure": 5}},
                **(sensor or {}),
            },
        }
        return RunInfo(**{**values, **changes})

    return make


def picture(seed: int, shape: tuple[int, ...] = (24, 32)) -> np.ndarray:
    """Return a bright and sharp image of noise that depends on the seed."""
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def press_all(writer: RunWriter, count: int | None = None) -> None:
    """Write a reference, stationary frames and presses as the press loop does."""
    shape = writer.info.frame_shape or (24, 32)
    image = len(shape) > 1

    def frame(seed: int) -> np.ndarray:
        return picture(seed, shape) if image else np.random.default_rng(seed).normal(size=shape)

    if writer.reference_time is None:
        writer.reference(frame(0), START)
    for when in ("start", "end"):
        for contact in (True, False):
            for index in writer.stationary_missing(when, contact, writer.info.protocol.checks.stationary_frames):
                writer.stationary(when, contact, index, frame(1000 * (1 + 2 * (when == "end") + contact) + index))
    for press in writer.missing(writer.info.presses)[:count]:
        force = Force(mean_n=0.5 + press.number / 100, spread_n=0.01, samples=4)
        when_utc = START + timedelta(seconds=press.number)
        pose = (press.x_mm, press.y_mm, -1.5)
        writer.press(press, pose, frame(press.number), force, force, press.number != 3, when_utc)


@pytest.fixture(scope="session")
def complete_run(tmp_path_factory: pytest.TempPathFactory, make_info: MakeInfo) -> Path:
    """Return the folder of a complete small run, which tests must not change."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    with RunWriter.open(folder, make_info(), durable=False) as writer:
        press_all(writer)
    return folder


@pytest.fixture
def run_folder(tmp_path: Path, complete_run: Path) -> Path:
    """Return a copy of the complete small run, which a test may change."""
    return shutil.copytree(complete_run, tmp_path / "run")


@pytest.fixture(scope="session")
def filled() -> Callable[..., None]:
    """Return a function that fills an open run."""
    return press_all


@pytest.fixture(scope="session")
def noise() -> Callable[..., np.ndarray]:
    """Return a function that makes images of noise."""
    return picture
