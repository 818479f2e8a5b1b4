"""Height maps from files: what is read, and what is refused in one line."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.images import image_texture, read_heights
from tacbench_cad.spec.texture_files import read_texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError, MissingToolError
from tacbench_cad.util.types import Floats

Image = pytest.importorskip("PIL.Image")


@pytest.fixture(scope="module")
def relief() -> Floats:
    """A smooth, seamless relief from 0 to 1, shape (40, 60), with its first row at the largest y."""
    noise = gaussian_filter(np.random.default_rng(3).normal(size=(40, 60)), 3, mode="wrap")
    return np.asarray((noise - noise.min()) / np.ptp(noise))


def write(relief: Floats, path: Path) -> Path:
    if path.suffix == ".npy":
        np.save(path, relief)
    elif path.suffix == ".csv":
        np.savetxt(path, relief, delimiter=";")
    elif "8" in path.stem:
        Image.fromarray((relief * 255).astype(np.uint8)).save(path)
    else:
        Image.fromarray((relief * 65535).astype(np.uint16)).save(path)
    return path


@pytest.mark.parametrize("name", ["8.png", "16.png", "16.tif", "a.npy", "a.csv"])
def test_every_kind_of_file_gives_the_same_surface(name: str, relief: Floats, tmp_path: Path) -> None:
    texture = image_texture("own", write(relief, tmp_path / name), mm_per_pixel=0.5, height_mm=(0.2, 1.4))
    block = Block.of(texture)
    assert block.size_mm == (29.5, 19.5)
    x, y = 0.5 * np.arange(60), 0.5 * np.arange(40)
    expected = 0.2 + 1.2 * relief[::-1].T
    np.testing.assert_allclose(block.surface.grid(x, y), expected, atol=0.005 if "8" in name else 5e-5)


def test_a_file_with_a_height_map_and_its_block(relief: Floats, tmp_path: Path) -> None:
    write(relief, tmp_path / "16.png")
    text = '[texture]\nname = "own"\nfamily = "image"\nfile = "16.png"\nmm_per_pixel = [0.5, 0.6]\nheight_mm = [0, 1]\n'
    (tmp_path / "own.toml").write_text(text)
    file = read_texture(tmp_path / "own.toml")
    assert Block.of(file).size_mm == (29.5, 23.4)
    (tmp_path / "own.toml").write_text(text + "[block]\nsize_mm = [20, 15]\n")
    file = read_texture(tmp_path / "own.toml")
    assert Block.of(file).size_mm == (20.0, 15.0)
    with pytest.raises(InputError, match=r"domain = 'u 0 to 40': is larger than the surface"):
        Block.of(file, size_mm=(40.0, 15.0)).extremes  # noqa: B018


def test_waves_of_a_height_map_fit_a_block_of_any_size(relief: Floats, tmp_path: Path) -> None:
    write(relief, tmp_path / "16.png")
    text = '[texture]\nname = "own"\nfamily = "image"\nfile = "16.png"\nmm_per_pixel = 0.5\nheight_mm = [0, 1]\n'
    (tmp_path / "own.toml").write_text(text + 'fit = "waves"\nwaves = 80\n')
    texture = read_texture(tmp_path / "own.toml")
    assert isinstance(texture.surface, WaveSum)
    assert len(texture.surface.waves) == 80
    assert texture.equation.startswith("16.png as 80 waves, period 30 x 20 mm, rms error 0.0")
    points = np.random.default_rng(0).uniform(0.0, 20.0, (2, 50))
    np.testing.assert_allclose(texture.surface(points[0] + 30.0, points[1] - 20.0), texture.surface(*points), atol=1e-9)


def _png(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize("side", [9_000, 40_000])
def test_a_picture_that_is_too_large_is_refused_before_it_is_decoded(side: int, tmp_path: Path) -> None:
    (tmp_path / "huge.png").write_bytes(_png(side, side))
    with pytest.raises(InputError, match=r"huge\.png.*more (samples )?than the 20,000,000 allowed; make it smaller"):
        read_heights(tmp_path / "huge.png")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.full((9, 9), 7.0), r"has the same value 7 everywhere"),
        (
            np.where(np.eye(9) > 0.0, np.nan, 1.0),
            r"9 of 81 values are not finite .* row 1, column 1",
        ),
        (np.zeros((9, 3)), r"at least 4 rows and 4 columns"),
    ],
)
def test_heights_that_make_no_surface_are_refused(values: Floats, message: str, tmp_path: Path) -> None:
    np.save(tmp_path / "bad.npy", values)
    with pytest.raises(InputError, match=rf"bad\.npy: height map.*{message}"):
        image_texture("own", tmp_path / "bad.npy", mm_per_pixel=0.1)


def test_files_that_are_no_height_maps_are_refused(tmp_path: Path) -> None:
    for name, message in (
        ("a.png", "not a PNG or TIFF"),
        ("a.npy", "not a NumPy file"),
        ("a.csv", "not a table of numbers"),
    ):
        (tmp_path / name).write_bytes(b"hello")
        with pytest.raises(InputError, match=message):
            read_heights(tmp_path / name)
    np.save(tmp_path / "three.npy", np.zeros((4, 4, 3)))
    with pytest.raises(InputError, match=r"must be a table of numbers"):
        read_heights(tmp_path / "three.npy")
    with pytest.raises((InputError, MissingToolError), match=r"missing\.sur"):
        read_heights(tmp_path / "missing.sur")


def test_missing_numbers_are_named(relief: Floats, tmp_path: Path) -> None:
    path = write(relief, tmp_path / "16.png")
    with pytest.raises(InputError, match=r"mm_per_pixel: is missing; 16\.png does not say"):
        image_texture("own", path, height_mm=(0.0, 1.0))
    with pytest.raises(InputError, match=r"height_mm: is missing"):
        image_texture("own", path, mm_per_pixel=0.1)
