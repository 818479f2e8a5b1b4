"""The frames of runs without contact, and the region of interest that is found in them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.markers.region import SURE, Region, find_region, parse_region, stored_region
from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.pictures import decoded
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.runs.schema import IMAGE_SUFFIXES
from tacbench_cad.lab.runs.writing import RunWriter
from tacbench_cad.util.door import read_bytes
from tacbench_cad.util.errors import CheckFailedError, InputError

#: The value of ``--roi`` for no region. A region that is stored with the runs is then not used either.
NO_REGION = "none"
#: The number of runs, and of frames of each run, in which a region is searched.
_RUNS, _FRAMES = 6, 3


def resting_frames(run: Run, most: int) -> list[Frame]:
    """Return images without contact at regular intervals of a run.

    If the run has no frames without contact, other frames are returned. The list is empty if the sensor's frames
    are not images.

    Args:
        run: The run.
        most: The largest number of frames.

    Raises:
        InputError: A table of the run cannot be read.
    """
    paths = [reference.path for reference in run.references]
    paths = paths or [row.path for row in sorted(run.rows, key=lambda row: row.number)]
    frames = []
    for at in np.unique(np.linspace(0, len(paths) - 1, most).astype(int)) if paths else ():
        try:
            frames.append(run.read(paths[at]))
        except CheckFailedError:
            continue  # check-runs reports the fault
    return [frame for frame in frames if is_image(frame)]


def add_references(runs: Sequence[Run], path: Path) -> list[Run]:
    """Store frames without contact with the runs that have none, which are mostly imported runs.

    Args:
        runs: The runs.
        path: An image, or a folder of images.

    Returns:
        All runs, with their frames without contact.

    Raises:
        InputError: There is no image, an image cannot be read or has another size, or no run lacks such frames.
    """
    without = [run for run in runs if not run.references]
    if not without:
        raise InputError("reference", str(path), "is not needed: every run has frames without contact")
    files = sorted(file for file in path.iterdir() if file.suffix in IMAGE_SUFFIXES) if path.is_dir() else [path]
    if not files:
        raise InputError("reference", str(path), f"contains no image ({', '.join(IMAGE_SUFFIXES)})")
    frames = []
    for file in files:
        try:
            frames.append(decoded(read_bytes(file, "reference", "image"), str(file)))
        except CheckFailedError as error:
            raise InputError("reference", str(file), str(error)) from None
        for run in without:
            if frames[-1].shape != run.info.frame_shape:
                shapes = f"has shape {frames[-1].shape}, but the frames of {run.folder} have {run.info.frame_shape}"
                raise InputError("reference", str(file), shapes)
    for run in without:
        with RunWriter.open(run.folder, run.info, durable=False) as writer:
            for frame in frames:
                writer.reference(frame, None)
    return [Run.open(run.folder) for run in runs]


def region_of(runs: Sequence[Run], roi: str | None = None) -> Region | None:
    """Return the region of interest of some runs.

    Args:
        runs: Runs of the same sensor.
        roi: A value of ``--roi``; ``none`` for no region; None for the regions that are stored with the runs. If all
            runs have a region, the result is then the intersection of these regions.

    Raises:
        InputError: The value or a stored region is not allowed, or no region can be found.
    """
    if roi == NO_REGION:
        return None
    if roi == "auto":
        region = found_region(runs)
        if region.sureness < SURE:
            sure = f"found {region.text}, but the certainty is only {100 * region.sureness:.0f} %"
            advice = "look at it with tacbench runs roi RUNS -o DIR, and give the region yourself"
            raise InputError("roi", "auto", f"{sure}; {advice}")
        return region
    if roi is not None:
        shape = runs[0].info.frame_shape or ()
        if len(shape) < 2:
            raise InputError("roi", roi, "is only for sensors whose frames are images")
        return parse_region(roi, shape[0], shape[1])
    stored = [stored_region(run.folder) for run in runs]
    regions = [region for region in stored if region is not None]
    if len(regions) < len(stored):
        return None
    texts = list(dict.fromkeys(region.text for region in regions))
    if any(region.mask.shape != regions[0].mask.shape for region in regions):
        raise InputError("roi", ", ".join(texts), "are stored with the runs, but are for frames of different sizes")
    mask = np.all([region.mask for region in regions], axis=0)
    text = texts[0] if len(texts) == 1 else f"the intersection of {len(runs)} runs' regions"
    return Region(text=text, mask=mask, sureness=min(region.sureness for region in regions))


def found_region(runs: Sequence[Run]) -> Region:
    """Find the dome or the gel in the frames of some runs without contact.

    Raises:
        InputError: The runs have no images, or no region can be found in them.
    """
    chosen = [runs[at] for at in np.unique(np.linspace(0, len(runs) - 1, _RUNS).astype(int))]
    frames = [frame for run in chosen for frame in resting_frames(run, _FRAMES)]
    if not frames:
        raise InputError("roi", "auto", f"is only for images, but {runs[0].folder} has no readable image")
    return find_region(frames)
