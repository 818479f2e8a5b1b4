"""The contents of the files, read by independent code: bytes, frames, units and the proved error."""

from __future__ import annotations

import itertools
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest
from helpers.tops import random_texture
from PIL import Image

from tacbench_cad.extensions.simulators import asset as assets
from tacbench_cad.extensions.simulators.asset import SimulatorAsset
from tacbench_cad.extensions.simulators.folder import export_to_simulators
from tacbench_cad.extensions.simulators.taxim import PIXEL_MM
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.errors import InputError


def field_of(path: Path) -> np.ndarray:
    rows, columns = np.fromfile(path, dtype="<i4", count=2)
    values = np.fromfile(path, dtype="<f4", offset=8)
    assert len(values) == rows * columns
    return values.reshape(rows, columns).astype(np.float64)


def oblique(scale: float = 1.0) -> Block:
    texture = random_texture(np.random.default_rng(3), oblique=True)
    return Block.of(texture, size_mm=(12.0, 9.0), height_mm=20.0, mm_per_unit=(1.5, 1.5, 1.0), scale=scale)


@pytest.mark.parametrize("block", [Block.of("3"), oblique(), Block.of("2", "released"), Block.of("6", scale=2.0)])
def test_grids_follow_the_formula_within_the_proved_error(block: Block) -> None:
    field = SimulatorAsset(block).heights
    np.testing.assert_allclose(field.z_mm, block.datum_mm + block.surface.grid(field.x_mm, field.y_mm).T, atol=1e-12)
    assert (field.x_mm[0], field.x_mm[-1]) == pytest.approx((0.0, block.size_mm[0]))
    assert field.z_mm.max() <= block.height_mm + 1e-9
    rng = np.random.default_rng(1)
    i, j = rng.integers(0, len(field.x_mm) - 1, 20_000), rng.integers(0, len(field.y_mm) - 1, 20_000)
    s, t = rng.random((2, 20_000))
    z00, z10 = field.z_mm[j, i], field.z_mm[j, i + 1]
    z01, z11 = field.z_mm[j + 1, i], field.z_mm[j + 1, i + 1]
    x = field.x_mm[i] + s * (field.x_mm[i + 1] - field.x_mm[i])
    y = field.y_mm[j] + t * (field.y_mm[j + 1] - field.y_mm[j])
    falling = np.where(
        s + t <= 1.0, z00 + s * (z10 - z00) + t * (z01 - z00), z11 + (1 - s) * (z01 - z11) + (1 - t) * (z10 - z11)
    )
    rising = np.where(s >= t, z00 + s * (z10 - z00) + t * (z11 - z10), z00 + t * (z01 - z00) + s * (z11 - z01))
    formula = block.datum_mm + block.surface(x, y)
    worst = max(np.abs(falling - formula).max(), np.abs(rising - formula).max())
    assert 0.3 * field.certificate.vertical_mm <= worst <= field.certificate.vertical_mm
    if isinstance(block.sampling, Tolerance):
        assert field.certificate.distance_mm <= assets.GRID_DISTANCE_MM


@pytest.mark.parametrize("block", [Block.of("4"), oblique(), Block.of("5", scale=0.3)])
def test_mujocos_fields_hold_the_heights_and_their_sizes(block: Block, tmp_path: Path) -> None:
    folder = export_to_simulators([block], ["mjcf"], tmp_path)[0].folder
    heights, name = SimulatorAsset(block).heights, block.texture.name
    np.testing.assert_array_equal(field_of(folder / f"{name}.hf"), heights.z_mm.astype(np.float32))
    for kind, count in (("", 1), ("-tiles", 64)):
        root = ElementTree.parse(folder / f"{name}{kind}.xml").getroot()
        fields, geoms = root.findall("asset/hfield"), root.findall("worldbody/body/geom")
        assert len(fields) == len(geoms) == count
        covered, names = 0.0, set()
        for field, geom in zip(fields, geoms, strict=True):
            names.add(field.get("name"))
            z = field_of(folder / str(field.get("file")))
            rx, ry, high, base = (1e3 * float(word) for word in str(field.get("size")).split())
            cx, cy, cz = (1e3 * float(word) for word in str(geom.get("pos")).split())
            assert (z.min(), z.max() - z.min()) == pytest.approx((cz, high), abs=1e-5)
            assert base == pytest.approx(cz) and base > 0.0
            corners = [(cx + a * rx, cy + b * ry) for a, b in itertools.product((-1, 1), (-1, 1))]
            for (x, y), value in zip(corners, (z[0, 0], z[-1, 0], z[0, -1], z[-1, -1]), strict=True):
                steep = block.surface.bound(1, 0) + block.surface.bound(0, 1)
                assert value == pytest.approx(float(block.height_at(x, y)), abs=1e-5 + 1e-6 * steep)
            covered += 4.0 * rx * ry
        assert covered == pytest.approx(block.size_mm[0] * block.size_mm[1], rel=1e-6)
        assert len(names) == count


def test_the_array_and_the_picture_agree_with_the_formula(tmp_path: Path) -> None:
    block = Block.of("4")
    folder = export_to_simulators([block], ["npy", "png16"], tmp_path)[0].folder
    z = np.load(folder / "texture-4.npy", allow_pickle=False)
    assert z.dtype == np.float64
    x, y = (np.linspace(0.0, side, count) for side, count in zip(block.size_mm, z.shape[::-1], strict=True))
    np.testing.assert_allclose(z, block.datum_mm + block.surface.grid(x, y).T, atol=1e-12)
    with Image.open(folder / "texture-4.png") as picture:
        assert picture.mode.startswith("I") and picture.size == z.shape[::-1]
        levels = np.asarray(picture).astype(np.float64)
        words = picture.info["Description"]
    assert (levels.min(), levels.max()) == (0, 65535)
    low, step = (float(word) for word in re.findall(r"= ([\d.]+) \+ level \* ([\d.e-]+);", words)[0])
    np.testing.assert_allclose(low + step * levels[::-1], z, atol=0.51 * step)


@pytest.mark.parametrize("preset", ["paper", "released"])
def test_taxims_points_are_close_together_and_on_the_surface(preset: str, tmp_path: Path) -> None:
    block = Block.of("3", preset, scale=0.5)
    folder = export_to_simulators([block], ["taxim"], tmp_path)[0].folder
    lines = (folder / "texture-3.ply").read_text().splitlines()
    assert lines[9] == "end_header" and lines[3] == f"element vertex {len(lines) - 10}"
    x, y, z = np.loadtxt(lines[10:]).T
    assert np.diff(np.unique(x)).max() <= PIXEL_MM and np.diff(np.unique(y)).max() <= PIXEL_MM
    allowed = 1e-4 if preset == "paper" else SimulatorAsset(block).heights.certificate.vertical_mm + 1e-4
    assert np.abs(z - block.height_at(x, y)).max() <= allowed


def test_a_top_too_large_for_taxim_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"scale = 20\.0: a top of 466 x 600 mm"):
        export_to_simulators([Block.of("1", scale=20.0)], ["taxim"], tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("target", ["urdf", "sdf"])
def test_robot_descriptions_name_their_mesh_and_its_scale(target: str, tmp_path: Path) -> None:
    folder = export_to_simulators([Block.of("5")], [target], tmp_path)[0].folder
    root = ElementTree.parse(folder / f"texture-5.{target}").getroot()
    if target == "urdf":
        meshes = [(element.get("filename"), element.get("scale")) for element in root.iter("mesh")]
        assert [element.get("concave") for element in root.iter("collision")] == ["yes"]
        assert [element.get("value") for element in root.iter("mass")] == ["0"]
    else:
        meshes = [(element.findtext("uri"), element.findtext("scale")) for element in root.iter("mesh")]
        mass = Block.of("5").volume_mm3(Block.of("5").datum_mm) * 1.24e-6
        assert float(str(root.findtext("model/link/inertial/mass"))) == pytest.approx(mass, rel=1e-5)
    assert meshes == [("texture-5.obj", "0.001 0.001 0.001")] * 2
    assert (folder / "texture-5.obj").is_file()


def test_the_obj_is_the_printed_mesh_bit_by_bit(tmp_path: Path) -> None:
    block = Block.of("2", scale=1.5, label=True)
    folder = export_to_simulators([block], ["obj"], tmp_path)[0].folder
    rows = [line.split() for line in (folder / "texture-2.obj").read_text().splitlines()]
    mesh = SimulatorAsset(block).mesh
    np.testing.assert_array_equal(np.float32([row[1:] for row in rows if row[0] == "v"]), mesh.vertices)
    np.testing.assert_array_equal(np.int64([row[1:] for row in rows if row[0] == "f"]) - 1, mesh.faces)
