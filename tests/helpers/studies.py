"""Small studies on disk for the tests of the analysis: valid run folders, written with the project's own writer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs.info import RunInfo
from tacbench_cad.lab.runs.run_writer import RunWriter
from tacbench_cad.lab.runs.series import MovingFrame
from tacbench_cad.lab.study.motion import MotionSettings
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import HolderRim, PrintedBlock, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

Frame = NDArray[Any]
#: Draws the frame of a press; the generator is seeded with the press and the block.
DrawFrame = Callable[[PrintedBlock, Press, np.random.Generator], Frame]

SHAPE = (24, 32)
WHEN = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
#: Four positions instead of 25.
GRID = PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0))
PRINTERS = (("ender-3", "pla-plus"), ("bambu-p1p", "pla-minus"))


def texture_image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """Return an image that depends on the texture and, much less, on print, position, force and noise."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    number = int(printed.object_label)
    phase = 0.1 * printed.copy + 0.3 * len(printed.printer) + 0.05 * press.position
    clean = 120.0 + 40.0 * np.sin((0.2 + 0.15 * number) * x + phase) * np.cos(0.1 * number * y)
    return np.clip(clean + press.force_level + rng.normal(0.0, 2.0, SHAPE), 0, 255).astype(np.uint8)


def noise_image(printed: PrintedBlock, press: Press, rng: np.random.Generator) -> Frame:
    """Return an image of noise that does not depend on the texture."""
    return rng.integers(0, 256, SHAPE, dtype=np.uint8)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The contents of a small study.

    Args:
        textures: The numbers of the textures.
        prints: The pairs of printer and filament.
        copies: The number of copies of each.
        levels: The force levels.
        grid: The positions.
        image: Draws a frame.
        still: The number of stationary frames in contact at the start, and the same number at the end.
        simulated: The sensor's text ``simulated`` in ``run.json``.
        shape: The shape of a frame.
        units: The unit of its numbers.
        resting: Draws a frame without contact; None for a run without such frames.
        moving: Draws the frame of a slide with an index from 0; None for presses without a slide.
        moving_force: Returns the force at this frame, in N; None for a rig without a gauge.
        moving_frames: The number of frames of a slide.
    """

    textures: Sequence[int] = (1, 2)
    prints: Sequence[tuple[str, str]] = PRINTERS
    copies: int = 2
    levels: tuple[int, ...] = (1,)
    grid: PressGrid = GRID
    image: DrawFrame = texture_image
    still: int = 3
    simulated: str = ""
    shape: tuple[int, ...] = SHAPE
    units: str = "counts"
    resting: Callable[[np.random.Generator], Frame] | None = None
    moving: Callable[[PrintedBlock, Press, int, np.random.Generator], Frame] | None = None
    moving_force: Callable[[PrintedBlock, Press, int], float] | None = None
    moving_frames: int = 4


def write_study(folder: Path, plan: Plan | None = None, **changes: Any) -> list[Path]:
    """Write the runs of a study, one folder for each print.

    Args:
        folder: The folder for the run folders.
        plan: The study; if None, it is made of the keyword arguments, which are the fields of a plan.

    Returns:
        The run folders.
    """
    plan = plan or Plan(**changes)
    folders = []
    for printer, filament in plan.prints:
        for copy in range(1, plan.copies + 1):
            for texture in plan.textures:
                printed = PrintedBlock(block=Block.of(texture), printer=printer, filament=filament, copy=copy)
                folders.append(write_run(folder / printed.name, printed, plan))
    return folders


def write_run(folder: Path, printed: PrintedBlock, plan: Plan) -> Path:
    """Write one run folder with every press of the plan."""
    info = RunInfo(
        printed=printed,
        levels=plan.levels,
        protocol=Protocol().changed(
            grid=plan.grid,
            stationary_frames=plan.still,
            motion=MotionSettings(name="slide", frames=plan.moving_frames) if plan.moving else None,
        ),
        grid_spacing="own",
        holder=HolderRim(),
        frame=WorkFrame(origin_mm=(0.0, 0.0, 0.0)),
        slot=0,
        stage={"identity": "test stage", "simulated": ""},
        gauge={"identity": "test gauge", "simulated": "", "calibration": {}},
        sensor={"name": "test sensor", "simulated": plan.simulated, "units": plan.units, "shape": list(plan.shape)},
    )
    with RunWriter.open(folder, info, durable=False) as writer:
        for press in info.presses:
            name = f"{printed.name} {press.number}"
            rng = np.random.default_rng(list(name.encode()))
            pose_mm = (press.x_mm, press.y_mm, -0.5)
            frame = plan.image(printed, press, rng)
            writer.press(press, pose_mm, frame, time_utc=WHEN, moving=slide(printed, press, plan, rng))
        if plan.resting is not None:
            for index in range(3):
                writer.reference(plan.resting(np.random.default_rng([index, *printed.name.encode()])), time_utc=WHEN)
        middle = info.presses[0]
        for when in ("start", "end"):
            for index in range(1, plan.still + 1):
                rng = np.random.default_rng(list(f"{printed.name} {when} {index}".encode()))
                writer.stationary(when, True, index, plan.image(printed, middle, rng))
    return folder


def slide(printed: PrintedBlock, press: Press, plan: Plan, rng: np.random.Generator) -> list[MovingFrame]:
    """Return the frames of the slide after a press: 0.5 mm and 0.1 s apart along y."""
    return [
        MovingFrame(
            frame=plan.moving(printed, press, index, rng),
            time_s=0.1 * index,
            pose_mm=(press.x_mm, press.y_mm + 0.5 * index, -0.5),
            pose_from="time",
            force_n=None if plan.moving_force is None else plan.moving_force(printed, press, index),
        )
        for index in range(plan.moving_frames if plan.moving else 0)
        if plan.moving is not None
    ]
