"""Outlines of blocks: discs, polygons and rings, their extremes, integrals and names, and what they refuse."""

import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad import Block
from tacbench_cad.making.labelled import blocks_named
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.outlines import Disc, Outline, Polygon, RegularPolygon, Ring, outline_of
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.spec.storage import block_from, block_values
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError

CORNER = Polygon(points_mm=((0, 0), (25, 0), (25, 10), (10, 10), (10, 25), (0, 25)))
OUTLINES = [Disc(diameter_mm=30), RegularPolygon(sides=6, diameter_mm=30), Ring(outer_mm=30, inner_mm=12), CORNER]
WEAVE = Texture(name="weave", surface=plane_waves((0.6, 2.0, 1.0), (0.6, 2.0, -1.0)))


@pytest.mark.parametrize("outline", OUTLINES, ids=lambda outline: outline.word[:4])
@pytest.mark.parametrize("texture", mostly_long([1, 4, WEAVE], WEAVE), ids=["waves along x", "separable", "oblique"])
def test_extremes_and_volume_agree_with_dense_samples(outline: Outline, texture: int | Texture) -> None:
    block = Block.of(texture, outline=outline)
    x_side, y_side = block.size_mm
    steps = 450
    x, y = (side * (np.arange(steps) + 0.5) / steps for side in (x_side, y_side))
    inside = outline.distance(x[:, None], y[None, :]) <= 0.0
    heights = block.surface.grid(x, y)[inside]
    extremes = block.extremes
    assert extremes.low - extremes.error <= heights.min() <= extremes.low + 0.02 * block.relief_mm
    assert extremes.high - 0.02 * block.relief_mm <= heights.max() <= extremes.high + extremes.error
    for at, value in ((extremes.at_low, extremes.low), (extremes.at_high, extremes.high)):
        assert float(outline.distance(*at)) <= 1e-9
        assert float(block.surface(*at)) == pytest.approx(value, abs=1e-7)
    cell = x_side * y_side / steps**2
    assert inside.sum() * cell == pytest.approx(outline.area_mm2, rel=2e-3)
    expected = block.datum_mm * outline.area_mm2 + float(heights.sum()) * cell
    assert block.volume_mm3(block.datum_mm) == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("disc", Disc(diameter_mm=20.0)),
        ("disc:30", Disc(diameter_mm=30.0)),
        ("hexagon", RegularPolygon(sides=6, diameter_mm=20.0)),
        ("ring:30,12", Ring(outer_mm=30.0, inner_mm=12.0)),
        ("polygon:1,1,21,1,11,16.5", Polygon(points_mm=((0, 0), (20, 0), (10, 15.5)))),
    ],
)
def test_words_make_outlines(word: str, expected: Outline) -> None:
    assert outline_of(word, (20.0, 25.0)) == expected


@pytest.mark.parametrize("outline", OUTLINES, ids=lambda outline: outline.word[:4])
def test_names_and_run_files_keep_the_outline(outline: Outline) -> None:
    block = Block.of(4, outline=outline, height_mm=8.0, scale=1.5)
    assert blocks_named(block.name) == [block]
    assert block_from(block_values(block)) == block
    assert block.outline == outline.scaled(1.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"outline": "dsc"}, 'did you mean "disc"?'),
        ({"outline": "disc:a"}, "must have numbers of mm"),
        ({"outline": "ring:30,29"}, "at most 28 mm"),
        ({"outline": "disc", "key_mm": 3.0}, "needs a rectangular block"),
        ({"outline": "disc", "sampling": "grid"}, "use a tolerance"),
        ({"outline": "disc:30", "size_mm": (20.0, 20.0)}, "leave it out"),
        ({"outline": 5}, "must be a Disc"),
        ({"outline": "polygon:0,0,20,20,20,0,0,20"}, "cross or touch"),
        ({"outline": "ring:30,12", "label": True}, "do not fit into the underside of a ring"),
    ],
)
def test_wrong_outlines_are_refused_in_one_sentence(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message.replace("?", "[?]")):
        _ = Block.of(2, **options).engraving  # type: ignore[arg-type]


def test_press_grid_states_how_far_it_leaves_the_outline() -> None:
    PressGrid.paper().require_on(Block.of(2, outline="disc:30"))
    with pytest.raises(InputError, match=r"8 of the 25 press positions are outside of it; .* by 2.04 mm"):
        PressGrid.paper().require_on(Block.of(2, outline="disc:23.3"))
    with pytest.raises(InputError, match="press positions are outside"):
        PressGrid.paper(0.5).require_on(Block.of(2, outline="ring:30,20", scale=0.5, height_mm=9))


def test_labels_stay_away_from_the_outline() -> None:
    block = Block.of(2, outline="ring:60,25", label=True)
    assert block.engraving is not None and block.outline is not None
    points = np.concatenate(block.engraving.contours)
    assert float(block.outline.distance(*points.T).max()) < -1.5
