"""Reading of scans: every kind of file gives the same points in mm, and units are asked for and checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers.scans import height_map

from tacbench_cad.extensions.scan import reading
from tacbench_cad.extensions.scan.reading import SAMPLED_POINTS, read_scan
from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_scan
from tacbench_cad.formats.stl import write_stl
from tacbench_cad.geometry.block_part import block_part
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


@pytest.mark.parametrize(("name", "head", "separator", "row"), [
    ("a.xyz", "", " ", "{x} {y} {z} 7"),
    ("a.pts", "2000", " ", "{x} {y} {z} -1204 12 40 255"),
    ("a.csv", "x,y,z,intensity", ",", "{x},{y},{z},7"),
    ("a.csv", '"id","X [mm]","Y [mm]","Z [mm]"', ",", "7,{x},{y},{z}"),
    ("a.csv", "X-Normal;Y-Normal;Z-Normal;X (mm);Y (mm);Z (mm)", ";", "0;0;1;{x};{y};{z}"),
    ("a.asc", "# exported\n//X Y Z I", " ", "{x} {y} {z} 7"),
    ("a.txt", "//R G B X Y Z Nx Ny Nz Scalar_1 Scalar_2 Scalar_3", " ", "1 2 3 {x} {y} {z} 0 0 1 4 5 6"),
    ("a.txt", "\ufeffx;y;z;i", ";", "{x};{y};{z};7"),
    ("a.txt", "a scan; by hand, on a table", ",", "{x},{y},{z}"),
    ("a.txt", "x y z name\r\n\r\n", "\t", " {x}\t{y}\t{z}\tpoint\r\n"),
    ("a.xyz", "", "decimal comma ;", "{x};{y};{z};"),
    ("a.asc", "", "decimal comma", "  {x}   {y} {z}"),
    ("a.csv", "", "missing", "{x},{y},{z}\n,,\n-,-,***"),
])  # fmt: skip
def test_tables_of_points(name: str, head: str, separator: str, row: str, points: Floats, tmp_path: Path) -> None:
    rows = [row.format(x=f"{x:.9g}", y=f"{y:.9g}", z=f"{z:.9g}") for x, y, z in points / 25.4]
    text = "\n".join(rows) + "\n# end\n"
    text = text.replace(".", ",") if "decimal comma" in separator else text
    (tmp_path / name).write_text(f"{head}\n{text}", encoding="utf-8", newline="")
    scan = read_scan(tmp_path / name, unit="inch", size_mm=SIZE)
    np.testing.assert_allclose(scan.cloud.points_mm, points, atol=1e-6)
    assert (scan.kind, scan.dropped) == ("points", 2 * len(points) if separator == "missing" else 0)


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
    cloud = height_map(BLOCK, noise_mm=0.0, holes=2, step_mm=0.25)
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
    with pytest.raises(InputError, match=r"--unit = 'mm': .*3,[0-9]{3} mm instead of about 3.5 mm, a factor of 1000"):
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


@pytest.mark.parametrize(("name", "head", "separator", "missing"), [
    ("map.asc", "", " ", "nan"),
    ("map.asc", "ncols 40\nnrows 30\nxllcorner 0\ncellsize 0.1\nNODATA_value -9999\n", " ", "-9999"),
    ("map.asc", "# File Format = ASCII\n# x-length = 4; y-length = 3\n", "\t", "-32768"),
    ("map.csv", "Height;0,1 mm\n\n", "; decimal comma", ""),
    ("map.csv", "", ",", "***"),
    ("map.txt", "Heights in mm\n", "\t decimal comma", "Bad"),
    ("map.txt", "\ufeff", " decimal comma", "1e10"),
])  # fmt: skip
def test_tables_of_heights(name: str, head: str, separator: str, missing: str, tmp_path: Path) -> None:
    heights = np.random.default_rng(6).uniform(0.5, 1.0, (30, 40)).round(5)
    heights[3:5, 7:9] = np.nan
    rows = [separator[0].join(missing if np.isnan(z) else f"{z:.5f}" for z in row) for row in heights]
    text = "\n".join(rows) + "\n"
    (tmp_path / name).write_text(head + (text.replace(".", ",") if "comma" in separator else text), encoding="utf-8")
    scan = read_scan(tmp_path / name, unit="mm", mm_per_pixel=0.1)
    assert (scan.kind, scan.dropped) == ("height map", 4)
    assert scan.cloud.grid is not None
    np.testing.assert_allclose(scan.cloud.grid.heights_mm[::-1], heights)
    assert len(scan.notes) == (missing in ("-9999", "-32768", "1e10"))


@pytest.mark.parametrize("fill", [-9999.0, 1e10, np.float32(-3.4028235e38), 65535.0])
def test_a_repeated_height_far_from_all_others_is_not_measured(fill: float, tmp_path: Path) -> None:
    heights = np.random.default_rng(6).uniform(0.5, 1.0, (30, 40))
    np.save(tmp_path / "a.npy", np.where(heights > 0.9, fill, heights))
    scan = read_scan(tmp_path / "a.npy", unit="mm", mm_per_pixel=0.1)
    assert (scan.dropped, scan.cloud.points_mm[:, 2].max() <= 0.9) == (np.count_nonzero(heights > 0.9), True)
    assert scan.notes == (f"Pixels with the value {fill:g} are not measured: it is far from all other heights.",)
    heights[0, 0] = fill  # a single one can be an outlier
    np.save(tmp_path / "a.npy", heights)
    assert read_scan(tmp_path / "a.npy", unit="mm", mm_per_pixel=0.1).dropped == 0


def obj(points: Floats, corner: str, sign: int = 1, width: int = 3) -> str:
    """Return an OBJ file with a strip of polygons between neighbouring points, in two groups with other materials."""
    half, count = len(points) // 2, len(points)
    lines = ["mtllib missing.mtl", *(f"v {x:.9g}  {y:.9g}\t{z:.9g} 0.1 0.2 0.3 # grey" for x, y, z in points)]
    for place in range(count - width):
        lines += [f"g part{place}", f"usemtl m{place}"] if place in (0, half) else []
        numbers = [place + k + 1 if sign > 0 else place + k - count for k in range(width)]
        lines.append("f " + " ".join(corner.format(number) for number in numbers))
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(("corner", "sign", "width"), [("{0}", 1, 3), ("{0}/{0}/{0}", 1, 3), ("{0}//{0}", -1, 5)])
def test_obj_files_give_each_vertex_once(
    corner: str, sign: int, width: int, points: Floats, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "MIN_VERTICES", 1000)
    text = obj(points, corner, sign, width)
    for ending, prefix in (("\n", ""), ("\r\n", "\ufeff# made by hand\r\n")):
        (tmp_path / "a.obj").write_text(
            prefix + text.replace(" 0.2 ", " \\\n").replace("\n", ending), encoding="utf-8", newline=""
        )
        scan = read_scan(tmp_path / "a.obj", unit="mm", size_mm=SIZE)
        assert (scan.kind, scan.dropped, scan.notes) == ("mesh", 0, ())
        np.testing.assert_allclose(scan.cloud.points_mm, points, atol=1e-7)
    monkeypatch.setattr(reading, "MIN_VERTICES", 10**6)
    assert len(read_scan(tmp_path / "a.obj", unit="mm", size_mm=SIZE).cloud) == SAMPLED_POINTS


@pytest.mark.parametrize(("name", "content", "needle"), [
    ("a.obj", "v 1 2 3\nv 1,5 2 3\n", r"the line \"v 1,5 2 3\": could not .*; export it again, for example as a bin"),
    ("a.obj", "v 1 2 3\nf 1 2 3\n", "a triangle has a vertex that does not exist"),
    ("a.obj", "v 1 2 3\nf 1 1 99999999999999999999\n", "999\": int too big"),
    ("a.stl", "solid a\n", '"endsolid", is missing'),
    ("a.txt", "1,2,3\n1,2\n1,2,3\n", "is not a table with the same columns in every line"),
    ("a.csv", "hello world\n", "has no line of numbers"),
    ("a.csv", "1,2\n3,4\n", "has 2 columns, too few for a height map; write points as an XYZ file"),
    ("a.glb", "glTF", r"export one of \.stl, \.3mf, \.ply"),
    ("a.tif", "II", "is not a PNG or TIFF picture of a known kind; export 16 bits or 32-bit"),
])  # fmt: skip
def test_a_refusal_says_what_to_do(name: str, content: str, needle: str, tmp_path: Path) -> None:
    if name.endswith((".glb", ".tif")):
        pytest.importorskip("surfalize")
    (tmp_path / name).write_text(content)
    with pytest.raises(InputError, match=needle) as caught:
        read_scan(tmp_path / name, unit="mm", mm_per_pixel=0.1)
    assert str(tmp_path / name) in str(caught.value) and "\n" not in str(caught.value)


def test_incomplete_files_are_refused(points: Floats, tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    lines = [" ".join(map(str, row)) for row in points.tolist()]
    head = [
        "ply",
        "format ascii 1.0",
        "element vertex 2000",
        *(f"property float {axis}" for axis in "xyz"),
        "end_header",
    ]
    (tmp_path / "a.ply").write_text("\n".join([*head, *lines[:900]]) + "\n")
    with pytest.raises(InputError, match=r"the header states 2,000 vertices, but 900 could be read; export it again"):
        read_scan(tmp_path / "a.ply", unit="mm")
    laspy = pytest.importorskip("laspy")
    las = laspy.LasData(laspy.LasHeader(point_format=0, version="1.2"))
    las.x, las.y, las.z = points.T
    las.write(tmp_path / "a.las")
    content = (tmp_path / "a.las").read_bytes()
    (tmp_path / "a.las").write_bytes(content[: 227 + 20 * 900])
    with pytest.raises(InputError, match=r"the header states 2,000 points, but 900 could be read; export it again"):
        read_scan(tmp_path / "a.las", unit="mm")
    (tmp_path / "a.las").write_bytes(content[:107] + b"\xff\xff\xff\x7f" + content[111:])
    with pytest.raises(InputError, match=r"has 2,147,483,647 points, more than the 20,000,000 allowed"):
        read_scan(tmp_path / "a.las", unit="mm")
