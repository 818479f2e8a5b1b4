"""Intervals of a cell's variance with prints as the unit.

**Estimated quantity.** Let sigma_P^2 be the variance between prints and sigma_e^2 the variance between repeats on one
print, both means over pixels and positions. The table's figure V (ddof 0, k prints with R repeats, mean over pixels and
positions) estimates::

    E[V] = (1 - 1/k) sigma_P^2 + (1 - 1/(k R)) sigma_e^2

This is the mean of V over many repetitions of the study with k new prints. The interval covers this number. With ddof 1
the factors are (1 - (R-1)/(kR-1)) and 1. The floor-removed version is E[V] minus the noise floor times (1 - 1/(k R)),
or minus the noise floor for ddof 1. The noise floor is treated as known, because it is computed from many more frames
than there are prints.

**Input from the streaming pass.** Each cell (printer-filament, texture) has at each force level and position a Gram
matrix of its presses, shape (n, n), and the copy number of each press, shape (n,). ``gram[i, j]`` is the mean over
pixels of the product of the deviations of presses i and j from the mean over the cell's presses.
``streaming.moments`` computes it. In the paper's design n is 12, and only the frames of one cell at one position are in
memory. ``CellSums.of(gram, prints, design)`` stores it, and ``+`` pools positions and force levels. These are not
independent, because they belong to the same prints; they are therefore treated as additional pixels.

**Method.** Pixels and positions of one print vary together. Therefore a mean square of prints is not chi-squared with
pixels x (k-1) degrees of freedom. In Satterthwaite's approximation (1946) it has nu x (k-1) degrees of freedom, where
nu = (tr S)^2 / tr(S^2) of the covariance S over pixels is the number of independent parts of an image: 1 if all pixels
vary together. nu is estimated from the same few prints, so its error must be part of the interval. For n contrasts with
nu equal parts, the fraction::

    u = (tr(G^2) / (tr G)^2 - 1/n) / (1 - 1/n)

of the contrasts' Gram matrix G approximately follows Beta(a, b), a = (n-1)(n+2)/4, b = a n (nu-1)/(n+2), independently
of tr G (exactly for n = 2; its mean is exact for every n). The part of G that comes from repeats is subtracted first.

The interval is a fiducial generalized confidence interval (Hannig, Iyer and Patterson 2006, J. Am. Stat. Assoc. 101,
254-269). nu is the solution of P(U <= u | nu) = V for uniform V. Let B and W be the sums of squares between and within
prints, d_B and d_W their degrees of freedom, and each Q a chi-squared variable divided by its degrees of freedom. The
generalized pivotal quantities of the nested design (Weerahandi 1993, J. Am. Stat. Assoc. 88, 899-905) give both
components::

    sigma_e^2 = W / (d_W Q_W),     sigma_P^2 = max(0, (B - d_B sigma_e^2 Q_e) / (kappa Q_P))

and from them E[V]. kappa is the coefficient of sigma_P^2 in E[B]. The ends of the interval are quantiles of the draws.
Cells with different prints are pooled before the draws: B, W, n and a are added, and so are the estimated variances of
the traces.

**Measured coverage** of the 95 % intervals: 92 to 97 %, and 87 to 93 % for three prints whose pixels vary together
(tests/lab/analysis/test_intervals.py: 500 studies for each of 6 and 3 prints, four fields from fine grain to an image
whose pixels all vary together, and repeats with 0.1, 0.5 and 2 times the variance of prints).

**Why there is no closed form.** The modified large sample intervals of Graybill and Wang (1980) and of Ting et al.
(1990; both in Burdick and Graybill 1992, Confidence Intervals on Variance Components) need known degrees of freedom.
With Satterthwaite's estimate, corrected for bias as in Huynh and Feldt (1976), they cover 72 to 94 % in the same
studies. With the conservative estimate of Greenhouse and Geisser (1959) they cover 93 to 100 %, but then the upper end
for three prints and a coarse field is 10 times the true value. With the method used here it is 4 times the true value.

**Few prints.**

- With k = 1, nothing is known about other prints, and the function raises an error.
- With k = 2, there is one contrast, from which nu cannot be estimated. It is set to 1, so the coverage is above 95 %,
  and the upper end is hundreds of times the estimate.
- With k = 3, single intervals are sometimes much too narrow or too wide; only the coverage over many studies is right.
- With one repeat, the two components cannot be separated, and the interval is for prints and repeats together.
- If no position has all presses, nu is set to 1.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import reduce
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Ints

#: The samples of a variance: all presses at a position, or the repeats on each print.
OF_ALL, OF_REPEATS = 0, 1
#: The number of draws for an interval. The ends then differ by less than 1 % between seeds; with two prints, by 10 %.
DRAWS = 10_000
#: The quantiles of the draws that are the ends of the interval.
TAILS = (0.025, 0.975)
#: The grid of values of log(nu - 1) from which nu is drawn.
_LOG_NU_MINUS_1 = np.linspace(math.log(1e-3), math.log(1e6), 1500)
#: The smallest fraction of the variance of the prints' trace that remains after subtracting the part of the repeats.
_MIN_LEFT = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class CellSums:
    """The sums of one cell that an interval needs, for one position or for several positions added up.

    Args:
        design: The copy number of each press at a complete position, sorted, shape (n,). If two designs are added, the
            larger one is kept.
        gram: The sum of the Gram matrices of the complete positions, shape (n, n), presses in the order of ``design``.
        positions: The number of positions (times force levels).
        whole: The number of complete positions, at which no press is missing. Only they show how pixels vary together.
        repeated: The number of prints that were pressed more than once, summed over positions.
        presses: The number of presses.
        between: The sum of squares between prints, summed over positions.
        within: The sum of squares within prints, summed over positions.
        dof: The degrees of freedom between and within prints, summed over positions, shape (2,).
        kappa: The coefficient of sigma_P^2 in ``between``.
        variances: A row for each quantity, with entries for ddof 0 and 1, shape (2, 2). For :data:`OF_ALL` it is the
            variance of all presses, summed over positions; with ddof 1, NaN if a position has one press. For
            :data:`OF_REPEATS` it is the variance of the repeats on a print, summed over positions and over prints that
            were pressed more than once.
        weights: The coefficients of sigma_P^2 and sigma_e^2 in ``variances``, shape (2, 2, 2).
    """

    design: Ints
    gram: Floats
    positions: int
    whole: int
    repeated: int
    presses: int
    between: float
    within: float
    dof: Ints
    kappa: float
    variances: Floats
    weights: Floats

    @classmethod
    def of(cls, gram: ArrayLike, prints: ArrayLike, design: ArrayLike | None = None) -> CellSums:
        """Make the sums of one position.

        Args:
            gram: The products of the presses' deviations from their mean, mean over pixels, shape (n, n).
            prints: The copy number of each press, shape (n,).
            design: The copy numbers at a complete position; None if this position is complete.
        """
        products, copies = np.asarray(gram, dtype=np.float64), np.asarray(prints, dtype=np.int64)
        n = len(copies)
        order = np.argsort(copies, kind="stable")
        copies, products = copies[order], products[np.ix_(order, order)]
        expected = copies if design is None else np.sort(np.asarray(design, dtype=np.int64))
        _, starts, counts = np.unique(copies, return_index=True, return_counts=True)
        sizes = counts.astype(np.float64)
        k = len(sizes)
        total = float(np.trace(products))
        between = float(np.trace(_between(products, copies)))
        kappa = n - float((sizes**2).sum()) / n
        whole = np.array_equal(copies, expected)
        divisors = np.array([n, n - 1.0 if n > 1 else np.nan])
        sums = np.add.reduceat(np.add.reduceat(products, starts, axis=0), starts, axis=1)
        squares = np.maximum(0.0, np.add.reduceat(np.diag(products), starts) - np.diag(sums) / sizes)
        more = sizes > 1
        of_repeats = np.stack([squares[more] / sizes[more], squares[more] / (sizes[more] - 1.0)]).sum(axis=1)
        seen = np.array([(1.0 - 1.0 / sizes[more]).sum(), more.sum()])
        return cls(
            design=expected,
            gram=products if whole else np.zeros((len(expected), len(expected))),
            positions=1,
            whole=int(whole),
            repeated=int(more.sum()),
            presses=n,
            between=between,
            within=max(0.0, total - between),
            dof=np.array([k - 1, n - k]),
            kappa=kappa,
            variances=np.stack([total / divisors, of_repeats]),
            weights=np.stack([np.array([kappa, n - 1.0]) / divisors[:, None], np.stack([0.0 * seen, seen], axis=1)]),
        )

    def __add__(self, other: CellSums) -> CellSums:
        # If one force level has fewer prints, its positions are not complete positions of the larger design.
        larger, smaller = (self, other) if len(self.design) >= len(other.design) else (other, self)
        complete = {name: getattr(larger, name) for name in ("design", "gram", "whole")}
        if np.array_equal(self.design, other.design):
            complete |= {name: getattr(larger, name) + getattr(smaller, name) for name in ("gram", "whole")}
        others = (name for name in vars(self) if name not in complete)
        return CellSums(**complete, **{name: getattr(self, name) + getattr(other, name) for name in others})

    @property
    def prints(self) -> int:
        """The number of prints in the cell, k."""
        return len(np.unique(self.design))

    def counts(self, quantity: int) -> int:
        """Return the number of terms in a quantity's mean: positions, or positions of repeatedly pressed prints."""
        return self.positions if quantity == OF_ALL else self.repeated

    def variance(self, ddof: int = 0, quantity: int = OF_ALL) -> float:
        """Return the table's figure: the variance over the presses at a position, mean over pixels and positions.

        It is NaN for ``ddof`` 1 if a position has one press.

        Args:
            ddof: 0 or 1.
            quantity: :data:`OF_ALL`, or :data:`OF_REPEATS` for the variance over the repeats on each print; its mean is
                also over prints.
        """
        return float(self.variances[quantity, ddof]) / self.counts(quantity)

    def print_gram(self) -> Floats:
        """Return the Gram matrix (k, k) of the prints' mean deviations times sqrt(repeats), at complete positions."""
        return _between(self.gram, self.design)

    def from_others(self) -> dict[int, float]:
        """Return how far each print is from the other prints, by its copy number.

        It is the mean square, over pixels and complete positions, of the difference between the mean of the print's
        presses and the mean of all other presses. It also contains sensor noise, which is the same for all prints.
        """
        copies, presses = np.unique(self.design, return_counts=True)
        if len(copies) < 2 or self.whole == 0:
            return {}
        # The distance from all other presses is larger than the distance from the mean of all presses.
        larger = len(self.design) / (len(self.design) - presses)
        squares = np.diag(self.print_gram()) / presses / self.whole * larger**2
        return dict(zip(copies.tolist(), squares.tolist(), strict=True))


def pooled(levels: Sequence[CellSums]) -> CellSums | None:
    """Add the sums of several force levels; return None if the levels have different prints or repeats."""
    if any(not np.array_equal(level.design, levels[0].design) for level in levels):
        return None
    return reduce(operator.add, levels)


def _means(copies: Ints) -> Floats:
    """Return the matrix that converts presses to the means of their prints, shape (k, n)."""
    members = copies[None, :] == np.unique(copies)[:, None]
    return np.asarray(members / members.sum(axis=1, keepdims=True))


def _between(gram: Floats, copies: Ints) -> Floats:
    means = _means(copies)
    weights = np.sqrt((means > 0).sum(axis=1))
    taken = weights[:, None] * (means - 1.0 / len(copies))
    return np.asarray(taken @ gram @ taken.T)


def _within(gram: Floats, copies: Ints) -> Floats:
    means = _means(copies)
    taken = np.eye(len(copies)) - (means > 0).T.astype(np.float64) @ means
    return np.asarray(taken @ gram @ taken.T)


@dataclass(frozen=True, kw_only=True)
class Interval:
    """An estimate with the ends of its 95 % interval.

    Args:
        estimate: The unbiased estimate of the covered quantity; for a balanced cell it is the table's figure.
        low: The lower end, never below 0.
        high: The upper end.
        parts: The number of independent parts of an image (nu), median of the draws.
    """

    estimate: float
    low: float
    high: float
    parts: float

    @property
    def ends(self) -> tuple[float, float]:
        """The lower and the upper end."""
        return self.low, self.high


def variance_interval(
    cell: CellSums, *, ddof: int = 0, floor: float = 0.0, seed: int = 0, quantity: int = OF_ALL
) -> Interval:
    """Compute the interval of a cell's variance, or of its variance with the noise floor removed.

    Args:
        cell: The sums of the cell, with its positions (and force levels) added up.
        ddof: The ddof of the variance, 0 or 1.
        floor: The noise floor to remove, a variance with ddof 1 in the squared unit of the frames; 0 removes nothing.
        seed: The seed of the draws.
        quantity: :data:`OF_ALL` or :data:`OF_REPEATS`.

    Raises:
        InputError: There is only one print.
    """
    of_print, of_repeat = cell.weights[quantity, ddof] / cell.counts(quantity)
    return _interval([cell], float(of_print), float(of_repeat), float(of_repeat) * floor, seed)


def component_interval(cells: Sequence[CellSums], component: Literal["print", "repeat"], *, seed: int = 0) -> Interval:
    """Compute the interval of the component of prints or of repeats, pooled over cells with different prints.

    Args:
        cells: The sums of the cells, each with its positions added up.
        component: The component.
        seed: The seed of the draws.

    Raises:
        InputError: No cell has two prints, or there is one repeat and the two components cannot be separated.
    """
    _require_repeats(cells)
    return _interval(cells, float(component == "print"), float(component == "repeat"), 0.0, seed)


def ratio_interval(cells: Sequence[CellSums], *, seed: int = 0) -> Interval:
    """Compute the interval of the variance of two prints over the one of two repeats, 1 + sigma_P^2 / sigma_e^2.

    Args:
        cells: Same as for :func:`component_interval`.
        seed: The seed of the draws.

    Raises:
        InputError: Same as for :func:`component_interval`.
    """
    _require_repeats(cells)
    drawn = _Draws.of(cells, seed)
    low, high = (1.0 + float(end) for end in np.quantile(_over(drawn.prints, drawn.repeats), TAILS))
    estimate = 1.0 + float(_over(np.array(drawn.mean_print), np.array(drawn.mean_repeat)))
    return Interval(estimate=estimate, low=low, high=high, parts=drawn.parts)


def _over(prints: Floats, repeats: Floats) -> Floats:
    """Divide a component by another; 0 / 0 is 0."""
    with np.errstate(divide="ignore"):
        return np.divide(prints, repeats, out=np.zeros_like(repeats), where=(prints != 0.0) | (repeats != 0.0))


def _require_repeats(cells: Sequence[CellSums]) -> None:
    """Check that the components of prints and repeats can be separated.

    Raises:
        InputError: They cannot be separated.
    """
    if not sum(cell.dof[1] for cell in cells):
        raise InputError("repeats", 1, "must be at least 2 to separate prints from repeats; press each position twice")


def _interval(cells: Sequence[CellSums], of_print: float, of_repeat: float, floor: float, seed: int) -> Interval:
    """Compute the interval of ``of_print sigma_P^2 + of_repeat sigma_e^2 - floor``, pooled over cells."""
    drawn = _Draws.of(cells, seed)
    draws = of_print * drawn.prints + of_repeat * drawn.repeats - floor
    low, high = (max(0.0, float(end)) for end in np.quantile(draws, TAILS))
    estimate = of_print * drawn.mean_print + of_repeat * drawn.mean_repeat - floor
    return Interval(estimate=estimate, low=low, high=high, parts=drawn.parts)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Draws:
    """Draws of both components, pooled over cells, and their unbiased estimates.

    Args:
        prints: The draws of sigma_P^2, (DRAWS,).
        repeats: The draws of sigma_e^2. Without repeats they are 0, and sigma_e^2 is part of sigma_P^2, because both
            have the same coefficients.
        mean_print: The estimate of sigma_P^2.
        mean_repeat: The estimate of sigma_e^2.
        parts: The number of independent parts of an image, median of the draws.
    """

    prints: Floats
    repeats: Floats
    mean_print: float
    mean_repeat: float
    parts: float

    @classmethod
    def of(cls, cells: Sequence[CellSums], seed: int) -> _Draws:
        """Draw both components.

        Raises:
            InputError: No cell has two prints.
        """
        prints = max((cell.prints for cell in cells), default=0)
        if prints < 2:
            raise InputError("prints", prints, "must be at least 2: without a second print there is no interval")
        random = np.random.default_rng(seed)
        between, within, kappa = (sum(getattr(cell, name) for cell in cells) for name in ("between", "within", "kappa"))
        dof_between, dof_within = (sum(cell.dof[i] for cell in cells) for i in range(2))
        of_prints, of_repeats = (sum(traces, _NOTHING) for traces in zip(*map(_traces, cells), strict=True))
        nu_print, nu_repeat = of_prints.draw_parts(random), of_repeats.draw_parts(random)
        n_print, n_repeat = max(1, of_prints.contrasts), max(1, of_repeats.contrasts)
        repeat = between_repeats = np.zeros(DRAWS)
        if dof_within:
            repeat = within / dof_within / _chi2_ratio(n_repeat * nu_repeat, random)
            between_repeats = dof_between * repeat * _chi2_ratio(n_print * nu_repeat, random)
        ratio = _chi2_ratio(n_print * nu_print, random)
        mean_repeat = within / dof_within if dof_within else 0.0
        return cls(
            prints=np.maximum(0.0, (between - between_repeats) / ratio) / kappa,
            repeats=repeat,
            mean_print=(between - dof_between * mean_repeat) / kappa,
            mean_repeat=mean_repeat,
            parts=float(np.median(nu_print)),
        )


@dataclass(frozen=True)
class _Traces:
    """The traces of a Gram matrix of contrasts, or of several matrices added up, from which nu is estimated.

    Args:
        contrasts: The number of contrasts, n.
        trace: tr G; for prints, without the part of the repeats.
        square: The estimate of ``n tr(S^2)``: half the variance of the trace.
        evidence: The degrees of freedom of ``square``, the a of the Beta distribution.
    """

    contrasts: int
    trace: float
    square: float
    evidence: float

    @classmethod
    def of(cls, gram: Floats, n: int) -> _Traces:
        """Compute the traces of one Gram matrix of n contrasts."""
        trace = float(np.trace(gram))
        if n < 2:
            # One contrast does not show how pixels vary together, so nu is set to 1.
            return cls(n, trace, n * trace**2 / 3.0, 0.0)
        weight = (n - 1.0) * (n + 2.0)
        return cls(n, trace, max(0.0, n * float((gram**2).sum()) - trace**2) / weight, weight / 4.0)

    def __add__(self, other: _Traces) -> _Traces:
        return _Traces(*map(operator.add, astuple(self), astuple(other)))

    def draw_parts(self, random: np.random.Generator) -> Floats:
        """Draw nu, shape (DRAWS,); it is 1 if it cannot be estimated."""
        from scipy.special import betainc

        if not self.evidence:
            return np.ones(DRAWS)
        n, a = self.contrasts, self.evidence
        u = min(1.0 - 1e-9, (n + 2) * self.square / self.trace**2) if self.trace > 0.0 else 1.0 - 1e-9
        below = betainc(a, a * n * np.exp(_LOG_NU_MINUS_1) / (n + 2), u)
        levels = (random.permutation(DRAWS) + 0.5) / DRAWS
        return 1.0 + np.exp(np.interp(levels, below, _LOG_NU_MINUS_1))


_NOTHING = _Traces(0, 0.0, 0.0, 0.0)


def _traces(cell: CellSums) -> tuple[_Traces, _Traces]:
    """Return the traces of the contrasts between prints, minus the mean part of the repeats, and those of repeats."""
    if not cell.whole:
        return _NOTHING, _NOTHING
    prints = _Traces.of(cell.print_gram(), cell.prints - 1)
    repeats = _Traces.of(_within(cell.gram, cell.design), len(cell.design) - cell.prints)
    if not repeats.contrasts:
        return prints, repeats
    fraction = prints.contrasts / repeats.contrasts
    square = prints.square
    if repeats.evidence:
        square = max(square - fraction * repeats.square, _MIN_LEFT * square)
    return _Traces(prints.contrasts, prints.trace - fraction * repeats.trace, square, prints.evidence), repeats


def _chi2_ratio(dof: Floats, random: np.random.Generator) -> Floats:
    """Draw a chi-squared variable divided by its degrees of freedom, for each entry."""
    return np.asarray(random.standard_gamma(dof / 2.0) / (dof / 2.0))
