"""Heights on an even grid for other programs: a NumPy array in mm, and a 16-bit grey PNG."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.simulators.asset import HeightField, SimulatorAsset, TargetFiles
from tacbench_cad.util.text import at_most

#: The value of the highest sample in the PNG.
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
- `{file}`: float64 array `z[row, column]` with shape {heights.z_mm.shape}. Row 0 is at y = 0, column 0 is at x = 0.
- Units: millimetres above the underside. {_pitch(heights)} The outermost samples lie on the border of the block.
- {_error(heights)} The samples themselves are exact values of the formula.
- Tested with NumPy: every sample agrees with the formula (texture 4).
"""
    return TargetFiles(files=(file,), note=note)


def write_png16(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.png``: grey, with 16 bits for each sample. As usual in pictures, the first row is at the highest y.

    Args:
        asset: The block.
        folder: An existing folder.
    """
    heights, file = asset.heights, f"{asset.name}.png"
    low, high = float(heights.z_mm.min()), float(heights.z_mm.max())
    step = (high - low) / WHITE or 1.0  # avoids a division by zero: a plane becomes black
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
- `{file}`: {columns} x {rows} pixels, grey, 16 bits, linear. The first row is at the highest y, the first column at
  x = 0.
- Units: height in mm = {low:.9g} + level * {step:.9g}. {_pitch(heights)} The centres of the outermost pixels lie on
  the border of the block. The text in the PNG file states the same.
- {_error(heights)} Rounding to 16 bits adds at most {at_most(step / 2.0, 1)} mm.
- Many loaders keep only 8 bits, for example the loader of MuJoCo, and image libraries that convert to 8-bit grey. The
  heights then have steps of {(high - low) / 255.0:.2g} mm. If there is a file for your engine, use that file.
- Tested with Pillow: every pixel agrees with the formula (texture 4).
"""
    return TargetFiles(files=(file,), note=note)


def _pitch(heights: HeightField) -> str:
    x, y = heights.pitch_mm
    return f"The distance between neighbouring samples is {x:.9g} mm along x and {y:.9g} mm along y."


def _error(heights: HeightField) -> str:
    proof = heights.certificate
    return (
        f"If the samples are joined by triangles, the heights of the surface are at most "
        f"{at_most(proof.vertical_mm, 2)} mm away from the formula ({proof.evidence})."
    )


def _png(levels: np.ndarray[tuple[int, ...], np.dtype[np.uint16]], words: dict[str, str]) -> bytes:
    """Encode 16-bit samples (big-endian, shape (rows, columns)) as a grey PNG with text chunks."""
    rows, columns = levels.shape
    lines = np.zeros((rows, 1 + 2 * columns), dtype=np.uint8)  # each row begins with filter type 0 (none)
    lines[:, 1:] = np.ascontiguousarray(levels).view(np.uint8).reshape(rows, 2 * columns)
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 16, 0, 0, 0, 0))]
    chunks += [(b"tEXt", key.encode("latin-1") + b"\0" + text.encode("latin-1")) for key, text in words.items()]
    chunks += [(b"IDAT", zlib.compress(lines.tobytes(), 6)), (b"IEND", b"")]
    packed = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(packed)
