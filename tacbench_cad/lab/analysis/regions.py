"""The region of interest of a table of presses."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tacbench_cad.lab.rig.sensor import is_image
from tacbench_cad.lab.runs.press_table import read_frame, runs_of
from tacbench_cad.lab.runs.region import Region, parse_region
from tacbench_cad.lab.runs.region_search import NO_REGION, find_region, region_of
from tacbench_cad.util.errors import CheckFailedError, InputError

#: The number of frames in which a region is searched if there are no runs.
_FRAMES = 12


def region_in(presses: pd.DataFrame, roi: Region | str | None) -> Region | None:
    """Return the region of interest of some presses.

    Args:
        presses: The table.
        roi: A region, or a value of ``--roi``; None for the regions that are stored with the runs.

    Raises:
        InputError: The value or a stored region is not allowed, or no region can be found.
    """
    if isinstance(roi, Region) or roi == NO_REGION:
        return roi if isinstance(roi, Region) else None
    runs = runs_of(presses.reindex(columns=["folder"]))
    if runs or roi is None:
        return region_of(runs, roi) if runs else None
    frames = []
    for path in presses["frame"].iloc[np.unique(np.linspace(0, len(presses) - 1, _FRAMES).astype(int))]:
        try:
            frames.append(read_frame(path))
        except CheckFailedError:
            continue  # the analysis names the file
    if not frames or not all(map(is_image, frames)):
        raise InputError("roi", roi, "is only for sensors whose frames are images")
    return find_region(frames) if roi == "auto" else parse_region(roi, *frames[0].shape[:2])
