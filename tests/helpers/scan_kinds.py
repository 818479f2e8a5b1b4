"""A valid file of each kind of scan, and its reader; ``tests/hostile/test_mutations.py`` damages them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from helpers.mutations import Kind, windows


def _points() -> Any:
    from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_scan
    from tacbench_cad.spec.block import Block

    return simulate_scan(Block.of(2), ScanTruth(points=600)).points_mm


def make_ply(folder: Path) -> None:
    axes = "".join(f"property float {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 600\n{axes}end_header\n"
    (folder / "scan.ply").write_bytes(header.encode() + _points().astype("<f4").tobytes())


def make_xyz(folder: Path) -> None:
    np.savetxt(folder / "scan.xyz", _points(), fmt="%.4f", header="x y z")


def make_obj(folder: Path) -> None:
    """Write a mesh of triangles between neighbouring points, which need not be meaningful."""
    corners = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in _points()]
    faces = [f"f {i} {i + 1} {i + 2}" for i in range(1, 599)]
    (folder / "scan.obj").write_text("\n".join([*corners, *faces]) + "\n")


def make_map(folder: Path) -> None:
    np.savetxt(folder / "scan.csv", _points()[:, 2].reshape(20, 30), fmt="%.4f", delimiter=",")


def _reader(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from tacbench_cad.extensions.scan.reading import read_scan

        scan = read_scan(folder / name, unit="mm", mm_per_pixel=0.5, size_mm=(23.3, 30.0, 7.0))
        return scan.kind, scan.dropped, len(scan.cloud), np.round(scan.cloud.points_mm.sum(axis=0), 2).tolist()

    return read


SCAN_KINDS: dict[str, Kind] = {
    "scan ply": Kind("scan.ply", make_ply, _reader("scan.ply")),
    "scan xyz": Kind("scan.xyz", make_xyz, _reader("scan.xyz"), (windows,)),
    "scan obj": Kind("scan.obj", make_obj, _reader("scan.obj"), (windows,)),
    "scan map": Kind("scan.csv", make_map, _reader("scan.csv"), (windows,)),
}
