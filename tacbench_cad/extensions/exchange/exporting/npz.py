"""``npz``: a NumPy file with an array of all frames and an array for each column."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.exchange.exporting.array_columns import ArrayColumns
from tacbench_cad.extensions.exchange.exporting.export_formats import ExportFormat
from tacbench_cad.extensions.exchange.exporting.exported_frames import Samples

#: The names of the file and of the array with the frames.
FILE, FRAMES = "frames.npz", "frames"
LOADING = f'import numpy as np\n\ndata = np.load("{FILE}")\ndata["{FRAMES}"], data["label"]'


def write(samples: Samples, folder: Path) -> None:
    """Write the file without compression, because compression hardly shrinks frames with noise."""
    columns = ArrayColumns(samples)
    with zipfile.ZipFile(folder / FILE, "w", allowZip64=True) as archive:
        with archive.open(f"{FRAMES}.npy", "w", force_zip64=True) as stream:
            for index, frame in enumerate(columns.frames()):
                if index == 0:
                    shape = (len(samples), *frame.shape)
                    description = np.lib.format.dtype_to_descr(frame.dtype)
                    header = {"descr": description, "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(stream, header)
                stream.write(np.ascontiguousarray(frame).tobytes())
        for name, array in columns.arrays.items():
            with archive.open(f"{name}.npy", "w") as stream:
                plain = np.array(array.tolist()) if array.dtype.kind == "T" else array  # .npy needs a fixed width
                np.lib.format.write_array(stream, plain, allow_pickle=False)


FORMAT = ExportFormat(write=write, loading=LOADING, modules=("cv2",))
