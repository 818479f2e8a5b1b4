"""Reading of scans: every kind of file gives the same points in mm, and units are asked for and checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.formats.stl import write_stl
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.scan.reading import SAMPLED_POINTS, read_scan
from tacbench_cad.scan.simulating import ScanTruth, simulate_height_map, simulate_scan
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

BLOCK = Block.of(2)
SIZE = (*BLOCK.size_mm, BLOCK.height_mm)


@pytest.fixture(scope="module")
def points() -> Floats:
    return simulate_scan(BLOCK, ScanTruth(points=2000, seed=3)).points_mm


def ply(points: Floats, path: Path, kind: str = "double") -> Path:
    rows = np.asarray(points, dtype="<f8" if kind == "double" else "<f4")
    axes = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{axes}end_header\n"
    path.write_bytes(header.encode() + rows.tobytes())
    return path


def test_a_ply_file_gives_its_points_without_the_invalid_ones(points: Floats, tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    bad = np.array([[np.nan, 1.0, 1.0], [0.0, 0.0, 0.0], [np.inf, 0.0, 0.0], [0.0, 0.0, 0.0]])
    scan = read_scan(ply(np.concatenate([points[:100], bad, points[100:]]), tmp_path / "a.ply"), unit="mm")
    np.testing.assert_array_equal(scan.cloud.points_mm, points)
    assert (scan.kind, scan.dropped, scan.unit, scan.notes) == ("points", 4, "mm", ())
    assert not scan.cloud.simulated
    text = (tmp_path / "a.ply").read_bytes().replace(b"element", b"comment simulated scan, seed 3\nelement", 1)
    (tmp_path / "a.ply").write_bytes(text)
    assert read_scan(tmp_path / "a.ply", unit="mm").cloud.simulated


@pytest.mark.parametrize(("name", "head", "separator"), [
    ("a.xyz", "", " "),
    ("a.csv", "x,y,z,intensity\n", ","),
    ("a.asc", "# exported\n//X Y Z I\n", " "),
    ("a.txt", "\ufeffx;y;z;i\n", ";"),
])  # fmt: skip
def test_tables_of_points(name: str, head: str, separator: str, points: Floats, tmp_path: Path) -> None:
    path = tmp_path / name
    rows = [separator.join([*(f"{value:.9g}" for value in row), "7"]) for row in points / 25.4]
    path.write_text(head + "\n".join(rows) + "\n", encoding="utf-8")
    scan = read_scan(path, unit="inch", size_mm=SIZE)
    np.testing.assert_allclose(scan.cloud.points_mm, points, atol=1e-6)
    assert scan.kind == "points"


def test_the_mesh_of_a_block_is_sampled_evenly(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    part = block_part(BLOCK)
    write_stl(part, path)
    scan = read_scan(path, unit="mm", size_mm=SIZE)
    x, y, z = scan.cloud.points_mm.T
    assert len(scan.cloud) == SAMPLED_POINTS
    assert scan.kind == "mesh"
    assert "from its triangles" in scan.notes[0]
    inside = (x > 0.01) & (x < SIZE[0] - 0.01) & (y > 0.01) & (y < SIZE[1] - 0.01) & (z > 0.01)
    certificate = part.mesh[1].certificate
    assert certificate is not None
    assert np.abs(z - BLOCK.height_at(x, y))[inside].max() < certificate.vertical_mm
    left, right = np.count_nonzero(inside & (x < SIZE[0] / 2)), np.count_nonzero(inside & (x > SIZE[0] / 2))
    assert left == pytest.approx(right, rel=0.05)


def test_height_maps(tmp_path: Path) -> None:
    cloud = simulate_height_map(BLOCK, ScanTruth(noise_mm=0.0, holes=2), step_mm=0.25)
    assert cloud.grid is not None
    heights = cloud.grid.heights_mm
    np.save(tmp_path / "a.npy", heights[::-1] * 1000.0)
    np.savetxt(tmp_path / "a.csv", heights[::-1], delimiter=",")
    for name, unit in (("a.npy", "um"), ("a.csv", "mm")):
        scan = read_scan(tmp_path / name, unit=unit, mm_per_pixel=0.25, size_mm=SIZE)  # type: ignore[arg-type]
        np.testing.assert_allclose(scan.cloud.points_mm, cloud.points_mm, atol=1e-9)
        assert scan.cloud.grid is not None
        np.testing.assert_allclose(scan.cloud.grid.heights_mm, heights, atol=1e-9)
        assert scan.dropped == np.count_nonzero(np.isnan(heights)) > 50
    with pytest.raises(InputError, match=r"--unit: .*a\.npy names no unit; add --unit .*if the unit is um"):
        read_scan(tmp_path / "a.npy", mm_per_pixel=0.25, size_mm=SIZE)
    with pytest.raises(InputError, match=r"--mm-per-pixel: .*does not contain the distance of its pixels"):
        read_scan(tmp_path / "a.csv", unit="mm")
    with pytest.raises(InputError, match=r"--unit = 'mm': .*3[0-9]{3} mm instead of about 3.5 mm, a factor of 1000"):
        read_scan(tmp_path / "a.npy", unit="mm", mm_per_pixel=0.25, size_mm=SIZE)
    for pixel, factor in ((250.0, "1000"), (6.35, "25.4"), (0.00025, "1000")):
        with pytest.raises(InputError, match=rf"a factor of {factor}"):
            read_scan(tmp_path / "a.csv", unit="mm", mm_per_pixel=pixel, size_mm=SIZE)
    scan = read_scan(tmp_path / "a.csv", unit="mm", mm_per_pixel=0.25 / 25.4, size_mm=SIZE)
    assert "in inches" in scan.notes[0]


def test_units_are_asked_for_and_compared_with_the_block(points: Floats, tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    np.savetxt(path, points)
    with pytest.raises(InputError, match=r"--unit: .*a\.xyz names no unit; add --unit with one of um, mm, m, inch$"):
        read_scan(path)
    with pytest.raises(InputError, match=r"fits the block if the unit is mm"):
        read_scan(path, size_mm=SIZE)
    with pytest.raises(InputError, match=r"a factor of 1000; the unit is probably mm"):
        read_scan(path, unit="m", size_mm=SIZE)
    with pytest.raises(InputError, match=r"a factor of 1000; the unit is probably mm"):
        read_scan(path, unit="um", size_mm=SIZE)
    with pytest.raises(InputError, match=r"a factor of 25.4; the unit is probably mm"):
        read_scan(path, unit="inch", size_mm=SIZE)
    np.savetxt(path, points / 25.4)
    assert "its unit is inch" in read_scan(path, unit="mm", size_mm=SIZE).notes[0]
    with pytest.raises(InputError, match=r"feet"):
        read_scan(path, unit="feet")  # type: ignore[arg-type]


def test_what_is_no_scan_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\n4 5 6\n")
    with pytest.raises(InputError, match=r"has 2 valid points, but a scan needs at least 500"):
        read_scan(tmp_path / "a.xyz", unit="mm")
    (tmp_path / "b.xyz").write_text("words\n" * 300)
    with pytest.raises(InputError, match=r"no line that begins with the numbers x, y and z"):
        read_scan(tmp_path / "b.xyz", unit="mm")
    (tmp_path / "b.xyz").write_text("x y z\n")
    with pytest.raises(InputError, match="no line that begins with the numbers x, y and z"):
        read_scan(tmp_path / "b.xyz", unit="mm")
    (tmp_path / "c.ply").write_bytes(b"ply\nnonsense")
    with pytest.raises(InputError, match=r"c\.ply': cannot be read"):
        read_scan(tmp_path / "c.ply", unit="mm")
    (tmp_path / "d.stl").write_bytes(b"nonsense")
    with pytest.raises(InputError, match=r"d\.stl"):
        read_scan(tmp_path / "d.stl", unit="mm")
    image = pytest.importorskip("PIL.Image")
    image.fromarray(np.zeros((30, 30), dtype=np.uint8)).save(tmp_path / "e.png")
    with pytest.raises(InputError, match=r"8 bits for each pixel, as a photograph"):
        read_scan(tmp_path / "e.png", unit="mm", mm_per_pixel=0.1)
    with pytest.raises(InputError, match=r"does not exist|cannot be read"):
        read_scan(tmp_path / "missing.xyz", unit="mm")


def test_a_table_with_decimal_commas(tmp_path: Path) -> None:
    points = np.random.default_rng(5).uniform(-2.0, 2.0, (600, 3)).round(4)
    lines = [";".join(f"{value:.4f}".replace(".", ",") for value in point) for point in points]
    (tmp_path / "scan.xyz").write_text("x;y;z\n" + "\n".join(lines) + "\n")
    scan = read_scan(tmp_path / "scan.xyz", unit="mm")
    np.testing.assert_allclose(scan.cloud.points_mm, points)


def test_a_matrix_of_heights_with_the_suffix_of_points_is_a_height_map(tmp_path: Path) -> None:
    heights = np.random.default_rng(6).uniform(0.0, 1.0, (30, 40))
    np.savetxt(tmp_path / "map.asc", heights)
    scan = read_scan(tmp_path / "map.asc", unit="mm", mm_per_pixel=0.1)
    assert scan.kind == "height map"
    assert scan.cloud.grid is not None
    np.testing.assert_allclose(scan.cloud.grid.heights_mm[::-1], heights)
