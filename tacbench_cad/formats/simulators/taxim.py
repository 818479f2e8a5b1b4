"""Taxim: the top surface as an ASCII PLY in mm.

Taxim reads the file by its lines: the count of vertices from the fourth, the vertices from the eleventh on. It drops
each vertex on the pixel below it, 0.0295 mm wide, and leaves pixels empty that get none.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacbench_cad.formats.simulators.asset import MAX_SAMPLES, HeightField, SimulatorAsset, TargetFiles, sampled
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: Width of Taxim's pixels, in mm.
PIXEL_MM = 0.0295


def write_taxim(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.ply``.

    Args:
        asset: The block.
        folder: An existing folder.

    Raises:
        InputError: At this size it would take too many vertices.
    """
    heights, file = _fine(asset.block), f"{asset.name}.ply"
    rows, columns = heights.z_mm.shape
    header = [
        "ply",
        "format ascii 1.0",
        f"comment {asset.block.name}: millimetres, z up, top surface only",
        f"element vertex {rows * columns}",
        "property float x",
        "property float y",
        "property float z",
        "element face 0",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    x = [f"{value:.5f}" for value in heights.x_mm.tolist()]
    with (folder / file).open("w", encoding="ascii", newline="\n") as stream:
        stream.write("\n".join(header) + "\n")
        for y, row in zip(heights.y_mm.tolist(), heights.z_mm.tolist(), strict=True):
            middle = f" {y:.5f} "
            stream.write("".join([f"{at}{middle}{z:.5f}\n" for at, z in zip(x, row, strict=True)]))
    px, py = heights.pitch_mm
    note = f"""\
- `{file}`: {rows * columns:,} vertices of the top surface in an ASCII PLY with a header of ten lines; no faces.
- Units and axes: millimetres, z up, block frame (Taxim centres x and y itself, and presses down along z).
- Vertices are {px:.4f} x {py:.4f} mm apart, at most {PIXEL_MM} mm: every pixel of Taxim's height map gets one.
- Each vertex lies on the {"published sampled surface" if _is_sampled(asset.block) else "formula"}, to 0.00001 mm.
- Suggested press depths: 0.5 to 1.5 mm; the relief is {asset.block.relief_mm:.3g} mm from lowest to highest point.
- Taxim's height map shows {640 * PIXEL_MM:.4g} x {480 * PIXEL_MM:.4g} mm about the block's centre; shift the object to
  see the rest.
- Tested with textures 2 and 4 at scale 1 by reading the file as Taxim's loader does, line by line: a height map without
  holes, its heights against the formula, and a ball of 0.5 mm radius that touches the map in a valley within 0.05 mm of
  where the formula lets it. Taxim itself, which has no package, was not run.
"""
    return TargetFiles(files=(file,), note=note)


def _is_sampled(block: Block) -> bool:
    return isinstance(block.sampling, SampleGrid)


def _fine(block: Block) -> HeightField:
    """Heights close enough together; on a sample grid those of the surface that joins its samples."""
    x, y = block.size_mm
    # Coordinates are written to 0.00001 mm: a distance must not be rounded past the pixel.
    nx, ny = (math.ceil(side / (PIXEL_MM - 2e-5)) + 1 for side in (x, y))
    if nx * ny > MAX_SAMPLES:
        raise InputError(
            "scale",
            block.scale,
            f"a top of {x:g} x {y:g} mm takes {nx * ny:,} vertices at {PIXEL_MM} mm, {MAX_SAMPLES:,} at most",
        )
    if not isinstance(block.sampling, SampleGrid):
        return sampled(block, SampleGrid(nx=nx, ny=ny))
    own = sampled(block, block.sampling)
    fine_x, fine_y = np.linspace(0.0, x, nx), np.linspace(0.0, y, ny)
    along_x = _between(own.z_mm.T, own.x_mm, fine_x)
    return replace(own, x_mm=fine_x, y_mm=fine_y, z_mm=_between(along_x.T, own.y_mm, fine_y))


def _between(rows: Floats, at: Floats, to: Floats) -> Floats:
    """Rows given at some places, interpolated linearly to others; shape (n, k) to (m, k)."""
    i = np.clip(np.searchsorted(at, to, side="right") - 1, 0, len(at) - 2)
    fraction = ((to - at[i]) / (at[i + 1] - at[i]))[:, None]
    return np.asarray((1.0 - fraction) * rows[i] + fraction * rows[i + 1])
