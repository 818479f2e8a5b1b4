"""The frames without contact of runs, and the region of interest that they show."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacbench_cad.lab.rig.sensor import Frame, is_image
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.lab.vision.region import SURE, Region, find_region, parse_region, stored_region
from tacbench_cad.util.errors import CheckFailedError, InputError

#: ``--roi`` without a region: what is kept with the runs is not used either.
NO_REGION = "none"
#: Runs, and frames of each, that a region is found in.
_RUNS, _FRAMES = 6, 3


def resting_frames(run: Run, most: int) -> list[Frame]:
    """Frames of a run without contact, spread over it; presses where there are none, and nothing for other sensors.

    Args:
        run: The run.
        most: The most frames.

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
            continue  # the check of the run names it
    return [frame for frame in frames if is_image(frame)]


def region_of(runs: Sequence[Run], roi: str | None = None) -> Region | None:
    """The region of interest of some runs.

    Args:
        runs: The runs, of one sensor.
        roi: As ``--roi`` takes it; ``none`` for no region; None for what is kept with the runs: the pixels that lie in
            the regions of all of them, if all have one.

    Raises:
        InputError: The text or the kept region is not allowed, or there is nothing to be found.
    """
    if roi == NO_REGION:
        return None
    if roi == "auto":
        region = found_region(runs)
        if region.sureness < SURE:
            sure = f"found {region.text}, but is only {100 * region.sureness:.0f} % sure of it"
            raise InputError("roi", "auto", f"{sure}; look at it (tacbench runs roi RUNS -o DIR), and give it by hand")
        return region
    if roi is not None:
        shape = runs[0].info.frame_shape or ()
        if len(shape) < 2:
            raise InputError("roi", roi, "is for sensors that give images")
        return parse_region(roi, shape[0], shape[1])
    kept = [stored_region(run.folder) for run in runs]
    regions = [region for region in kept if region is not None]
    if len(regions) < len(kept):
        return None
    texts = list(dict.fromkeys(region.text for region in regions))
    if any(region.mask.shape != regions[0].mask.shape for region in regions):
        raise InputError("roi", ", ".join(texts), "kept with the runs, are for frames of different sizes")
    mask = np.all([region.mask for region in regions], axis=0)
    text = texts[0] if len(texts) == 1 else f"what {len(runs)} runs' regions have in common"
    return Region(text=text, mask=mask, sureness=min(region.sureness for region in regions))


def found_region(runs: Sequence[Run]) -> Region:
    """The dome or gel that the frames without contact of some runs show.

    Raises:
        InputError: They have no images, or nothing can be found in them.
    """
    chosen = [runs[at] for at in np.unique(np.linspace(0, len(runs) - 1, _RUNS).astype(int))]
    return find_region([frame for run in chosen for frame in resting_frames(run, _FRAMES)])
