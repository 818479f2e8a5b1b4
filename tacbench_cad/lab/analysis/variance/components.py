"""Variance components of the nested design: repeat within print, print within printer, printer within texture, texture.

Input from the streaming pass: at each force level and position there are n presses, and each pixel has one value for
each press. All sums are over presses, and all means over pixels, so the unit is the squared unit of the frames. There
are four sums of squares of nested means, outermost first::

    texture   sum over textures  t of n_t |mean_t - mean|^2
    printer   sum over printers  c of n_c |mean_c - mean of its texture|^2     (a "printer" is a printer-filament)
    print     sum over prints    b of n_b |mean_b - mean of its printer|^2
    repeat    sum over presses     of     |press  - mean of its print|^2

where ``|.|^2`` is the mean over pixels. They are computed by merging Welford accumulators in the order of nesting, with
one image in memory for each level of nesting. ``NestedSums.of(labels, squares)`` stores them with the labels of the
measured presses, and ``+`` pools positions (and force levels). The sums of squares, their expected coefficients and the
degrees of freedom are all added, so any presses may be missing.

Estimator: the expectation of each sum of squares is ``sum over levels of coefficient x component``. The components are
the solution of these equations (ANOVA estimators, Henderson's method 1; Searle, Casella and McCulloch, "Variance
Components", section 5.3). They are unbiased for any design, balanced or not. An unbiased estimate of a small component
is sometimes negative. It is reported unchanged, because setting it to 0 would make means over studies too large. The
field ``truncated`` is 0 in this case; standard deviations are computed from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tacbench_cad.util.types import Floats, Ints

#: The levels of the nesting, outermost first.
LEVELS = ("texture", "printer", "print", "repeat")
#: 95 % of the differences between two frames are below this many standard deviations (ISO 5725-6: 1.96 x sqrt(2)).
LIMIT_FACTOR = 2.8


@dataclass(frozen=True, kw_only=True, eq=False)
class NestedSums:
    """The sums of squares of one position, or of several positions added up.

    Args:
        squares: The sums of squares by level, shape (4,), in the order of :data:`LEVELS`.
        coefficients: The expected sums of squares for unit components, shape (4, 4), upper triangular. One unit of
            component l adds ``coefficients[m, l]`` to the expected sum of squares m.
        dof: The degrees of freedom by level, summed over positions, shape (4,).
    """

    squares: Floats
    coefficients: Floats
    dof: Ints

    @classmethod
    def of(cls, labels: ArrayLike, squares: ArrayLike) -> NestedSums:
        """Make the sums of one position.

        Args:
            labels: The texture, printer-filament and copy of each press as whole numbers, shape (n, 3). Copies and
                printers may be numbered from the start within each texture: all three numbers together identify a
                print.
            squares: The sums of squares by level, shape (4,).
        """
        members = _members(np.asarray(labels))
        totals = np.array(
            [[_coefficient(members[level], members[within]) for level in range(1, 5)] for within in range(5)]
        )
        counts = np.array([len(np.unique(member)) for member in members])
        return cls(
            squares=np.asarray(squares, dtype=np.float64),
            coefficients=np.triu(np.diff(totals, axis=0)),
            dof=np.diff(counts),
        )

    def __add__(self, other: NestedSums) -> NestedSums:
        return NestedSums(
            squares=self.squares + other.squares,
            coefficients=self.coefficients + other.coefficients,
            dof=self.dof + other.dof,
        )


def _members(labels: NDArray[Any]) -> list[Ints]:
    """Return the group of each press for the whole and for each level, 5 arrays (n,)."""
    n = len(labels)
    groups = [np.zeros(n, dtype=np.int64)]
    groups += [np.unique(labels[:, : depth + 1], axis=0, return_inverse=True)[1].reshape(n) for depth in range(3)]
    return [*groups, np.arange(n)]


def _coefficient(level: Ints, within: Ints) -> float:
    """Return the amount that one unit of a level's component adds to the sum over groups g of ``n_g |mean_g|^2``.

    For a level with groups h that are finer than g, it is the sum over g of ``sum over the h in g of n_h^2 / n_g``. A
    level that is as coarse as g, or coarser, is equal within each g; then it is n.
    """
    sizes, outer = np.bincount(level), np.bincount(within)
    parent = np.zeros(len(sizes), dtype=np.int64)
    parent[level] = within
    if len(sizes) < len(outer):
        return float(len(level))
    return float((sizes.astype(np.float64) ** 2 / outer[parent]).sum())


@dataclass(frozen=True, kw_only=True)
class Component:
    """One variance component.

    Args:
        name: The level, one of :data:`LEVELS`.
        variance: The unbiased estimate, which may be negative; None if the design does not allow an estimate.
        dof: The degrees of freedom of the level, summed over positions.
        includes: The finer levels that the design cannot separate from this level; the estimate includes them.
        note: The reason why there is no estimate, or a remark on it; empty otherwise.
    """

    name: str
    variance: float | None
    dof: int
    includes: tuple[str, ...] = ()
    note: str = ""

    @property
    def truncated(self) -> float | None:
        """The estimate, or 0 if it is negative."""
        return None if self.variance is None else max(0.0, self.variance)


def components(sums: NestedSums) -> tuple[Component, ...]:
    """Estimate the four components, outermost first.

    A level at which every group has one member (one print of each texture, one repeat, one printer) has no degree of
    freedom. Its variance is then part of the next coarser level that has some, and is listed in its ``includes``.

    Args:
        sums: The pooled sums of squares.
    """
    active = [i for i in range(4) if sums.dof[i] > 0]
    values = np.linalg.solve(sums.coefficients[np.ix_(active, active)], sums.squares[active]).tolist()
    solved = dict(zip(active, values, strict=True))
    result = []
    for i, name in enumerate(LEVELS):
        includes: tuple[str, ...] = ()
        if i in solved:
            nearest = next((j for j in active if j > i), 4)
            includes = LEVELS[i + 1 : nearest]
        note = "" if i in solved else _reason(i, active)
        if i in solved and solved[i] < 0.0:
            note = "negative: not distinguishable from 0"
        result.append(Component(name=name, variance=solved.get(i), dof=int(sums.dof[i]), includes=includes, note=note))
    return tuple(result)


def _reason(level: int, active: Sequence[int]) -> str:
    only = ("only one texture", "only one printer-filament", "only one print of each block", "only one repeat")[level]
    coarser = [LEVELS[j] for j in active if j < level]
    return f"{only}; included in the component of the {coarser[-1]}" if coarser else f"{only}; no estimate"


#: The standard deviations of ISO 5725 and their components: for the same print pressed again; for another print from
#: the same printer and filament; for another printer or filament. The "item" of the standard is the texture's design,
#: and its "laboratory" is a printer.
PRECISION: Mapping[str, tuple[str, ...]] = {
    "repeatability": ("repeat",),
    "intermediate": ("print", "repeat"),
    "reproducibility": ("printer", "print", "repeat"),
}


def precision(estimates: Sequence[Component]) -> dict[str, float | None]:
    """Return the standard deviations of :data:`PRECISION`, in the unit of the frames; None if one is unknown.

    A negative component counts as 0 (ISO 5725-2, 7.4.5.4). Each component of a sum must be known, either by itself or
    included in a coarser component that is also in the sum. Two single frames differ by less than
    :data:`LIMIT_FACTOR` standard deviations in 95 of 100 cases.

    Args:
        estimates: The four components of :func:`components`.
    """
    by_name = {component.name: component for component in estimates}
    deviations: dict[str, float | None] = {}
    for name, levels in PRECISION.items():
        parts = [by_name[level] for level in levels]
        covered = {level for part in parts if part.variance is not None for level in (part.name, *part.includes)}
        whole = covered == set(levels)
        deviations[name] = math.sqrt(sum(part.truncated or 0.0 for part in parts)) if whole else None
    return deviations


def component_rows(
    force_level: int | str,
    estimates: Sequence[Component],
    intervals: Mapping[str, tuple[float, float]] | None = None,
) -> list[dict[str, Any]]:
    """Return the rows of ``components.csv``: the components, then ISO 5725's variances (sums of truncated components).

    Args:
        force_level: The level from 1, or ``all``.
        estimates: The four components of :func:`components`.
        intervals: The low and high ends for components that have an interval (print and repeat). Printers and textures
            are few and deliberately chosen, so an interval of their components would have no meaning.
    """
    ends, nothing = intervals or {}, (None, None)
    rows: list[tuple[Any, ...]] = [
        (part.name, part.variance, part.truncated, *ends.get(part.name, nothing), part.dof, part.includes, part.note)
        for part in estimates
    ]
    for name, sd in precision(estimates).items():
        variance = None if sd is None else sd**2
        note = "" if sd is None else f"standard deviation {sd:.6g}, limit {LIMIT_FACTOR * sd:.6g} (ISO 5725)"
        rows.append((name, variance, variance, *nothing, None, (), note))
    heads = ("component", "variance", "truncated", "low", "high", "degrees_of_freedom", "includes", "note")
    return [
        {"force_level": force_level, **dict(zip(heads, row, strict=True)), "includes": " ".join(row[-2])}
        for row in rows
    ]
