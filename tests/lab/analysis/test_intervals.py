"""Test intervals with prints as the unit: sums, coverage in synthetic studies, few prints, missing presses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from helpers.cases import mostly_long
from numpy.typing import NDArray

from tacbench_cad.lab.analysis.variance.intervals import (
    CellSums,
    Interval,
    component_interval,
    ratio_interval,
    variance_interval,
)
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

#: The variances between prints and between repeats in every synthetic study.
PRINT, REPEAT = 1.0, 0.5
SIDE = 24


def gram_of(frames: Sequence[NDArray[Any]]) -> Floats:
    """Return products of deviations from the mean frame, averaged over pixels, shape (n, n), as streaming does."""
    values = np.array([np.asarray(frame, dtype=np.float64).reshape(-1) for frame in frames])
    values -= values.mean(axis=0)
    return np.asarray(values @ values.T / values.shape[1])


@dataclass(frozen=True, kw_only=True)
class Field:
    """Correlated pixels: an independent random field for each print over ``positions`` images of SIDE x SIDE pixels.

    Args:
        length: The correlation length, in pixels.
        shared: The fraction of the variance that all positions of a print share (its height, its offset).
        positions: The number of positions.
    """

    length: float
    shared: float
    positions: int = 4

    def draw(self, count: int, random: np.random.Generator) -> Floats:
        """Return ``count`` fields of unit variance, shape (count, positions, pixels)."""
        axis = np.arange(SIDE)
        line = np.linalg.cholesky(
            np.exp(-0.5 * ((axis[:, None] - axis[None, :]) / self.length) ** 2) + 1e-9 * np.eye(SIDE)
        )
        white = random.standard_normal((count, self.positions + 1, SIDE, SIDE))
        smooth = (line @ white @ line.T).reshape(count, self.positions + 1, -1)
        return math.sqrt(1.0 - self.shared) * smooth[:, 1:] + math.sqrt(self.shared) * smooth[:, :1]


NOISE = Field(length=1.5, shared=0.1)


def study(prints: int, repeats: int, field: Field, random: np.random.Generator, repeat: float = REPEAT) -> CellSums:
    copies = np.repeat(np.arange(1, prints + 1), repeats)
    values = math.sqrt(PRINT) * field.draw(prints, random)[copies - 1]
    values += math.sqrt(repeat) * NOISE.draw(len(copies), random)
    return pooled([CellSums.of(gram_of(list(values[:, p])), copies) for p in range(values.shape[1])])


def pooled(sums: list[CellSums]) -> CellSums:
    total = sums[0]
    for cell in sums[1:]:
        total = total + cell
    return total


def truth(prints: int, repeats: int, repeat: float = REPEAT) -> float:
    return (1.0 - 1.0 / prints) * PRINT + (1.0 - 1.0 / (prints * repeats)) * repeat


def coverage(prints: int, field: Field, studies: int, seed: int, repeat: float = REPEAT) -> tuple[Floats, float]:
    """Return coverages and the bias over many studies.

    The coverages are those of the variance, both components and their ratio. The bias is the mean estimate of the
    variance over its true value.
    """
    random = np.random.default_rng(seed)
    covered, estimates = np.zeros(4), []
    truths = (truth(prints, 2, repeat), PRINT, repeat, 1.0 + PRINT / repeat)
    for _ in range(studies):
        cell = study(prints, 2, field, random, repeat)
        intervals = [variance_interval(cell), *(component_interval([cell], name) for name in ("print", "repeat"))]
        intervals.append(ratio_interval([cell]))
        covered += [interval.low <= value <= interval.high for interval, value in zip(intervals, truths, strict=True)]
        estimates.append(intervals[0].estimate)
    return covered / studies, float(np.mean(estimates)) / truths[0]


FIELDS = {
    "fine": Field(length=1.5, shared=0.0),
    "smooth": Field(length=6.0, shared=0.3),
    "coarse": Field(length=12.0, shared=0.8),
    "uniform": Field(length=1000.0, shared=0.999),
}


def test_intervals_cover() -> None:
    # With a coverage of 95 %, fewer than 25 of 30 intervals contain the true value in 3 of 1,000 cases.
    assert coverage(3, FIELDS["coarse"], 30, seed=3)[0].min() >= 25 / 30


@pytest.mark.long
@pytest.mark.parametrize("repeat", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("prints", [6, 3])
@pytest.mark.parametrize("kind", list(FIELDS))
def test_intervals_cover_92_to_97_of_100_in_500_studies(kind: str, prints: int, repeat: float) -> None:
    covered, bias = coverage(prints, FIELDS[kind], 500, seed=10 * prints, repeat=repeat)
    print(f"{kind}, {prints} prints, repeats {repeat:g}: {covered}")
    # Three prints with uniform images hardly show their number of independent parts; the coverage is 87 to 93 %.
    assert (0.85 if (kind, prints) == ("uniform", 3) else 0.91) <= covered.min() <= covered.max() <= 0.98
    assert bias == pytest.approx(1.0, abs=0.15)


def test_the_estimate_equals_the_figure_of_the_table() -> None:
    random = np.random.default_rng(0)
    values = random.integers(0, 256, (3, 12, 5_000)).astype(np.uint8)
    copies = np.repeat(range(6), 2)
    cell = pooled([CellSums.of(gram_of(list(field)), copies) for field in values])
    for ddof in (0, 1):
        table = float(values.astype(float).var(axis=1, ddof=ddof).mean())
        assert cell.variance(ddof) == pytest.approx(table, rel=1e-12)
        assert variance_interval(cell, ddof=ddof).estimate == pytest.approx(table, rel=1e-9)
    assert cell.presses == 36 and cell.positions == 3 and cell.prints == 6


def test_the_noise_floor_shifts_estimate_and_limits_down_to_zero() -> None:
    cell = study(6, 2, FIELDS["smooth"], np.random.default_rng(1))
    plain, less = variance_interval(cell), variance_interval(cell, floor=0.3)
    noise_part = 0.3 * 11.0 / 12.0
    assert less.estimate == pytest.approx(plain.estimate - noise_part)
    assert less.high == pytest.approx(plain.high - noise_part)
    assert less.low == pytest.approx(max(0.0, plain.low - noise_part))
    assert variance_interval(cell, floor=100.0).low == variance_interval(cell, floor=100.0).high == 0.0
    assert variance_interval(cell, floor=100.0).estimate < 0.0
    assert variance_interval(cell, ddof=1, floor=0.3).estimate == pytest.approx(
        variance_interval(cell, ddof=1).estimate - 0.3
    )


def test_the_number_of_independent_parts_is_estimated() -> None:
    random = np.random.default_rng(2)
    uniform, fine = (variance_interval(study(6, 2, FIELDS[kind], random)).parts for kind in ("uniform", "fine"))
    assert uniform < 3.0
    assert fine > 30.0


def test_two_prints_have_a_very_wide_interval() -> None:
    random = np.random.default_rng(3)
    result = [variance_interval(study(2, 2, FIELDS["smooth"], random)) for _ in range(60)]
    assert all(interval.low <= truth(2, 2) <= interval.high for interval in result)
    assert np.median([interval.high / interval.estimate for interval in result]) > 100.0
    assert result[0].parts == 1.0


def test_one_print_is_refused_with_a_reason() -> None:
    cell = study(1, 2, FIELDS["smooth"], np.random.default_rng(4))
    with pytest.raises(InputError, match="without a second print"):
        variance_interval(cell)
    with pytest.raises(InputError, match="without a second print"):
        component_interval([cell], "print")
    assert cell.variance() > 0.0


def test_one_repeat_has_an_interval_but_no_components() -> None:
    random = np.random.default_rng(6)
    result = [variance_interval(study(6, 1, FIELDS["smooth"], random)) for _ in range(60)]
    assert sum(interval.low <= truth(6, 1) <= interval.high for interval in result) >= 51
    with pytest.raises(InputError, match="to separate prints from repeats"):
        component_interval([study(6, 1, FIELDS["smooth"], random)], "repeat")


def test_the_ratio_of_two_prints_to_two_repeats_has_an_interval() -> None:
    random = np.random.default_rng(9)
    cell = study(6, 2, FIELDS["fine"], random)
    repeat = cell.within / cell.dof[1]
    expected = 1.0 + (cell.between / cell.dof[0] - repeat) / 2.0 / repeat
    ratio = ratio_interval([cell])
    assert ratio.estimate == pytest.approx(expected) and ratio.low < expected < ratio.high
    with pytest.raises(InputError, match="to separate prints from repeats"):
        ratio_interval([study(6, 1, FIELDS["fine"], random)])


def test_components_are_pooled_over_cells_of_different_prints() -> None:
    random = np.random.default_rng(7)
    cells = [study(3, 2, FIELDS["smooth"], random) for _ in range(6)]
    alone, together = component_interval(cells[:1], "print"), component_interval(cells, "print")
    assert together.high - together.low < 0.5 * (alone.high - alone.low)
    assert together.low <= PRINT <= together.high
    squares, repeats = (
        sum(cell.between for cell in cells),
        sum(cell.within for cell in cells) / sum(cell.dof[1] for cell in cells),
    )
    expected = (squares - sum(cell.dof[0] for cell in cells) * repeats) / sum(cell.kappa for cell in cells)
    assert together.estimate == pytest.approx(expected)


@pytest.mark.parametrize("kind", mostly_long(["smooth", "coarse"], "smooth"))
def test_intervals_of_pooled_components_cover(kind: str) -> None:
    random, covered = np.random.default_rng(17), np.zeros(2)
    for _ in range(60):
        cells = [study(3, 2, FIELDS[kind], random) for _ in range(6)]
        result = [component_interval(cells, name) for name in ("print", "repeat")]
        covered += [
            interval.low <= value <= interval.high for interval, value in zip(result, (PRINT, REPEAT), strict=True)
        ]
    assert (covered >= 52).all()


def with_holes(random: np.random.Generator, field: Field, holes: float) -> CellSums:
    """Return a study of six prints and two repeats with randomly missing presses except at the first position."""
    copies = np.repeat(range(6), 2)
    values = field.draw(6, random)[copies] * math.sqrt(PRINT) + math.sqrt(REPEAT) * NOISE.draw(12, random)
    sums = []
    for p in range(values.shape[1]):
        there = np.ones(12, dtype=bool) if p == 0 else random.random(12) >= holes
        sums.append(CellSums.of(gram_of(list(values[there, p])), copies[there], design=copies))
    return pooled(sums)


def test_missing_presses_are_allowed() -> None:
    random = np.random.default_rng(8)
    cells = [with_holes(random, FIELDS["smooth"], 0.25) for _ in range(80)]
    assert all(cell.whole < cell.positions == 4 for cell in cells[:3])
    expected = np.mean([cell.weights[0, 0] @ [PRINT, REPEAT] / cell.positions for cell in cells])
    assert np.mean([cell.variance() for cell in cells]) == pytest.approx(expected, rel=0.1)
    result = [component_interval([cell], "print") for cell in cells]
    assert np.mean([interval.estimate for interval in result]) == pytest.approx(PRINT, rel=0.12)
    assert sum(interval.low <= PRINT <= interval.high for interval in result) >= 69


def test_without_a_complete_position_pixels_count_as_one() -> None:
    random, copies = np.random.default_rng(9), np.repeat(range(6), 2)
    sums = [
        CellSums.of(gram_of(list(random.standard_normal((11, 50)))), np.delete(copies, i), copies) for i in range(3)
    ]
    result = variance_interval(pooled(sums))
    assert result.parts == 1.0
    assert result.low < result.estimate < result.high


def test_a_force_level_with_fewer_prints_is_pooled() -> None:
    random = np.random.default_rng(12)
    six, three = study(6, 2, FIELDS["smooth"], random), study(3, 2, FIELDS["smooth"], random)
    for cell in (six + three, three + six):
        assert (cell.prints, cell.positions, cell.whole, cell.presses) == (6, 8, 4, 72)
        assert cell.variance() == pytest.approx((six.variance() + three.variance()) / 2.0)
        np.testing.assert_array_equal(cell.gram, six.gram)
        result = variance_interval(cell)
        assert result.low < result.estimate < result.high


def test_order_of_presses_and_seed_do_not_matter() -> None:
    random = np.random.default_rng(10)
    values, copies = list(random.standard_normal((12, 300))), np.repeat(range(6), 2)
    order = random.permutation(12)
    ordered = CellSums.of(gram_of(values), copies)
    shuffled = CellSums.of(gram_of([values[i] for i in order]), copies[order])
    np.testing.assert_allclose(ordered.print_gram(), shuffled.print_gram(), atol=1e-12)
    assert variance_interval(ordered) == variance_interval(ordered)
    first, second = (variance_interval(ordered, seed=seed) for seed in (0, 1))
    assert first.high == pytest.approx(second.high, rel=0.03)


def test_constant_frames_have_an_interval_of_zero() -> None:
    cell = CellSums.of(gram_of([np.full((4, 4), 9, dtype=np.uint8)] * 6), np.repeat(range(3), 2))
    result = variance_interval(cell)
    assert (result.estimate, result.low, result.high) == (0.0, 0.0, 0.0)
    assert isinstance(result, Interval)


def test_the_distance_of_a_print_from_the_others_is_that_of_their_mean_frames() -> None:
    random = np.random.default_rng(3)
    copies = np.array([1, 1, 2, 2, 5, 5, 5])
    frames = random.standard_normal((len(copies), 40)) + 3.0 * random.standard_normal((6, 40))[copies]
    distances = CellSums.of(gram_of(list(frames)), copies).from_others()
    assert list(distances) == [1, 2, 5]
    for copy, square in distances.items():
        own, others = frames[copies == copy].mean(axis=0), frames[copies != copy].mean(axis=0)
        assert square == pytest.approx(float(np.mean((own - others) ** 2)))
    assert CellSums.of(gram_of(list(frames[:2])), copies[:2]).from_others() == {}
