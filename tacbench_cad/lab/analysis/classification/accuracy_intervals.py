"""The 95 % intervals of accuracies, with one model for all rows of a table.

Presses of one print are alike: if one of them is predicted correctly, so are most of the others. The model has one
number for this, the correlation of two presses of one print. It is estimated once, from all textures together
(:func:`correlation_of`), and every row of the table uses it (:func:`interval_of`). Two rows of the same design
therefore differ only in their accuracy, and the row with the higher accuracy has the higher interval.

- The variance of an accuracy is ``p (1 - p) / n``, multiplied by the design effect ``1 + correlation (m - 1)``, for n
  presses with m on each print (Kish 1965). The interval is Jeffreys' binomial interval for n divided by the design
  effect.
- The correlation is estimated from few prints, so its upper estimate is used: the design effect is multiplied by
  (t / z)^2. The degrees of freedom of t are those of Satterthwaite, reduced because the accuracies of prints have long
  tails near 0 and 100 %.
- This upper estimate is at most :data:`ASSUMED`, unless the data show a larger correlation. If all presses are correct,
  nothing is known about the correlation, and it is :data:`ASSUMED`.

``benchmarks/accuracy_intervals.py`` measures how often the intervals contain the true accuracy, for correlations from 0
to 0.3 and beta-distributed accuracies of the prints. The groups of other hold-out levels, such as sessions, take the
place of the prints there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tacbench_cad.util.types import Floats, Ints

#: The confidence level of the intervals.
CONFIDENCE = 0.95
#: The correlation of the presses of one print if the data do not show a larger one.
ASSUMED = 0.4
#: An interval wider than this says nothing: there are too few groups.
WIDEST = 0.8
#: The words for a missing interval.
TOO_FEW = "too few groups"
#: The weight of :data:`ASSUMED` in the estimate, in wrong presses. Half a press hardly counts beside real errors.
_WEIGHT = 0.5
#: The fraction of the excess kurtosis of the prints' accuracies that reduces the degrees of freedom. With 1 the
#: intervals contain the true accuracy too often, with 0 too rarely (at accuracies near 95 %, in the benchmark).
_TAILS = 0.5
#: The smallest design effect. Balanced positions can make prints more alike than chance would.
_SMALLEST = 0.7


def correlation_of(
    correct: ArrayLike, tries: ArrayLike, units: NDArray[np.generic], textures: NDArray[np.generic]
) -> float | None:
    """Estimate the correlation of the presses of one unit, for the intervals of all rows of a table.

    Units of different textures may differ for another reason, so only units of the same texture are compared. If a
    unit has presses of several textures, such as a position, the textures are ignored.

    Args:
        correct: The number of correct predictions of each press, (n,).
        tries: The number of tests of each press, (n,), at least 1.
        units: The unit of each press, (n,): its print, for example.
        textures: The texture of each press, (n,).

    Returns:
        The upper estimate; None if there are not enough units for an estimate.
    """
    from scipy import stats

    _, unit = np.unique(units, return_inverse=True)
    stratum = np.unique(textures, return_inverse=True)[1]
    of_unit = np.zeros(unit.max() + 1, dtype=np.int64)
    of_unit[unit] = stratum
    if np.any(of_unit[unit] != stratum):
        of_unit[:], stratum = 0, np.zeros_like(stratum)
    size = np.bincount(unit).astype(np.float64)
    hits, tested = np.bincount(unit, correct), np.bincount(unit, tries)

    def total(values: Floats | Ints | None) -> Floats:
        """Add values of units for each texture; count the units without an argument."""
        return np.bincount(of_unit, values, stratum.max() + 1).astype(np.float64)

    presses, dof = total(size), np.maximum(total(None) - 1.0, 0.0)
    if dof.sum() < 2.0:
        return None
    mean_size = float(np.sum(presses - total(size**2) / presses) / dof.sum())
    if mean_size <= 1.0:
        return 0.0
    fraction = total(hits) / total(tested)
    squares = total(size * (hits / tested - fraction[of_unit]) ** 2)
    # The variance of one press. The second term is the part that the variance of `fraction` takes away.
    single = fraction * (1.0 - fraction) + squares / np.maximum(dof, 1.0) / presses
    known = float(np.sum(dof * single))
    assumed, weight = 1.0 + ASSUMED * (mean_size - 1.0), _WEIGHT / float(presses[dof > 0.0].mean())
    effect = (squares.sum() + weight * assumed) / (known + weight)
    upper = assumed
    if known > 0.0:
        tails = _excess_kurtosis(fraction, presses, (effect - 1.0) / (mean_size - 1.0))
        parts = dof * single / known
        uncertainty = float(np.sum(parts * single) / known + _TAILS / 2.0 * np.sum(parts**2 * tails / (dof + 1.0)))
        beyond = (1.0 + CONFIDENCE) / 2.0
        t = float(stats.t.ppf(beyond, max(1.0, 1.0 / uncertainty)))
        upper = effect * (t / float(stats.norm.ppf(beyond))) ** 2
    return float((max(effect, min(upper, assumed)) - 1.0) / (mean_size - 1.0))


def _excess_kurtosis(fraction: Floats, presses: Floats, correlation: float) -> Floats:
    """Return the excess kurtosis of beta-distributed accuracies of prints, at least 0, (k,)."""
    mean = np.clip(fraction, 0.5 / presses, 1.0 - 0.5 / presses)
    s = 1.0 / min(max(correlation, 1e-3), 0.9) - 1.0
    a, b = mean * s, (1.0 - mean) * s
    above = 6.0 * ((a - b) ** 2 * (s + 1.0) - a * b * (s + 2.0))
    return np.maximum(above / (a * b * (s + 2.0) * (s + 3.0)), 0.0)


def interval_of(fraction: float, sizes: ArrayLike, correlation: float | None) -> tuple[float | None, float | None]:
    """Compute the 95 % interval of an accuracy.

    With equal sizes and correlation, neither end falls if the accuracy rises.

    Args:
        fraction: The accuracy, from 0 to 1.
        sizes: The number of presses of each unit, (k,).
        correlation: The correlation of the presses of one unit, from :func:`correlation_of`; None if it is unknown.

    Returns:
        The lower and the upper end. They are None if there are too few groups, that is, fewer than two, or so few that
        the interval would be wider than :data:`WIDEST`.
    """
    from scipy import stats

    size = np.asarray(sizes, dtype=np.float64)
    if correlation is None or len(size) < 2:
        return None, None
    presses = float(size.sum())
    mean_size = float(np.sum(size**2)) / presses
    effective = presses / min(max(1.0 + correlation * (mean_size - 1.0), _SMALLEST), mean_size)
    outside = (1.0 - CONFIDENCE) / 2.0
    low, high = stats.beta.ppf([outside, 1.0 - outside], fraction * effective + 0.5, (1.0 - fraction) * effective + 0.5)
    low, high = 0.0 if fraction == 0.0 else float(low), 1.0 if fraction == 1.0 else float(high)
    return (low, high) if high - low <= WIDEST else (None, None)
