"""The engraved label: correct, legible, inside the outline and printable."""

from __future__ import annotations

import itertools
import math
from functools import reduce

import numpy as np
import pytest
from manifold3d import CrossSection, FillRule, JoinType
from shapely import LineString, Point, Polygon, unary_union
from shapely.affinity import rotate, scale, translate
from shapely.geometry.base import BaseGeometry

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH
from tacbench_cad.spec.label import (
    MARGIN_MM,
    MAX_GLYPH_MM,
    MIN_GLYPH_MM,
    STROKE_MM,
    Engraving,
    engrave,
)
from tacbench_cad.spec.outlines import area_mm2, without_key
from tacbench_cad.util.errors import InputError

BLOCK = (23.3, 30.0)
CASES = [
    (("T4", "PAPER", "X1", "03"), BLOCK, 0.0),
    (("T4", "PAPER", "X1", "03"), BLOCK, 3.0),
    (("T4", "PAPER", "X1", "03"), BLOCK, 23.3 / 3),
    (("T6", "RELEASED", "X1"), (29.3, 30.0), 3.0),
    (("T2", "PAPER", "X0.75"), (17.475, 22.5), 5.8),
    (("HEX-WIDE-2", "PAPER", "X1", "12"), BLOCK, 7.7),
    (("ABCDEFGHI", "JKLMNOPQR", "STUVWXYZ", "0123456789-."), (80.0, 80.0), 0.0),
    (("ABCDEFGHI", "JKLMNOPQR", "STUVWXYZ", "0123456789-."), (33.0, 24.0), 0.0),
]


def engraved(words: tuple[str, ...], size: tuple[float, float], key: float) -> Engraving:
    return engrave(words, size, without_key(size, key) if key else None)


def section(engraving: Engraving) -> CrossSection:
    return CrossSection([c.tolist() for c in engraving.contours], FillRule.Positive)


def at_corner(shape: BaseGeometry) -> BaseGeometry:
    low_x, low_y, _, _ = shape.bounds
    return translate(shape, -low_x, -low_y)


def seen_from_below(engraving: Engraving) -> BaseGeometry:
    """Return the letters of the underside, turned over about x, with their lower corner at the origin."""
    return at_corner(scale(reduce(BaseGeometry.symmetric_difference, map(Polygon, engraving.contours)), 1.0, -1.0))


def as_drawn(character: str, height: float) -> BaseGeometry:
    """Draw the glyph with a round pen along its centre lines."""
    unit = (height - STROKE_MM) / UNITS_HIGH
    lines = [np.array(line, dtype=float) * unit for line in GLYPHS[character].lines]
    pens = [(LineString(line) if len(line) > 1 else Point(line[0])).buffer(STROKE_MM / 2.0) for line in lines]
    return at_corner(unary_union(pens))


def differing(first: BaseGeometry, second: BaseGeometry) -> float:
    """Return the fraction of the ink in which two pictures differ."""
    return float(first.symmetric_difference(second).area / first.union(second).area)


@pytest.mark.parametrize("character", sorted(GLYPHS))
@pytest.mark.parametrize("size", [(30.0, 30.0), (6.2, 6.2)], ids=["5mm", "3mm"])
def test_each_glyph_is_legible_from_below(character: str, size: tuple[float, float]) -> None:
    """Turned over about x, a glyph matches its drawing better than its mirror image or other glyphs match it."""
    engraving = engraved((character,), size, 0.0)
    assert engraving.glyph_mm == (MAX_GLYPH_MM if size[0] == 30.0 else MIN_GLYPH_MM)
    picture = seen_from_below(engraving)
    scores = {glyph: differing(picture, as_drawn(glyph, engraving.glyph_mm)) for glyph in GLYPHS}
    assert scores[character] < 0.12
    assert min((score, glyph) for glyph, score in scores.items())[1] == character
    if character in "BCDEFGJKLNPQRSZ1234567":
        assert differing(at_corner(scale(picture, -1.0, 1.0)), as_drawn(character, engraving.glyph_mm)) > 0.1


def test_glyphs_differ() -> None:
    """Two glyphs have at most 90 % of their ink in common."""
    drawn = {glyph: as_drawn(glyph, MIN_GLYPH_MM) for glyph in sorted(GLYPHS)}
    assert [
        pair for pair in itertools.combinations(drawn, 2) if differing(*(drawn[glyph] for glyph in pair)) <= 0.1
    ] == []


def test_turned_text_reads_upwards_from_below() -> None:
    """On a narrow block, the line runs along y. Seen from below, a quarter turn clockwise makes it upright."""
    engraving = engraved(("LF",), (8.0, 30.0), 0.0)
    picture = rotate(seen_from_below(engraving), -90.0, origin=(0.0, 0.0))
    letters = sorted(picture.geoms, key=lambda letter: letter.bounds[0])
    assert len(letters) == 2
    for letter, character in zip(letters, "LF", strict=True):
        assert differing(at_corner(letter), as_drawn(character, engraving.glyph_mm)) < 0.12


@pytest.mark.parametrize(("words", "size", "key"), CASES)
def test_contours_are_clean(words: tuple[str, ...], size: tuple[float, float], key: float) -> None:
    """Contours have float32 values, no short edges or repeated points, clockwise islands, and the union's area."""
    engraving = engraved(words, size, key)
    points = np.concatenate(engraving.contours)
    assert np.array_equal(points, points.astype(np.float32))
    assert len(np.unique(points, axis=0)) == len(points)
    for c in engraving.contours:
        assert np.linalg.norm(np.roll(c, -1, axis=0) - c, axis=1).min() >= 0.01
        before, after = c - np.roll(c, 1, axis=0), np.roll(c, -1, axis=0) - c
        turn = np.abs(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0])
        assert (turn > 1e-4).all(), "three points in line"
    union = section(engraving)
    assert engraving.area_mm2 == pytest.approx(union.area(), rel=1e-6)
    assert union.num_contour() == len(engraving.contours)
    holes = sum(area_mm2(c) < 0 for c in engraving.contours)
    expected = sum({"A": 1, "B": 2, "D": 1, "O": 1, "P": 1, "Q": 1, "R": 1}.get(c, 0) for c in "".join(words))
    expected += sum({"0": 1, "6": 1, "8": 2, "9": 1}.get(c, 0) for c in "".join(words))
    assert holes == expected
    pieces = union.decompose()
    assert len(pieces) == len("".join(words)), "each glyph is one piece, and none touches another"


@pytest.mark.parametrize(("words", "size", "key"), CASES)
def test_inside_the_outline(words: tuple[str, ...], size: tuple[float, float], key: float) -> None:
    """Every point is at least the margin away from the sides and from the key."""
    engraving = engraved(words, size, key)
    points = np.concatenate(engraving.contours)
    slack = 0.002  # rounding to 0.001 mm
    assert (points >= MARGIN_MM - slack).all()
    assert (points <= np.array(size) - MARGIN_MM + slack).all()
    if key:
        from_key = (size[0] - key - points[:, 0] + points[:, 1]) / math.sqrt(2.0)
        assert from_key.min() >= MARGIN_MM - slack


@pytest.mark.parametrize(("words", "size", "key"), CASES)
def test_strokes_are_a_pen_wide(words: tuple[str, ...], size: tuple[float, float], key: float) -> None:
    """A pen slightly thinner than the stroke reaches all parts, and no part is thicker than the stroke."""
    union = section(engraved(words, size, key))
    assert len(union.offset(-0.38, JoinType.Miter).decompose()) == len("".join(words))
    assert union.offset(-0.38, JoinType.Miter).offset(0.38, JoinType.Round).area() > 0.93 * union.area()


@pytest.mark.parametrize(("words", "size", "key"), CASES)
def test_gaps_can_be_printed(words: tuple[str, ...], size: tuple[float, float], key: float) -> None:
    """Gaps between strokes are at least 0.4 mm (the nozzle) for glyphs of 3.2 mm or higher, otherwise 0.3 mm."""
    engraving = engraved(words, size, key)
    min_gap = 0.4 if engraving.glyph_mm >= 3.2 else 0.3
    assert engraving.glyph_mm / 2.0 - 1.5 * STROKE_MM >= min_gap - 1e-9
    islands = [c for c in engraving.contours if area_mm2(c) < 0]
    for c in islands:
        assert CrossSection([c[::-1].tolist()]).offset(-min_gap / 2 + 0.005, JoinType.Miter).area() > 0.0
    points = section(engraving).decompose()
    for first, second in itertools.combinations(points, 2):
        assert (first.offset(0.29, JoinType.Round) ^ second.offset(0.29, JoinType.Round)).is_empty()


@pytest.mark.parametrize("number", range(1, 7))
@pytest.mark.parametrize("preset", ["paper", "released"])
def test_every_block_of_the_catalogue_takes_a_label(number: int, preset: str) -> None:
    block = Block.of(number, preset, copy=999, key_mm=3.0)
    assert block.engraving is not None
    assert block.engraving.glyph_mm >= 3.2


@pytest.mark.parametrize("factor", [0.4, 0.5])
def test_too_small_is_refused(factor: float) -> None:
    """The message names the required size and the available size."""
    with pytest.raises(
        InputError, match=r"needs an underside of [\d.]+ x [\d.]+ mm .* this one has [\d.]+ x [\d.]+ mm"
    ):
        engraved(("T4", "PAPER", f"X{factor}", "03"), (23.3 * factor, 30.0 * factor), 0.0)


def test_the_size_in_the_error_message_is_enough() -> None:
    words = ("T4", "PAPER", "X1", "03")
    with pytest.raises(InputError) as refused:
        engraved(words, (10.0, 12.0), 0.0)
    numbers = refused.value.allowed.split("underside of ")[1].split(" mm")[0].split(" x ")
    engraving = engraved(words, (float(numbers[0]), float(numbers[1])), 0.0)
    assert MIN_GLYPH_MM <= engraving.glyph_mm < MIN_GLYPH_MM + 0.2


@pytest.mark.parametrize("word", ["Ä", "T_4", "a/b", "T4\n"])
def test_unknown_characters_are_named(word: str) -> None:
    with pytest.raises(InputError, match="no glyph for"):
        engraved((word,), BLOCK, 0.0)
