"""Test the permutation test between printers: its size for equal printers, its power and its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad.lab.analysis.variance.permutation import dispersion_test
from tacbench_cad.util.types import Floats

#: The decreasing standard deviations of 30 parts of an image; they count as about four independent parts.
PARTS = 0.6 ** (np.arange(30) / 2.0)


def prints(count: int, random: np.random.Generator, scale: float = 1.0) -> Floats:
    return scale * PARTS * random.standard_normal((count, len(PARTS)))


def centred_gram(values: Floats) -> Floats:
    deviations = values - values.mean(axis=0)
    return np.asarray(deviations @ deviations.T)


def dispersion_p(k: int, textures: int, random: np.random.Generator, scale: float = 1.0) -> float:
    grams = [[centred_gram(prints(k, random, s)) for _ in range(textures)] for s in (scale, 1.0)]
    return dispersion_test(grams[0], grams[1], draws=199).p


@pytest.mark.parametrize("k", mostly_long([6, 3], 3))
def test_equal_printers_are_found_different_in_5_of_100_cases(k: int) -> None:
    random = np.random.default_rng(k)
    p = np.array([dispersion_p(k, 6, random) for _ in range(300)])
    assert 0.02 <= (p <= 0.05).mean() <= 0.09
    assert 0.13 <= (p <= 0.20).mean() <= 0.27


def test_a_printer_that_varies_twice_as_much_is_found() -> None:
    random = np.random.default_rng(1)
    assert np.mean([dispersion_p(6, 6, random, math.sqrt(2.0)) <= 0.05 for _ in range(40)]) > 0.8


def test_the_ratio_of_variances_has_the_first_printer_in_the_numerator() -> None:
    random = np.random.default_rng(2)
    first, second = ([centred_gram(prints(6, random, scale)) for _ in range(6)] for scale in (2.0, 1.0))
    result = dispersion_test(first, second)
    assert result.ratio is not None and 2.5 < result.ratio < 6.0
    assert result.statistic > 0.3 and result.p < 0.001
    assert result.textures == 6 and (result.prints_first, result.prints_second) == (36, 36)
    turned = dispersion_test(second, first)
    assert turned.statistic == pytest.approx(-result.statistic)
    assert turned.ratio == pytest.approx(1.0 / result.ratio)


def test_the_order_of_prints_does_not_matter() -> None:
    random = np.random.default_rng(3)
    first, second = ([centred_gram(prints(6, random, scale)) for _ in range(3)] for scale in (1.3, 1.0))
    order = random.permutation(6)
    turned = [gram[np.ix_(order, order)] for gram in first]
    plain, reordered = (dispersion_test(grams, second) for grams in (first, turned))
    assert plain.statistic == pytest.approx(reordered.statistic)
    assert plain.p == pytest.approx(reordered.p, abs=0.02)
    assert dispersion_test(first, second) == plain


def test_the_smallest_p_of_a_small_design_is_reported() -> None:
    random = np.random.default_rng(6)
    three = [[centred_gram(prints(3, random, scale))] for scale in (50.0, 1.0)]
    result = dispersion_test(three[0], three[1])
    assert result.least_p == pytest.approx(2.0 / 6.0)
    assert result.p > 0.25


def test_prints_without_variation_are_not_different() -> None:
    zero = [np.zeros((3, 3))]
    result = dispersion_test(zero, zero)
    assert (result.statistic, result.ratio, result.p) == (0.0, None, 1.0)


def test_unequal_numbers_of_prints_are_allowed() -> None:
    random = np.random.default_rng(7)
    p = [
        dispersion_test([centred_gram(prints(6, random))] * 1, [centred_gram(prints(3, random))], draws=99).p
        for _ in range(100)
    ]
    assert np.mean(np.array(p) <= 0.1) < 0.2
