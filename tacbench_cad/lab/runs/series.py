"""Series of frames of the moving sensor in contact: one folder for each press, with its frames and a table."""

from __future__ import annotations

import itertools
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import FrameFile
from tacbench_cad.lab.runs.run_tables import read_table, sync_folder, table_text
from tacbench_cad.lab.runs.schema import MovingRow, PoseFrom, columns
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.files import write_text
from tacbench_cad.util.types import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class MovingFrame:
    """A frame of the moving sensor in contact.

    Args:
        frame: The frame.
        time_s: The time of the frame, in s of the rig's clock.
        pose_mm: The position of the sensor's summit in the work frame at that time.
        pose_from: The origin of the pose.
        force_n: The force at that time; None without a gauge.
    """

    frame: Frame
    time_s: float
    pose_mm: Point
    pose_from: PoseFrom
    force_n: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """The frames of a press during its motion, in their order.

    Args:
        frames: The frames, shape (T, ...) with the shape of a frame after T.
        time_s: The time since the first frame, in s of the rig's clock, shape (T,).
        pose_mm: The position of the sensor's summit in the work frame, shape (T, 3).
        force_n: The force, shape (T,); None if there was no gauge.
        pose_from: The origin of the poses: ``reports`` of the stage during the motion, or ``time``; None if it is
            unknown.
    """

    frames: Frame
    time_s: Floats
    pose_mm: Floats
    force_n: Floats | None
    pose_from: PoseFrom | None

    @classmethod
    def of(cls, rows: Sequence[MovingRow], frames: Sequence[Frame], pose_from: PoseFrom | None) -> Series:
        """Make a series from the rows of its table, its frames, and the origin of its poses."""
        forces = [row.force_n for row in rows]
        return cls(
            frames=np.stack(frames),
            time_s=np.array([row.time_s for row in rows]),
            pose_mm=np.array([row.pose_mm for row in rows]),
            force_n=None if None in forces else np.array(forces, dtype=np.float64),
            pose_from=pose_from,
        )


def series_rows(folder: Path, number: int, count: int) -> tuple[MovingRow, ...]:
    """Read the table of a press's series.

    Args:
        folder: The run folder.
        number: The number of the press.
        count: The expected number of frames.

    Raises:
        CheckFailedError: The table is missing or incomplete, or its times do not increase.
        InputError: The table cannot be read. The message names the line.
    """
    below = schema.series_folder(number)
    path = folder / below / MovingRow.FILE
    if not os.path.lexists(path):
        raise CheckFailedError(f"{path}: is missing; restore the folder, or delete the press's row to repeat the press")
    rows = read_table(folder, MovingRow, below=below).rows
    if len(rows) != count:
        raise CheckFailedError(f"{path}: has {len(rows)} rows, but each series of the run has {count}")
    for before, row in itertools.pairwise(rows):
        if row.time_s <= before.time_s:
            raise CheckFailedError(f"{path}: the time of {row.frame} is not later than that of {before.frame}")
    return rows


def write_series(
    folder: Path,
    number: int,
    moving: Sequence[MovingFrame],
    files: Sequence[FrameFile],
    durable: bool,
) -> None:
    """Write the series of a press: first its frames, then its table. Files of an earlier attempt are removed.

    Args:
        folder: The run folder.
        number: The number of the press.
        moving: The frames in the order of their times.
        files: The files of the frames.
        durable: Force everything to the disk, in this order.

    Raises:
        OSError: The files cannot be written.
    """
    here = folder / schema.series_folder(number)
    if here.exists():
        shutil.rmtree(here)
    here.mkdir(parents=True)
    rows = []
    for index, (each, file) in enumerate(zip(moving, files, strict=True), start=1):
        name = schema.moving_name(index, len(moving), file.suffix)
        file.write(here / name, durable=durable)
        rows.append(
            MovingRow(
                **schema.pose_values(each.pose_mm),
                time_s=round(each.time_s - moving[0].time_s, 4),
                force_n=None if each.force_n is None else round(float(each.force_n), 6),
                frame=name,
                sha256=file.sha256,
            )
        )
    if durable:
        sync_folder(here)
    write_text(here / MovingRow.FILE, table_text(columns(MovingRow), rows), durable=durable)
    if durable:
        sync_folder(here.parent)


def require_complete(number: int, moving: Sequence[MovingFrame], count: int) -> None:
    """Check before writing that a press has the frames of its series.

    Raises:
        InputError: The number of frames is not the run's, or the times do not increase.
    """
    if len(moving) != count:
        raise InputError("series", len(moving), f"press {number} needs {count} moving frames")
    if any(b.time_s <= a.time_s for a, b in itertools.pairwise(moving)):
        raise InputError("series", number, "the times of its frames must increase")
