"""Measure the time for six STL files within 0.01 mm of the formula.

This package starts from the formula. numpy-stl gets triangles that are already computed.

    python benchmarks/stl_speed.py [--repeats 7] [--tolerance 0.01]

Both times end when the file has its name. Imports and checks are not timed. This needs the extra ``dev`` (numpy-stl).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from stl import Mode
from stl.mesh import Mesh as PeerMesh

from tacbench_cad.formats.stl import write_stl
from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.files import replacing
from tacbench_cad.util.types import Floats

SIX = (1, 2, 3, 4, 5, 6)
#: The time that this package may take in addition to the time of numpy-stl, for all six textures, in s.
ALLOWANCE_S = 0.3


def ours(number: int, tolerance_mm: float, folder: Path) -> None:
    """Write one texture: formula, mesh, file, rename. Nothing is cached between runs."""
    part = block_part(Block.of(number, sampling=Tolerance(mm=tolerance_mm)))
    with replacing(folder / f"{part.name}.stl") as temporary:
        write_stl(part, temporary)


def peer(triangles: Floats, path: Path) -> None:
    """Write triangles with numpy-stl as in its manual: build from computed vertices, save as binary."""
    body = PeerMesh(np.zeros(len(triangles), dtype=PeerMesh.dtype))
    body.vectors[:] = triangles
    body.save(str(path), mode=Mode.BINARY)


def fastest_time(action: Callable[[], None], repeats: int) -> float:
    """Return the time of the fastest of several runs, in s."""
    fastest_s = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        fastest_s = min(fastest_s, time.perf_counter() - start)
    return float(fastest_s)


def main() -> None:
    """Print a row for each texture and the sums."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--tolerance", type=float, default=0.01)
    options = parser.parse_args()
    print(f"{'texture':8}{'triangles':>10}{'ours, s':>10}{'numpy-stl, s':>14}")
    totals = np.zeros(2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for number in SIX:
            triangles = mesh_block(Block.of(number, sampling=Tolerance(mm=options.tolerance)))[0].triangle_points
            runs = (partial(ours, number, options.tolerance, folder), partial(peer, triangles, folder / "peer.stl"))
            times = np.array([fastest_time(run, options.repeats) for run in runs])
            totals += times
            print(f"{number:<8}{len(triangles):10}{times[0]:10.4f}{times[1]:14.4f}")
    verdict = "within" if totals[0] <= totals[1] + ALLOWANCE_S else "ABOVE"
    print(f"{'all':8}{'':10}{totals[0]:10.4f}{totals[1]:14.4f}   {verdict} numpy-stl + {ALLOWANCE_S} s")


if __name__ == "__main__":
    main()
