"""Presses as one table: a :class:`pandas.DataFrame` with one row for each press, for pandas and scikit-learn.

==================== ==================================================================================================
column               meaning; a value that is unknown is missing
==================== ==================================================================================================
``run``, ``press``   name of the run folder, and number of the press in it
``frame``            absolute path of the frame's file
``texture``          name of the texture, or the label of imported frames
``printer``          ``filament``, ``copy``, ``session``: the print that was pressed
``preset``           ``scale``: of the printed block
``position``         ``force_level``, ``repeat``: numbers from 1
``target_force_n``   target force in N, or in depth mode ``target_depth_mm``: depth below the first contact in mm
``measured_force_n`` ``force_after_n``: force before and after the frame in N
``in_band``          whether the force was in the band around its target
``touch_height_mm``  in depth mode, the height of the first contact from which the depth was measured in mm
``pose_x``           ``pose_y``, ``pose_z``: position of the sensor's summit in the work frame in mm
``time_utc``         time of the frame
``image_sha256``     checksum of the frame's file
``reference_age_s``  time since the last frame without contact in s
``sensor``           ``units``: name of the sensor, and unit of its numbers
``contact``          ``force`` or ``depth``
``planned``          whether a protocol planned the press; false for other people's frames
``simulated``        simulated parts, with " | " between them; missing for real data
``folder``           absolute path of the run folder; missing for frames that are in no run folder
==================== ==================================================================================================

A table of series has one row for each frame of the moving sensor. It has two more columns, ``step`` (from 1) and
``time_s`` (since the first frame), and ``frame``, ``image_sha256``, ``measured_force_n`` and the pose are those of the
moving frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs import schema
from tacbench_cad.lab.runs.frame_files import read_decoded, type_fault
from tacbench_cad.lab.runs.importing.companions import Paths
from tacbench_cad.lab.runs.importing.grouping import Names, grouped
from tacbench_cad.lab.runs.importing.import_formats import CORE, ImportFormat
from tacbench_cad.lab.runs.importing.sources import ImportOptions
from tacbench_cad.lab.runs.reading import Run, find_runs
from tacbench_cad.lab.runs.series import series_rows
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.util.errors import CheckFailedError, InputError

if TYPE_CHECKING:
    import pandas as pd

#: The columns of the print, of whole numbers, of other numbers of a press, and of other facts of a press.
_PRINT = ("texture", "printer", "filament", "copy", "session", "preset", "scale")
_WHOLE = ("position", "force_level", "repeat")
_NUMBERS = (
    *("target_force_n", "target_depth_mm", "measured_force_n", "force_after_n", "touch_height_mm"),
    *("pose_x", "pose_y", "pose_z", "reference_age_s"),
)
_OTHER = ("in_band", "time_utc", "image_sha256")
#: The columns of the table, in their order.
COLUMNS = (
    *("run", "press", "frame", *_PRINT, *_WHOLE, *_NUMBERS, *_OTHER),
    *("sensor", "units", "contact", "planned", "simulated", "folder"),
)
#: Between the parts in the column ``simulated``.
_SEPARATOR = " | "
#: The two columns of a table of series.
STEP, TIME = "step", "time_s"


def read(paths: str | Path | Iterable[str | Path], *, series: bool = False, frames: int | None = None) -> pd.DataFrame:
    """Read presses as a table.

    Args:
        paths: A folder, or several: run folders, folders that contain run folders, or folders of images with a table
            (CSV), or with a folder of images for each class. Images need not be imported before.
        series: Whether the table has the frames of the moving sensor instead of the frames of the presses.
        frames: The number of frames that are used from the start of each series; None for all.

    Returns:
        The table, sorted by run and press. Its columns are described above. ``attrs["simulated"]`` lists the simulated
        parts of the data.

    Raises:
        InputError: A folder has neither runs nor images, a run cannot be read or has no press, or a run has no series.
        CheckFailedError: A series is missing or incomplete.
    """
    import pandas as pd  # the computer at the rig has no pandas

    given = [Path(path) for path in ([paths] if isinstance(paths, str | Path) else paths)]
    rows: list[dict[str, Any]] = []
    for path in given:
        images = _images_in(path)
        if images is None:
            for folder in find_runs([path]):
                rows += _rows_of(Run.open(folder.absolute()), series, frames)
        elif series:
            raise InputError("path", str(path), "has no series: it is a folder of images, not of runs")
        else:
            rows += _rows_of_images(path.absolute(), images)
    table = pd.DataFrame(rows, columns=[*COLUMNS, *((STEP, TIME) if series else ())])
    table = table.drop_duplicates(["folder", "run", "press", "frame"], ignore_index=True)
    types = dict.fromkeys(_WHOLE, "Int64") | dict.fromkeys((*_NUMBERS, "scale"), "float64") | {"in_band": "boolean"}
    table = table.astype(types | {"planned": "bool", "press": "int64"})
    table.attrs["simulated"] = simulated_parts(table)
    return table


def simulated_parts(presses: pd.DataFrame) -> list[str]:
    """Return the simulated parts of some presses, each part once; an empty list for real data."""
    parts = (part for run in presses["simulated"].dropna().unique() for part in run.split(_SEPARATOR))
    return list(dict.fromkeys(parts))


def _rows_of(run: Run, series: bool, frames: int | None) -> Iterator[dict[str, Any]]:
    """Yield the rows of a run, by press number."""
    if not run.rows:
        raise InputError("run", str(run.folder), "has no press yet; finish it or leave it out")
    info, printed, block = run.info, run.info.printed, run.info.printed.block
    targets = info.protocol and info.protocol.targets
    if series and not info.series_frames:
        what = "has no series of frames: its protocol has no motion, or it was imported; leave out the series"
        raise InputError("run", str(run.folder), what)
    if frames is not None and not 1 <= frames <= info.series_frames:
        raise InputError("frames", frames, f"must be from 1 to {info.series_frames}, the length of a series")
    of_run = {
        "run": printed.name,
        "folder": str(run.folder),
        **{name: getattr(printed, name, None) for name in ("texture", "printer", "filament", "copy", "session")},
        "preset": block and block.preset,
        "scale": block and block.scale,
        "sensor": info.sensor.get("name"),
        "units": info.sensor.get("units", "counts"),
        "contact": targets.contact if targets else "force" if any(r.target_force_n for r in run.rows) else None,
        "planned": isinstance(printed, PrintedBlock) and targets is not None,
        "simulated": _SEPARATOR.join(info.simulated) or None,
    }
    for row in sorted(run.rows, key=lambda row: row.number):
        press = of_run | {name: getattr(row, name) for name in (*_WHOLE, *_NUMBERS, *_OTHER)}
        press |= {"press": row.number, "frame": str(run.folder / row.path)}
        if not series:
            yield press
            continue
        below = run.folder / schema.series_folder(row.number)
        for step, moving in enumerate(series_rows(run.folder, row.number, info.series_frames)[:frames], start=1):
            yield press | {
                **{name: getattr(moving, name) for name in ("pose_x", "pose_y", "pose_z")},
                "frame": str(below / moving.frame),
                "image_sha256": moving.sha256,
                "measured_force_n": moving.force_n,
                STEP: step,
                TIME: moving.time_s,
            }


def _images_in(path: Path) -> ImportFormat | None:
    """Return the format of a folder of images, with a table or in a folder for each class; None for all others."""
    if not path.is_dir() or any(path.rglob(schema.RUN_FILE)):
        return None
    paths, options = Paths(given=(path,)), ImportOptions()
    formats = (CORE[name] for name in ("images", "folders"))
    return next((kind for kind in formats if kind.recognises(path, paths, options)), None)


def _rows_of_images(path: Path, kind: ImportFormat) -> Iterator[dict[str, Any]]:
    """Yield the rows of a folder of images of a format, with what their table or their folders say."""
    groups, left_out = grouped([kind.read(path, Paths(given=(path,)), ImportOptions())], Names())
    if left_out:
        raise InputError("images", str(path), f"cannot be read: {left_out[0].line}")
    for group in groups:
        known = group.specimen
        of_group = {name: getattr(known, name) for name in ("printer", "filament", "copy", "session")}
        of_group |= {"run": known.name, "texture": known.label, "units": "counts", "planned": False}
        for number, sample, values in group.samples:
            row = of_group | {name: values.get(name) for name in (*_WHOLE, *_NUMBERS, *_OTHER)}
            contact = "force" if row["target_force_n"] else None
            yield row | {"press": number, "frame": str(sample.file), "contact": contact}


def runs_of(presses: pd.DataFrame) -> tuple[Run, ...]:
    """Open the run folders of some presses, in the order of the table; none for frames that are in no run folder.

    Raises:
        InputError: A ``run.json`` cannot be read.
    """
    return tuple(Run.open(Path(folder)) for folder in presses["folder"].dropna().unique())


def stationary(presses: pd.DataFrame) -> pd.DataFrame:
    """Return a table of the stationary frames of the runs of some presses, with the columns that features need.

    Its columns are ``run``, ``folder``, ``when`` (``start`` or ``end``), ``in_contact`` and ``frame``.

    Raises:
        InputError: A table of a run cannot be read.
    """
    import pandas as pd

    rows = [
        (run.info.printed.name, str(run.folder), still.when, still.in_contact, str(run.folder / still.path))
        for run in runs_of(presses)
        for still in sorted(run.stationary_frames, key=lambda still: (still.when != "start", still.index))
    ]
    return pd.DataFrame(rows, columns=["run", "folder", "when", "in_contact", "frame"]).astype({"in_contact": bool})


def read_frame(path: str | Path, folder: str | Path | None = None) -> Frame:
    """Read the frame of a press.

    Args:
        path: The path of its file.
        folder: The run folder in which the file must lie, also if it is a link; None if there is none.

    Returns:
        An array of the sensor's shape. An image is uint8; its colours are in the order blue, green, red.

    Raises:
        CheckFailedError: The file is missing or damaged. The message names it.
    """
    frame = read_decoded(Path(path), Path(folder) if isinstance(folder, str | Path) else None)
    if fault := type_fault(frame):
        raise CheckFailedError(f"{path}: {fault}")
    return frame


def iter_frames(presses: pd.DataFrame, size: tuple[int, int] | None = None) -> Iterator[Frame]:
    """Yield the frame of each press, one after the other.

    Args:
        presses: The table.
        size: The width and height to which images are reduced by averaging areas; None for their own size.

    Raises:
        CheckFailedError: A file is missing or damaged.
    """
    for path in presses["frame"]:
        frame = read_frame(path)
        yield resized(frame, size) if size is not None and is_image(frame) else frame


def frames(presses: pd.DataFrame, size: tuple[int, int] | None = None) -> Frame:
    """Return the frames of all presses as one array, (n, height, width) or (n, height, width, 3) for images.

    Args:
        presses: The table.
        size: See :func:`iter_frames`.

    Raises:
        CheckFailedError: A file is missing or damaged, or a frame has another shape than the first.
    """
    every: Sequence[Frame] = list(iter_frames(presses, size))
    for path, frame in zip(presses["frame"], every, strict=True):
        if frame.shape != every[0].shape:
            raise CheckFailedError(f"{path}: has shape {frame.shape}, but the first frame has {every[0].shape}")
    return np.stack(every)


def resized(image: Frame, size: tuple[int, int]) -> Frame:
    """Return an image with another width and height, each pixel the mean of the area that it covers."""
    import cv2

    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
