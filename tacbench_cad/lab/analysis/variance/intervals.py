"""Intervals of a cell's variance with prints as the unit.

What is estimated. With sigma_P^2 the variance between prints and sigma_e^2 the variance between repeats on one print,
each a mean over pixels and positions, the table's figure V (ddof 0, k prints of R repeats, mean over pixels and
positions) estimates::

    E[V] = (1 - 1/k) sigma_P^2 + (1 - 1/(k R)) sigma_e^2

that is what the same statistic would be on average if the k prints were printed again. The interval covers this number.
With ddof 1 the factors are (1 - (R-1)/(kR-1)) and 1. The floor-removed version is E[V] less the floor times
(1 - 1/(k R)), 1 for ddof 1; the floor counts as known, since it comes from many more frames than there are prints.

What the streaming pass hands over. For each cell (printer-filament, texture) at each (force level, position): the Gram
matrix of the cell's presses, ``gram[i, j]`` = mean over pixels of the product of the deviations of presses i and j from
the mean over the cell's presses, shape (n, n), and the copy number of each press, shape (n,).
``streaming.moments`` makes it; n is 12 in the paper's design, and only the readings of one cell at one position are
held. ``CellSums.of(gram, prints, design)`` takes it and ``+`` pools positions and force levels, which are not
independent (the same prints) and are therefore treated as more pixels.

How. Pixels and positions of one print move together, so a mean square of prints is not chi-squared with pixels x (k-1)
degrees of freedom but, in Satterthwaite's approximation (1946), with nu x (k-1), where nu = (tr S)^2 / tr(S^2) of the
covariance S over pixels is the number of independent parts that an image has: 1 if all pixels move as one. nu is
estimated from the same few prints, so its error must be carried along. For n contrasts with nu equal parts, the
fraction::

    u = (tr(G^2) / (tr G)^2 - 1/n) / (1 - 1/n)

of the contrasts' Gram matrix G follows about Beta(a, b), a = (n-1)(n+2)/4, b = a n (nu-1)/(n+2), independently of tr G
(exactly for n = 2; its mean is exact for every n). What the repeats add to G is taken off first. The interval is a
fiducial generalized confidence interval (Hannig, Iyer and Patterson 2006, J. Am. Stat. Assoc. 101, 254-269): nu is the
solution of P(U <= u | nu) = V for uniform V, and with B and W the sums of squares between and within prints and each Q
a chi-squared variable over its degrees of freedom, the generalized pivotal quantities of the nested design (Weerahandi
1993, J. Am. Stat. Assoc. 88, 899-905) give both components::

    sigma_e^2 = W / (d_W Q_W),     sigma_P^2 = max(0, (B - d_B sigma_e^2 Q_e) / (kappa Q_P))

and so E[V]; the ends are quantiles of what is drawn. kappa is sigma_P^2's coefficient in E[B]. Cells of different
prints are pooled before anything is drawn: B, W, n and a add, and so do the estimated variances of the traces.

Measured coverage of the 95 % intervals: 92 to 97 %, and 87 to 93 % for three prints whose images move as one
(tests/lab/analysis/test_intervals.py: 500 studies for each of 6 and 3 prints, four fields from finely grained to an
image that moves as one, and repeats with 0.1, 0.5 and 2 times the variance of prints).

Why not an interval in closed form. The modified large sample intervals of Graybill and Wang (1980) and of Ting et al.
(1990; both in Burdick and Graybill 1992, Confidence Intervals on Variance Components) take the degrees of freedom as
known. With Satterthwaite's estimate put in, corrected for bias as Huynh and Feldt do (1976), they cover 72 to 94 % in
the same studies; with the cautious one of Greenhouse and Geisser (1959) 93 to 100 %, but then the upper end for three
prints and a coarse field lies at 10 times the true value, where it lies at 4 times here.

Few prints. With k = 1 nothing can be said of other prints: refused. With k = 2 there is one contrast, from which nu
cannot be seen; it is set to 1, so the interval covers more than it says and its upper end lies hundreds of times above
the estimate, which is the truth about two prints. With three, single intervals are now and then much too narrow or too
wide, and only the coverage is kept. With one repeat the two components cannot be told apart, and the interval is that
of prints and repeats together. Without a position that has all presses nu is set to 1.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Ints

#: What a variance is over: all presses of a place, or the repeats on each of its prints.
OF_ALL, OF_REPEATS = 0, 1
#: Draws behind an interval. From seed to seed the ends then move by less than 1 %, with two prints by some 10 %.
DRAWS = 10_000
#: Ends of the interval as quantiles of the draws.
TAILS = (0.025, 0.975)
#: Values of log(nu - 1) among which nu is drawn.
_LOG_NU_LESS_1 = np.linspace(math.log(1e-3), math.log(1e6), 1500)
#: Smallest fraction of the variance of the prints' trace that is left once what the repeats add is taken off.
_MIN_LEFT = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class CellSums:
    """What an interval needs to know of one cell, at one position or at many added up.

    Args:
        design: Copy number of each press of a whole position, sorted, shape (n,); of two designs the larger one.
        gram: Sum of the Gram matrices of the whole positions, presses in the order of ``design``, shape (n, n).
        positions: Positions (times force levels).
        whole: Positions at which no press is missing: only they show how pixels move together.
        repeated: Prints that were pressed more than once, summed over positions.
        presses: Presses.
        between: Sum over positions of the squares between prints.
        within: The same within prints.
        dof: Degrees of freedom between and within prints, summed over positions.
        kappa: Coefficient of sigma_P^2 in ``between``.
        variances: A row for each quantity, of two entries for ddof 0 and 1. :data:`OF_ALL`: sum over positions of the
            variance of all presses, NaN where a position has one. :data:`OF_REPEATS`: sum over positions and prints of
            the variance of the repeats on the print, where it was pressed more than once. Shape (2, 2).
        weights: Coefficients of sigma_P^2 and sigma_e^2 in ``variances``, shape (2, 2, 2).
    """

    design: Ints
    gram: Floats
    positions: int
    whole: int
    repeated: int
    presses: int
    between: float
    within: float
    dof: tuple[int, int]
    kappa: float
    variances: Floats
    weights: Floats

    @classmethod
    def of(cls, gram: ArrayLike, prints: ArrayLike, design: ArrayLike | None = None) -> CellSums:
        """The sums of one position.

        Args:
            gram: Mean over pixels of products of the presses' deviations from their mean, shape (n, n).
            prints: Copy number of each press, shape (n,).
            design: Copy numbers of a position without holes; None if this is one.
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
            dof=(k - 1, n - k),
            kappa=kappa,
            variances=np.stack([total / divisors, of_repeats]),
            weights=np.stack([np.array([kappa, n - 1.0]) / divisors[:, None], np.stack([0.0 * seen, seen], axis=1)]),
        )

    def __add__(self, other: CellSums) -> CellSums:
        # Where one force level was pressed on fewer prints, its positions are not whole ones of the larger design.
        larger, smaller = (self, other) if len(self.design) >= len(other.design) else (other, self)
        alike = np.array_equal(self.design, other.design)
        return CellSums(
            design=larger.design,
            gram=larger.gram + smaller.gram if alike else larger.gram,
            positions=self.positions + other.positions,
            whole=larger.whole + (smaller.whole if alike else 0),
            repeated=self.repeated + other.repeated,
            presses=self.presses + other.presses,
            between=self.between + other.between,
            within=self.within + other.within,
            dof=(self.dof[0] + other.dof[0], self.dof[1] + other.dof[1]),
            kappa=self.kappa + other.kappa,
            variances=self.variances + other.variances,
            weights=self.weights + other.weights,
        )

    @property
    def prints(self) -> int:
        """Prints in the cell, k."""
        return len(np.unique(self.design))

    def counts(self, quantity: int) -> int:
        """What a quantity is the mean over: positions, or positions of prints that were pressed more than once."""
        return self.positions if quantity == OF_ALL else self.repeated

    def variance(self, ddof: int = 0, quantity: int = OF_ALL) -> float:
        """The table's figure: variance over the presses of a position, then the mean over pixels and positions.

        NaN for ``ddof`` 1 where a position has one press.

        Args:
            ddof: 0 or 1.
            quantity: :data:`OF_ALL`, or :data:`OF_REPEATS` for the variance over the repeats on each print, then the
                mean over prints too.
        """
        return float(self.variances[quantity, ddof]) / self.counts(quantity)

    def print_gram(self) -> Floats:
        """Gram matrix of the prints' mean deviations over the whole positions, each times sqrt(repeats), (k, k)."""
        return _between(self.gram, self.design)


def _means(copies: Ints) -> Floats:
    """The matrix that takes presses to the means of their prints, shape (k, n)."""
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
        estimate: Unbiased estimate of what the interval covers; for a balanced cell the table's figure itself.
        low: Lower end, never below 0.
        high: Upper end.
        parts: Number of independent parts of an image (nu), median of the draws.
    """

    estimate: float
    low: float
    high: float
    parts: float


def variance_interval(
    cell: CellSums, *, ddof: int = 0, floor: float = 0.0, seed: int = 0, quantity: int = OF_ALL
) -> Interval:
    """Interval of a cell's variance, or of its variance with the noise floor removed.

    Args:
        cell: The cell, its positions (and force levels) added up.
        ddof: As for the variance.
        floor: Noise floor to remove, a variance with ddof 1 in the reading's unit squared; 0 removes nothing.
        seed: Seed of the draws.
        quantity: :data:`OF_ALL` or :data:`OF_REPEATS`.

    Raises:
        InputError: There is one print.
    """
    of_print, of_repeat = cell.weights[quantity, ddof] / cell.counts(quantity)
    return _interval([cell], float(of_print), float(of_repeat), float(of_repeat) * floor, seed)


def component_interval(cells: Sequence[CellSums], component: Literal["print", "repeat"], *, seed: int = 0) -> Interval:
    """Interval of the component of prints or of repeats, pooled over cells whose prints are different ones.

    Args:
        cells: Cells, each with its positions added up.
        component: Which of the two.
        seed: Seed of the draws.

    Raises:
        InputError: No cell has two prints, or there is one repeat and the two components cannot be told apart.
    """
    _require_repeats(cells)
    return _interval(cells, float(component == "print"), float(component == "repeat"), 0.0, seed)


def ratio_interval(cells: Sequence[CellSums], *, seed: int = 0) -> Interval:
    """Interval of how many times the variance of two repeats two prints show: (sigma_P^2 + sigma_e^2) / sigma_e^2.

    Args:
        cells: As for :func:`component_interval`.
        seed: Seed of the draws.

    Raises:
        InputError: As there.
    """
    _require_repeats(cells)
    drawn = _Draws.of(cells, seed)
    low, high = (1.0 + float(end) for end in np.quantile(_over(drawn.prints, drawn.repeats), TAILS))
    estimate = 1.0 + float(_over(np.array(drawn.mean_print), np.array(drawn.mean_repeat)))
    return Interval(estimate=estimate, low=low, high=high, parts=drawn.parts)


def _over(prints: Floats, repeats: Floats) -> Floats:
    """A component over another; 0 over 0 is 0."""
    with np.errstate(divide="ignore"):
        return np.divide(prints, repeats, out=np.zeros_like(repeats), where=(prints != 0.0) | (repeats != 0.0))


def _require_repeats(cells: Sequence[CellSums]) -> None:
    """Check that prints and repeats can be told apart.

    Raises:
        InputError: They cannot.
    """
    if not sum(cell.dof[1] for cell in cells):
        raise InputError("repeats", 1, "prints and repeats cannot be told apart; press each place at least twice")


def _interval(cells: Sequence[CellSums], of_print: float, of_repeat: float, floor: float, seed: int) -> Interval:
    """Interval of ``of_print sigma_P^2 + of_repeat sigma_e^2 - floor``, pooled over cells; see the module's text."""
    drawn = _Draws.of(cells, seed)
    draws = of_print * drawn.prints + of_repeat * drawn.repeats - floor
    low, high = (max(0.0, float(end)) for end in np.quantile(draws, TAILS))
    estimate = of_print * drawn.mean_print + of_repeat * drawn.mean_repeat - floor
    return Interval(estimate=estimate, low=low, high=high, parts=drawn.parts)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Draws:
    """Draws of both components, pooled over cells, and their unbiased estimates.

    Args:
        prints: Draws of sigma_P^2, (DRAWS,).
        repeats: Draws of sigma_e^2; 0 without repeats, where it is in sigma_P^2, with which it shares its coefficients.
        mean_print: Estimate of sigma_P^2.
        mean_repeat: Estimate of sigma_e^2.
        parts: Number of independent parts of an image, median of the draws.
    """

    prints: Floats
    repeats: Floats
    mean_print: float
    mean_repeat: float
    parts: float

    @classmethod
    def of(cls, cells: Sequence[CellSums], seed: int) -> _Draws:
        """Draw them.

        Raises:
            InputError: No cell has two prints.
        """
        prints = max((cell.prints for cell in cells), default=0)
        if prints < 2:
            what = "an interval needs at least 2 prints: one print says nothing about others"
            raise InputError("prints", prints, what)
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
    """What a Gram matrix of contrasts, or several of different prints added up, say of nu.

    Args:
        contrasts: Contrasts, n.
        trace: tr G, for prints without what repeats add to it.
        square: Estimate of ``n tr(S^2)``: half the variance of the trace.
        evidence: Degrees of freedom of ``square``, the a of the Beta distribution.
    """

    contrasts: int
    trace: float
    square: float
    evidence: float

    @classmethod
    def of(cls, gram: Floats, n: int) -> _Traces:
        """The traces of one Gram matrix of n contrasts."""
        trace = float(np.trace(gram))
        if n < 2:
            # One contrast does not show how pixels move together: as one, then.
            return cls(n, trace, n * trace**2 / 3.0, 0.0)
        weight = (n - 1.0) * (n + 2.0)
        return cls(n, trace, max(0.0, n * float((gram**2).sum()) - trace**2) / weight, weight / 4.0)

    def __add__(self, other: _Traces) -> _Traces:
        return _Traces(*map(operator.add, astuple(self), astuple(other)))

    def draw_parts(self, random: np.random.Generator) -> Floats:
        """Draws of nu, shape (DRAWS,); 1 where it cannot be seen."""
        from scipy.special import betainc

        if not self.evidence:
            return np.ones(DRAWS)
        n, a = self.contrasts, self.evidence
        u = min(1.0 - 1e-9, (n + 2) * self.square / self.trace**2) if self.trace > 0.0 else 1.0 - 1e-9
        below = betainc(a, a * n * np.exp(_LOG_NU_LESS_1) / (n + 2), u)
        levels = (random.permutation(DRAWS) + 0.5) / DRAWS
        return 1.0 + np.exp(np.interp(levels, below, _LOG_NU_LESS_1))


_NOTHING = _Traces(0, 0.0, 0.0, 0.0)


def _traces(cell: CellSums) -> tuple[_Traces, _Traces]:
    """The traces of the contrasts between prints, less what the repeats add to them on average, and of the repeats."""
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
    """Chi-squared over its degrees of freedom, a draw for each entry."""
    return np.asarray(random.standard_gamma(dof / 2.0) / (dof / 2.0))
