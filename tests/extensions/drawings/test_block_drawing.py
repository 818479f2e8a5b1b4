"""The drawing of a block: numbers agree with the mesh, texts do not overlap, files are complete and reproducible."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from helpers.cases import mostly_long

pytest.importorskip("matplotlib", reason="drawings need the extra plot")

from helpers.drawing_measure import clashes, faults
from PIL import Image

from tacbench_cad.extensions.drawings import Drawing, block_drawing, save_drawing
from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import InputError

BLOCKS = {
    "default": Block.of(4),
    "along one axis": Block.of(1),
    "keyed and labelled": Block.of(2, key_mm=3.0, label=True),
    "scaled": Block.of(3, scale=1.7, key_mm=4.0),
    "small": Block.of(5, scale=0.6),
    "large": Block.of(6, scale=5.0, copy=12),
    "narrow": Block.of(2, size_mm=(60.0, 11.0), label=True),
    "released, joined samples that draw another shape": Block.of(4, "released", key_mm=3.0, label=True),
    "its own grid": Block.of(2, sampling=SampleGrid(nx=40, ny=31), key_mm=5.0),
}
QUICK = ("default", "keyed and labelled", "narrow")


@cache
def drawing_of(name: str) -> Drawing:
    """Return the drawing, with the press grid if the block is large enough."""
    return block_drawing(BLOCKS[name], press=name not in ("small", "narrow"))


@pytest.mark.parametrize("name", mostly_long(BLOCKS, *QUICK))
def test_every_number_is_the_distance_on_the_mesh(name: str) -> None:
    block = BLOCKS[name]
    exact = isinstance(block.sampling, SampleGrid)
    drawing = drawing_of(name)
    # The valleys of a mesh deviate by its tolerance at most; coordinates are rounded to float32.
    assert faults(drawing, 2e-4 if exact else mesh_block(block)[1].distance_mm) == []
    numbers = {dimension.name: dimension.value_mm for dimension in drawing.dimensions}
    assert (numbers["side x"], numbers["side y"], numbers["height"]) == (*block.size_mm, block.height_mm)
    assert numbers["base"] + numbers["relief"] == pytest.approx(block.height_mm)
    if not exact:
        assert numbers["relief"] == pytest.approx(block.relief_mm)


@pytest.mark.parametrize("name", mostly_long(BLOCKS, *QUICK))
def test_texts_do_not_overlap_other_texts_or_lines(name: str) -> None:
    assert clashes(drawing_of(name)) == []


def test_the_press_grid_agrees_with_the_protocol() -> None:
    block = Block.of(1, scale=1.5)
    numbers = {dimension.name: dimension for dimension in block_drawing(block, press=True).plan.dimensions}
    assert (numbers["first press column"].value_mm, numbers["first press row"].value_mm) == (6.0, 27.0)
    assert numbers["press rows"].text == "4 x 1.88 = 7.5"
    assert "first press row" not in {dimension.name for dimension in block_drawing(block).plan.dimensions}
    with pytest.raises(InputError, match="press grid"):
        block_drawing(Block.of(2, size_mm=(8.0, 11.0)), press=True)


def test_files_of_every_format_are_complete_and_equal_on_every_run(tmp_path: Path) -> None:
    drawing = drawing_of("along one axis")
    heads = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
    for suffix, head in heads.items():
        paths = [tmp_path / f"{run}{suffix}" for run in "ab"]
        for path in paths:
            save_drawing(drawing, path)
        assert paths[0].read_bytes().startswith(head)
        assert paths[0].read_bytes() == paths[1].read_bytes()
        assert b"/work" not in paths[0].read_bytes() and b"Matplotlib" not in paths[0].read_bytes()[:2000]
    assert b"/CIDFontType2" in (tmp_path / "a.pdf").read_bytes(), "the letters are searchable text"
    with Image.open(tmp_path / "a.png") as picture:
        assert picture.size == (2338, 1653)
    assert b'width="841.889764pt"' in (tmp_path / "a.svg").read_bytes()
    with pytest.raises(InputError, match=r"must end in \.png, \.pdf or \.svg"):
        save_drawing(drawing, tmp_path / "a.dxf")
    assert len(list(tmp_path.iterdir())) == 6
