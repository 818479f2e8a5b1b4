"""Files of real instruments, from the source archives of other packages, are read as scans with the right numbers."""

from __future__ import annotations

import struct
import subprocess
import sys
import tarfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.checkout import Once

from tacbench_cad.extensions.scan.reading import read_scan

pytestmark = pytest.mark.real

Fetch = Callable[[str, str, str], Path]


@pytest.fixture
def fetched(once: Once) -> Fetch:
    """Return a function that fetches a file from the source archive of a package, once per session."""

    def fetch(package: str, version: str, name: str) -> Path:
        return once(f"{package}-{version}", partial(_unpack, package, version)) / Path(name).name

    return fetch


def _unpack(package: str, version: str, folder: Path) -> None:
    command = [sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--no-binary", package, "-d", str(folder)]
    result = subprocess.run(
        [*command, f"{package}=={version}"], capture_output=True, text=True, timeout=120, check=False
    )
    if result.returncode:
        pytest.skip(f"pip cannot download the source archive of {package} {version}: {result.stderr.splitlines()[-1]}")
    (archive,) = folder.iterdir()
    with tarfile.open(archive) as files:
        for member in files:
            name = Path(member.name).name
            if member.isfile() and name.endswith((".gwy", ".las", ".laz")):
                source = files.extractfile(member)
                assert source is not None
                (folder / name).write_bytes(source.read())
    archive.unlink()


def test_a_height_map_of_a_force_microscope(fetched: Fetch) -> None:
    """The file of Gwyddion has eight channels; only the last is the height, from 142.5 to 167.8 nm."""
    pytest.importorskip("surfalize")
    path = fetched("AFMReader", "0.0.7", "sample_0.gwy")
    content = path.read_bytes()
    field = content.index(b"/7/data\0o")
    (count,) = struct.unpack_from("<I", content, (at := content.index(b"data\0D", field + 9) + 6))
    heights_m = np.frombuffer(content, "<f8", count, at + 4)
    (width_m,) = struct.unpack_from("<d", content, content.index(b"xreal\0d", field) + 7)
    scan = read_scan(path)
    assert (scan.kind, scan.unit, scan.dropped, scan.notes) == ("height map", "mm", 0, ())
    assert scan.cloud.grid is not None
    assert scan.cloud.grid.heights_mm.shape == (512, 512)
    assert scan.cloud.grid.step_mm == pytest.approx((1000.0 * width_m / 512,) * 2)
    assert scan.cloud.grid.step_mm[0] == pytest.approx(8.4686e-7, rel=1e-4)
    np.testing.assert_allclose(scan.cloud.grid.heights_mm[::-1].ravel(), 1000.0 * heights_m, rtol=1e-9)
    assert np.ptp(scan.cloud.points_mm[:, 2]) == pytest.approx(2.5275e-5, rel=1e-4)


@pytest.mark.parametrize("name", ["simple.las", "vegetation_1_3.las", "simple.laz", "plane.laz"])
def test_points_of_a_laser_scanner(name: str, fetched: Fetch) -> None:
    """The header has the number of points and their extent; a point of a LAS file begins with three whole numbers."""
    pytest.importorskip("laspy")
    path = fetched("laspy", "2.7.0", name)
    content = path.read_bytes()
    start, length, count = *struct.unpack_from("<I", content, 96), *struct.unpack_from("<HI", content, 105)
    step, offset, *extent = np.frombuffer(content, "<f8", 12, 131).reshape(4, 3)
    points = read_scan(path, unit="m").cloud.points_mm / 1000.0
    assert len(points) == count
    highest, lowest = np.reshape(extent, (3, 2)).T
    np.testing.assert_allclose((points.max(axis=0), points.min(axis=0)), (highest, lowest), rtol=0.0, atol=0.006)
    if path.suffix == ".las":
        levels = np.ndarray((count, 3), "<i4", content, start, (length, 4))
        np.testing.assert_allclose(points, levels * step + offset, rtol=1e-12)
