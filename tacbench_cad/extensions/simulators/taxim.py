"""Taxim: the top surface as an ASCII PLY in mm.

Taxim reads the file line by line: the number of vertices from line 4, and the vertices from line 11 on. It assigns each
vertex to the pixel below it. A pixel is 0.0295 mm wide, and a pixel without a vertex stays empty.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.simulators.asset import MAX_SAMPLES, HeightField, SimulatorAsset, TargetFiles, sampled
from tacbench_cad.spec import Block, SampleGrid
from tacbench_cad.util.errors import InputError

#: The width of Taxim's pixels, in mm.
PIXEL_MM = 0.0295


def write_taxim(asset: SimulatorAsset, folder: Path) -> TargetFiles:
    """Write ``NAME.ply``.

    Args:
        asset: The block.
        folder: An existing folder.

    Raises:
        InputError: The block is so large that the file would need too many vertices.
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
- `{file}`: {rows * columns:,} vertices of the top surface in an ASCII PLY with a header of ten lines and without faces.
- Units and axes: millimetres, z up, block frame. Taxim centres x and y itself, and presses down along z.
- The distance between vertices is {px:.4f} mm along x and {py:.4f} mm along y. It is at most {PIXEL_MM} mm, so every
  pixel of Taxim's height map gets a vertex.
- Each vertex lies on the {"published sampled surface" if _is_sampled(asset.block) else "formula"}, to 0.00001 mm.
- Suggested press depths: 0.5 to 1.5 mm. The lowest and the highest point of the relief differ by
  {asset.block.relief_mm:.3g} mm.
- Taxim's height map shows {640 * PIXEL_MM:.4g} x {480 * PIXEL_MM:.4g} mm around the centre of the block. Shift the
  object to see the rest.
- Tested with textures 2 and 4 at scale 1. The test reads the file line by line, as Taxim's loader does. The height map
  has no holes, and its heights agree with the formula. A ball of 0.5 mm radius touches the map in a valley within
  0.05 mm of the height that the formula predicts. Taxim itself was not run, because it is not available as a package.
"""
    return TargetFiles(files=(file,), note=note)


def _is_sampled(block: Block) -> bool:
    return isinstance(block.sampling, SampleGrid)


def _fine(block: Block) -> HeightField:
    """Return heights that are close enough together for Taxim's pixels.

    If the block has a sample grid, they lie on the surface that joins its samples.
    """
    from scipy.interpolate import make_interp_spline

    x, y = block.size_mm
    # Coordinates are rounded to 0.00001 mm. The rounded distances must not be wider than a pixel.
    nx, ny = (math.ceil(side / (PIXEL_MM - 2e-5)) + 1 for side in (x, y))
    if nx * ny > MAX_SAMPLES:
        raise InputError(
            "scale",
            block.scale,
            f"a top of {x:g} x {y:g} mm needs {nx * ny:,} vertices at a distance of {PIXEL_MM} mm, but at most "
            f"{MAX_SAMPLES:,} are allowed; use a smaller scale",
        )
    if not isinstance(block.sampling, SampleGrid):
        return sampled(block, SampleGrid(nx=nx, ny=ny))
    own = sampled(block, block.sampling)
    fine_x, fine_y = np.linspace(0.0, x, nx), np.linspace(0.0, y, ny)
    along_x = make_interp_spline(own.x_mm, own.z_mm, k=1, axis=1)(fine_x)
    heights = make_interp_spline(own.y_mm, along_x, k=1, axis=0)(fine_y)
    return replace(own, x_mm=fine_x, y_mm=fine_y, z_mm=heights)
