"""``zarr``: a group (version 3) with a chunked array of all frames and an array for each column."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.extensions.exchange.exporting.array_columns import ArrayColumns
from tacbench_cad.extensions.exchange.exporting.card import summary
from tacbench_cad.extensions.exchange.exporting.export_formats import ExportFormat
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples
from tacbench_cad.lab.rig import OUTSIDE, Frame, has_colours

#: The names of the group and of the array with the frames.
GROUP, FRAMES = "frames.zarr", "frames"
#: The approximate size of a chunk of frames, in bytes.
CHUNK_BYTES = 8_000_000
LOADING = f'import zarr\n\ngroup = zarr.open_group("{GROUP}", mode="r")\ngroup["{FRAMES}"][:10], group["label"][:10]'


def write(samples: Samples, folder: Path) -> None:
    """Write the group."""
    import zarr

    columns = ArrayColumns(samples)
    about = {"description": summary(samples), "simulated": list(samples.simulated), "runs": list(samples.runs)}
    group = zarr.open_group(folder / GROUP, mode="w", zarr_format=3, attributes=about)
    array: Any = None
    waiting: list[Frame] = []
    written = 0
    for frame in columns.frames():
        if array is None:
            size = max(1, min(len(samples), CHUNK_BYTES // max(1, frame.nbytes)))
            shape, chunks = (len(samples), *frame.shape), (size, *frame.shape)
            names = ["sample", *("y", "x", "colour")[: frame.ndim]] if frame.ndim > 1 else ["sample", "channel"]
            array = group.create_array(
                FRAMES,
                shape=shape,
                chunks=chunks,
                dtype=frame.dtype,
                dimension_names=names,
                attributes={"channels": OUTSIDE} if has_colours(frame) else None,
            )
        waiting.append(frame)
        if len(waiting) == array.chunks[0] or written + len(waiting) == len(samples):
            array[written : written + len(waiting)] = np.stack(waiting)
            written += len(waiting)
            waiting.clear()
    descriptions = {column.name: column.description for column in samples.columns}
    for name, values in columns.arrays.items():
        about = {"description": descriptions[name]}
        group.create_array(name, data=values, dimension_names=["sample"], attributes=about)


FORMAT = ExportFormat(write=write, loading=LOADING, modules=("zarr", "cv2"))
