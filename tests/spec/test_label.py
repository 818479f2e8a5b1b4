"""The engraved label: correct, legible, inside the outline and printable."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from manifold3d import CrossSection, FillRule, JoinType

from tacbench_cad.spec.block import MAX_COPIES, Block
from tacbench_cad.spec.glyphs import GLYPHS, UNITS_HIGH
from tacbench_cad.spec.label import (
    MARGIN_MM,
    MAX_GLYPH_MM,
    MIN_GLYPH_MM,
    STROKE_MM,
    Engraving,
    _placed,
    engrave,
)
from tacbench_cad.spec.outlines import Ring, area_mm2, without_key
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools

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


def seen_from_below(engraving: Engraving, step: float = 0.05) -> Bools:
    """Return a picture of the underside, turned over about x. Row 0 is at the top (low y), column 0 is left (low x)."""
    points = np.concatenate(engraving.contours)
    x = np.arange(points[:, 0].min(), points[:, 0].max(), step) + step / 2
    y = np.arange(points[:, 1].min(), points[:, 1].max(), step) + step / 2
    inside = np.zeros((len(y), len(x)), dtype=np.int64)
    for c in engraving.contours:
        for (x0, y0), (x1, y1) in zip(c, np.roll(c, -1, axis=0), strict=True):
            if y0 == y1:
                continue
            rows = (y >= min(y0, y1)) & (y < max(y0, y1))
            at = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
            inside[rows] += (x[None, :] > at[rows, None]).astype(np.int64) * (1 if y1 > y0 else -1)
    return inside != 0


def as_drawn(character: str, height: float, step: float = 0.05) -> Bools:
    """Draw the glyph by the distance from its centre lines, which is not the method of the module."""
    glyph, unit = GLYPHS[character], (height - STROKE_MM) / UNITS_HIGH
    x = np.arange(0.0, glyph.width * unit + STROKE_MM, step) + step / 2 - STROKE_MM / 2
    y = np.arange(0.0, height, step) + step / 2 - STROKE_MM / 2
    px, py = np.meshgrid(x, y)
    near = np.full(px.shape, np.inf)
    for line in glyph.lines:
        for (x0, y0), (x1, y1) in zip(line, line[1:] or line, strict=False):
            ax, ay, dx, dy = x0 * unit, y0 * unit, (x1 - x0) * unit, (y1 - y0) * unit
            t = np.clip(((px - ax) * dx + (py - ay) * dy) / max(dx * dx + dy * dy, 1e-12), 0.0, 1.0)
            near = np.minimum(near, np.hypot(px - ax - t * dx, py - ay - t * dy))
    ink = near <= STROKE_MM / 2
    return ink[np.ix_(ink.any(axis=1), ink.any(axis=0))][::-1]


def differing(first: Bools, second: Bools) -> float:
    """Return the fraction of the ink in which two pictures differ, after both are cut to the smaller size."""
    rows, columns = (min(first.shape[i], second.shape[i]) for i in (0, 1))
    if max(abs(first.shape[i] - second.shape[i]) for i in (0, 1)) > 2:
        return 1.0
    a, b = first[:rows, :columns], second[:rows, :columns]
    return float(np.count_nonzero(a != b) / np.count_nonzero(a | b))


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
        assert differing(picture[:, ::-1], as_drawn(character, engraving.glyph_mm)) > 0.1


def test_glyphs_differ() -> None:
    """Two glyphs have at most 90 % of their ink in common."""
    alike = []
    for first, second in itertools.combinations(sorted(GLYPHS), 2):
        a, b = as_drawn(first, MIN_GLYPH_MM), as_drawn(second, MIN_GLYPH_MM)
        shape = [max(a.shape[i], b.shape[i]) for i in (0, 1)]
        a, b = (np.pad(glyph, [(0, shape[i] - glyph.shape[i]) for i in (0, 1)]) for glyph in (a, b))
        if np.count_nonzero(a != b) <= 0.1 * np.count_nonzero(a | b):
            alike.append((first, second))
    assert not alike


@pytest.mark.parametrize("character", sorted(GLYPHS))
def test_strokes_run_along_the_axes_or_at_45_degrees(character: str) -> None:
    """Only with these directions is an octagonal pen exactly as wide as intended. Glyphs also fill their box."""
    glyph = GLYPHS[character]
    for line in glyph.lines:
        for (x0, y0), (x1, y1) in itertools.pairwise(line):
            assert x0 == x1 or y0 == y1 or abs(x1 - x0) == abs(y1 - y0)
    points = np.concatenate(glyph.lines)
    assert points.min(axis=0)[0] == 0.0
    assert points.max(axis=0)[0] == glyph.width
    assert points.min() >= 0.0
    assert points[:, 1].max() <= UNITS_HIGH


def test_turned_text_reads_upwards_from_below() -> None:
    """On a narrow block, the line runs along y. Seen from below, a quarter turn clockwise makes it upright."""
    engraving = engraved(("LF",), (8.0, 30.0), 0.0)
    picture = np.rot90(seen_from_below(engraving), k=-1)
    letters = np.flatnonzero(np.diff(np.concatenate([[0], picture.any(axis=0).astype(int), [0]])))
    assert len(letters) == 4, "two letters with a gap between them"
    for (left, right), character in zip(letters.reshape(2, 2), "LF", strict=True):
        assert differing(picture[:, left:right], as_drawn(character, engraving.glyph_mm)) < 0.12


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


@pytest.mark.parametrize("scale", [0.4, 0.5])
def test_too_small_is_refused(scale: float) -> None:
    """The message names the required size and the available size."""
    with pytest.raises(
        InputError, match=r"needs an underside of [\d.]+ x [\d.]+ mm .* this one has [\d.]+ x [\d.]+ mm"
    ):
        engraved(("T4", "PAPER", f"X{scale}", "03"), (23.3 * scale, 30.0 * scale), 0.0)


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


@pytest.mark.long
def test_the_labels_of_all_copies_need_few_searches() -> None:
    _placed.cache_clear()
    ring = Ring(outer_mm=40.0, inner_mm=8.0)
    for copy in range(1, MAX_COPIES + 1, 7):
        engrave(("T2", "PAPER", "X1", f"{copy:02d}"), ring.size_mm, ring)
    # digits have three widths, and a copy has two or three digits
    assert _placed.cache_info().misses <= 3**2 + 3**3
