"""Measure the time and the triangles of a height map of 1024 x 1024 samples as STL within 0.02 mm.

The peer is pydelatin, which makes a mesh of a height map by greedy insertion of samples. Its ``max_error`` is set so
that its largest distance from the spline, measured at many points, is the same as that of our mesh.

    python benchmarks/height_map.py [--samples 1024] [--tolerance 0.02]

The times are those of one run, in wall time and in processor time. Our time contains the spline, the extremes, the mesh
with its proof, the walls and the file. This needs the extra ``bench`` (pydelatin).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from pydelatin import Delatin
from scipy.ndimage import gaussian_filter

from tacbench_cad.formats.stl import write_stl
from tacbench_cad.geometry import relief
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.interpolation import height_map
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.types import Floats

#: The sides and the height of the relief, in mm.
SIDE_MM, HEIGHT_MM = 30.0, 2.0
#: The largest time, in s.
MAX_S = 10.0


def heights(samples: int) -> Floats:
    """A rough relief with features of about 1 mm."""
    rng = np.random.default_rng(0)
    return np.asarray(gaussian_filter(rng.normal(size=(samples, samples)), samples / 170.0))


def peer(block: Block, table: Floats, max_error_mm: float) -> tuple[int, float]:
    """Return the triangles and the measured distance of pydelatin's mesh of the same samples."""
    count = len(table)
    mesh = Delatin(table.T.astype(np.float32), max_error=max_error_mm)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    step = SIDE_MM / (count - 1)
    # the y of pydelatin runs against the rows of its table
    points = np.column_stack([vertices[:, 0] * step, (count - 1 - vertices[:, 1]) * step, vertices[:, 2]])
    top = Mesh(points, np.asarray(mesh.triangles, dtype=np.int32))
    dense = relief.points_on(top, np.ones(len(top.faces), dtype=np.bool_))
    return len(top.faces), relief.distance(dense, block.surface, 0.0).largest_mm


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=int, default=1024)
    parser.add_argument("--tolerance", type=float, default=0.02)
    options = parser.parse_args()
    table = heights(options.samples)
    start, cpu = time.perf_counter(), time.process_time()
    surface = height_map(table, mm_per_pixel=SIDE_MM / (options.samples - 1), height_mm=HEIGHT_MM)
    texture = Texture(name="map", surface=surface)
    part = block_part(Block.of(texture, sampling=Tolerance(mm=options.tolerance)))
    with tempfile.TemporaryDirectory() as folder:
        write_stl(part, Path(folder) / "map.stl")
    seconds, cpu = time.perf_counter() - start, time.process_time() - cpu
    mesh, expected = part.mesh
    assert part.block is not None and expected.certificate is not None
    top = relief.upward(mesh, mesh.doubled_normals)
    distance = relief.distance(relief.points_on(mesh, top), part.block.surface, part.block.datum_mm).largest_mm
    ours = int(top.sum())
    print(f"ours: {ours:,} triangles, measured {distance:.4f} mm, proved {expected.certificate.distance_mm:.4f} mm,")
    print(f"      {seconds:.1f} s, {cpu:.1f} s of the processor (at most {MAX_S:g} s)")
    scaled = (table - table.min()) * (HEIGHT_MM / float(np.ptp(table)))
    aim, count = options.tolerance, 0
    for _ in range(5):
        count, measured = peer(part.block, scaled[::-1].T, aim)
        print(f"pydelatin with max_error {aim:.4f} mm: {count:,} triangles, measured {measured:.4f} mm")
        if abs(measured - distance) < 0.03 * distance:
            break
        aim *= distance / measured
    print(f"ratio of the triangles: {ours / count:.3f} (must be below 1)")


if __name__ == "__main__":
    main()
