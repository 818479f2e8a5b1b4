"""Pictures of CAD objects: every kind of object is drawn in its place and colour."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

bd = pytest.importorskip("build123d")
cq = pytest.importorskip("cadquery")

from PIL import Image

from tacbench_cad.render.snapshot import snapshot
from tacbench_cad.util.errors import InputError

SIZE = (240, 160)


def drawn(shape: Any, folder: Path) -> np.ndarray:
    path = folder / "picture.png"
    snapshot(shape, path, size_px=SIZE)
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def built() -> Any:
    with bd.BuildPart() as builder:
        bd.Box(4, 3, 2)
    return builder


@pytest.mark.parametrize(
    "make",
    [
        lambda: cq.Workplane().box(4, 3, 2),
        lambda: cq.Workplane().box(4, 3, 2).val(),
        lambda: cq.Assembly(cq.Workplane().box(4, 3, 2)),
        lambda: bd.Box(4, 3, 2),
        built,
        lambda: bd.Box(4, 3, 2).wrapped,
        lambda: [bd.Pos(-1, 0, 0) * bd.Box(2, 3, 2), bd.Pos(1, 0, 0) * bd.Box(2, 3, 2)],
    ],
    ids=["workplane", "shape", "assembly", "part", "builder", "kernel", "list"],
)
def test_every_kind_of_object_gives_one_picture(make: Any, tmp_path: Path) -> None:
    picture, expected = drawn(make(), tmp_path), drawn(bd.Box(4, 3, 2), tmp_path)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    assert 0.2 < (picture.min(axis=2) < 250).mean() < 0.9
    assert np.array_equal(picture, expected)


def red_and_green_places(shape: Any, folder: Path) -> tuple[float, float]:
    """Return the mean column of the red pixels and of the green pixels."""
    picture = drawn(shape, folder)
    red, green = picture[:, :, 0] > picture[:, :, 1] + 40, picture[:, :, 1] > picture[:, :, 0] + 40
    assert red.any() and green.any()
    return float(np.nonzero(red)[1].mean()), float(np.nonzero(green)[1].mean())


def test_children_have_their_colours_and_places(tmp_path: Path) -> None:
    left, right = bd.Pos(-5, 0, 0) * bd.Box(2, 2, 2), bd.Pos(5, 0, 0) * bd.Box(2, 2, 2)
    left.color, right.color = bd.Color(0xCC2222), bd.Color(0x22CC22)
    pair = bd.Compound(children=[left, right])
    red, green = red_and_green_places(pair, tmp_path)
    assert red < SIZE[0] / 3 < 2 * SIZE[0] / 3 < green
    # Nested children move with their parent: after a rotation by 180 degrees they have changed places.
    turned = bd.Compound(children=[bd.Rot(0, 0, 180) * bd.Pos(30, 0, 0) * pair])
    assert np.array_equal(drawn(turned, tmp_path), drawn(bd.Rot(0, 0, 180) * pair, tmp_path))
    red, green = red_and_green_places(turned, tmp_path)
    assert green < SIZE[0] / 3 < 2 * SIZE[0] / 3 < red


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ("block", "must be a CadQuery"),
        ([], "no face"),
        (bd.Edge.make_line((0, 0, 0), (1, 0, 0)), "no face"),
        (cq.Workplane(), "no face"),
    ],
    ids=["text", "nothing", "edge", "empty workplane"],
)
def test_an_object_that_cannot_be_drawn_is_named(shape: Any, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        snapshot(shape, tmp_path / "picture.png")
    assert not list(tmp_path.iterdir())
