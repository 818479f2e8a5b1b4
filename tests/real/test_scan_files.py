"""Files that come with packages of others are read as scans: meshes, a range image, point clouds and height maps."""

from __future__ import annotations

import importlib.util
import warnings
from pathlib import Path

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.scans import height_map

from tacbench_cad.extensions.scan import reading
from tacbench_cad.extensions.scan.reading import MIN_POINTS, read_scan
from tacbench_cad.extensions.scan.roughness import roughness
from tacbench_cad.extensions.scan.simulating import ScanTruth, simulate_scan
from tacbench_cad.spec.block import Block

pytestmark = pytest.mark.real


def folder(package: str, inside: str) -> Path:
    """Return a folder inside an installed package; skip the test if it is not there."""
    spec = importlib.util.find_spec(package)
    if spec is None or spec.origin is None:
        pytest.skip(f"{package} is not installed: pip install {package}")
    place = Path(spec.origin).parent / inside
    if not place.is_dir():
        pytest.skip(f"this version of {package} brings no {inside}")
    return place


@pytest.mark.parametrize("name", ["airplane.obj", "bunny.obj", "cow.obj", "bone.ply", "colored_airplane.ply",
                                  "bunny10k_textured.obj", "rangemaps/face000.ply"])  # fmt: skip
def test_sample_meshes_of_pymeshlab(name: str) -> None:
    pymeshlab = pytest.importorskip("pymeshlab", exc_type=ImportError)
    pytest.importorskip("trimesh")
    path = folder("pymeshlab", "tests/sample_meshes") / name
    scan = read_scan(path, unit="mm")
    assert len(scan.cloud) >= MIN_POINTS
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    vertices = meshes.current_mesh().vertex_matrix()
    low, high = scan.cloud.points_mm.min(axis=0), scan.cloud.points_mm.max(axis=0)
    slack = 0.03 * np.ptp(vertices, axis=0)  # the points of a coarse mesh lie on its triangles, not at its corners
    assert np.all(np.abs(low - vertices.min(axis=0)) <= slack)
    assert np.all(np.abs(high - vertices.max(axis=0)) <= slack)


@pytest.mark.parametrize("writer", ["pymeshlab", "trimesh"])
@pytest.mark.parametrize("ending", mostly_long(["ply", "obj", "stl", "3mf"], "ply", "3mf"))
def test_meshes_by_other_programs(writer: str, ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = pytest.importorskip(writer, exc_type=ImportError)
    pytest.importorskip("trimesh")
    monkeypatch.setattr(reading, "MIN_VERTICES", 1000)
    block = Block.of(2)
    x, y = np.meshgrid(np.linspace(0.0, block.size_mm[0], 40), np.linspace(0.0, block.size_mm[1], 50))
    vertices = np.stack([x, y, block.height_at(x, y)], axis=-1).astype(np.float32).reshape(-1, 3).astype(np.float64)
    place = np.arange(vertices.shape[0]).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])
    path = tmp_path / f"a.{ending}"
    if writer == "pymeshlab":
        meshes = module.MeshSet()
        meshes.add_mesh(module.Mesh(vertices, faces, v_color_matrix=np.full((len(vertices), 4), 0.5)))
        meshes.save_current_mesh(str(path))
    else:
        module.Trimesh(vertices, faces, process=False).export(path)
    scan = read_scan(path, unit="mm", size_mm=(*block.size_mm, block.height_mm))
    assert scan.kind == "mesh"
    order = [np.lexsort(points.round(4).T) for points in (scan.cloud.points_mm, vertices)]
    np.testing.assert_allclose(scan.cloud.points_mm[order[0]], vertices[order[1]], atol=1e-6)


@pytest.mark.parametrize("compression", mostly_long([None, "tiff_lzw", "tiff_adobe_deflate", "packbits"], None))
@pytest.mark.parametrize("dtype", ["<f4", "<u2"])
def test_height_maps_by_pillow(compression: str | None, dtype: str, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    levels = np.random.default_rng(3).integers(3000, 4000, (40, 50)).astype(dtype)
    levels[10:12, 20:25] = 65535  # not measured
    image.fromarray(levels).save(tmp_path / "a.tif", compression=compression)
    scan = read_scan(tmp_path / "a.tif", unit="um", mm_per_pixel=0.1)
    assert scan.cloud.grid is not None
    expected = np.where(levels == 65535, np.nan, levels / 1000.0)
    np.testing.assert_allclose(scan.cloud.grid.heights_mm[::-1], expected)


def test_point_clouds_by_laspy(tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    points = simulate_scan(Block.of(2), ScanTruth(points=5000)).points_mm
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = np.full(3, 1e-5), points.min(axis=0)
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.write(tmp_path / "a.las")
    scan = read_scan(tmp_path / "a.las", unit="mm", size_mm=(23.3, 30.0, 7.0))
    np.testing.assert_allclose(scan.cloud.points_mm, points, atol=1e-5)


@pytest.mark.parametrize("ending", ["sur", "sdf", "al3d", "x3p"])
def test_files_of_instruments_by_surfalize(ending: str, tmp_path: Path) -> None:
    surfalize = pytest.importorskip("surfalize")
    block = Block.of(2)
    cloud = height_map(block, noise_mm=0.02, seed=1, step_mm=0.1)
    assert cloud.grid is not None
    heights = cloud.grid.heights_mm[5:-5, 5:-5]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            surfalize.Surface(1000.0 * heights[::-1], 100.0, 100.0).save(tmp_path / f"a.{ending}")
        except Exception as error:
            pytest.skip(f"surfalize {surfalize.__version__} does not write .{ending}: {error}")
    scan = read_scan(tmp_path / f"a.{ending}", size_mm=(*block.size_mm, block.height_mm))
    assert scan.kind == "height map"
    assert scan.notes == ()
    assert scan.cloud.grid is not None
    assert scan.cloud.grid.step_mm == pytest.approx((0.1, 0.1))
    read = scan.cloud.grid.heights_mm
    np.testing.assert_allclose(read - np.nanmean(read), heights - np.nanmean(heights), atol=1e-3)
    assert roughness(scan.cloud.grid).sq_um == pytest.approx(roughness(cloud.grid).sq_um, rel=0.1)
