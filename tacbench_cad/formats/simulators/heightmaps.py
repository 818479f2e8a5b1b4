"""Heights on an even grid for programs of one's own: a NumPy array in mm, and a 16-bit grey PNG."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from tacbench_cad.formats.simulators.asset import HeightField, SimulatorAsset, TargetFiles

#: Value of the highest sample in the PNG.
WHITE = 65535


def write_npy(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.npy``: float64 heights in mm, shape (ny, nx).

    Args:
        asset: The block.
        folder: An existing folder.
    """
    heights, file = asset.heights, f"{asset.name}.npy"
    np.save(folder / file, np.ascontiguousarray(heights.z_mm, dtype="<f8"), allow_pickle=False)
    note = f"""\
- `{file}`: float64, shape {heights.z_mm.shape}: row 0 at y = 0, column 0 at x = 0, `z[row, column]`.
- Units: millimetres above the underside. {_pitch(heights)} Samples lie on the borders.
- {_error(heights)} The samples themselves are the formula's values.
- Tested with NumPy: every sample against the formula (texture 4).
"""
    return TargetFiles(files=(file,), note=note)


def write_png16(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.png``: 16 bits a sample, grey, the first row at the highest y as pictures are seen.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    heights, file = asset.heights, f"{asset.name}.png"
    low, high = float(heights.z_mm.min()), float(heights.z_mm.max())
    step = (high - low) / WHITE or 1.0  # a plane is black
    levels = np.rint((heights.z_mm[::-1] - low) / step).astype(">u2")
    px, py = heights.pitch_mm
    words = {
        "Title": asset.block.name,
        "Software": "tacbench-cad",
        "Description": f"height in mm = {low:.9g} + level * {step:.9g}; pixels are {px:.9g} x {py:.9g} mm apart; "
        "first row at the highest y",
    }
    (folder / file).write_bytes(_png(levels, words))
    rows, columns = levels.shape
    note = f"""\
- `{file}`: {columns} x {rows} pixels of 16 bits, grey, linear; first row at the highest y, first column at x = 0.
- Units: height in mm = {low:.9g} + level * {step:.9g}. {_pitch(heights)} Pixel centres lie on the borders. The
  same stands in the file's own text.
- {_error(heights)} Rounding to 16 bits adds {step / 2.0:.1g} mm.
- Many loaders keep 8 bits only (MuJoCo's does, and so does an image library told to read "grey"): that is a staircase
  of {(high - low) / 255.0:.2g} mm. Use the file of the engine where there is one.
- Tested with Pillow: every pixel against the formula (texture 4).
"""
    return TargetFiles(files=(file,), note=note)


def _pitch(heights: HeightField) -> str:
    x, y = heights.pitch_mm
    return f"Neighbouring samples are {x:.9g} mm apart along x and {y:.9g} mm along y."


def _error(heights: HeightField) -> str:
    proof = heights.certificate
    return (
        f"Error of the surface that joins the samples by triangles: {proof.distance_mm:.2g} mm in distance, "
        f"{proof.vertical_mm:.2g} mm in height (proved)."
    )


def _png(levels: np.ndarray[tuple[int, ...], np.dtype[np.uint16]], words: dict[str, str]) -> bytes:
    """A grey PNG of 16-bit samples (big-endian, shape (rows, columns)) with text chunks."""
    rows, columns = levels.shape
    lines = np.zeros((rows, 1 + 2 * columns), dtype=np.uint8)  # each row begins with its filter: none
    lines[:, 1:] = np.ascontiguousarray(levels).view(np.uint8).reshape(rows, 2 * columns)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 16, 0, 0, 0, 0))]
    chunks += [(b"tEXt", key.encode("latin-1") + b"\0" + text.encode("latin-1")) for key, text in words.items()]
    chunks += [(b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")]
    packed = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)
