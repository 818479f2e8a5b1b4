"""Variance components of the nested design: repeat within print, print within printer, printer within texture, texture.

What the streaming pass hands over. For each (force level, position), with n presses, each pixel holds one value a
press; all sums are over presses and means over pixels (so the unit is the reading's, squared). The four sums of squares
are those of nested means, outermost first::

    texture   sum over textures  t of n_t |mean_t - mean|^2
    printer   sum over printers  c of n_c |mean_c - mean of its texture|^2     (a "printer" is a printer-filament)
    print     sum over prints    b of n_b |mean_b - mean of its printer|^2
    repeat    sum over presses     of     |press  - mean of its print|^2

where ``|.|^2`` is the mean over pixels. They come out of merging Welford accumulators in the order of nesting and need
one image for each level of nesting. ``NestedSums.of(labels, squares)`` takes them with the labels of the presses that
were there, and ``+`` pools positions (and force levels): sums of squares, their expected coefficients and degrees of
freedom all add, so presses may be missing anywhere.

Estimator: each sum of squares has expectation ``sum over levels of coefficient x component``, and the components are
what solves these equations (ANOVA estimators, Henderson's method 1; Searle, Casella and McCulloch, "Variance
Components", section 5.3). They are unbiased for any design, balanced or not. An unbiased estimate of a small component
is negative now and then: it is reported as estimated, since cutting it at 0 would make means over studies too large,
and beside it ``truncated``, which is what standard deviations are made of.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tacbench_cad.util.types import Floats, Ints

#: Levels of the nesting, outermost first.
LEVELS = ("texture", "printer", "print", "repeat")
#: 95 % of differences between two readings lie within so many standard deviations (ISO 5725-6: 1.96 x sqrt(2)).
LIMIT_FACTOR = 2.8


@dataclass(frozen=True, kw_only=True, eq=False)
class NestedSums:
    """Sums of squares of one position, or of many added up.

    Args:
        squares: Sums of squares by level, shape (4,), in the order of :data:`LEVELS`.
        coefficients: ``coefficients[m, l]`` is what one unit of component l adds to the expected sum of squares m,
            shape (4, 4), upper triangular.
        dof: Degrees of freedom by level, summed over positions, shape (4,).
    """

    squares: Floats
    coefficients: Floats
    dof: Ints

    @classmethod
    def of(cls, labels: ArrayLike, squares: ArrayLike) -> NestedSums:
        """The sums of one position.

        Args:
            labels: Texture, printer-filament and copy of each press as whole numbers, shape (n, 3). Copies and
                printers may be numbered again within each texture: all three together name a print.
            squares: Sums of squares by level, shape (4,).
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
    """Which group each press belongs to, for the whole and for each level, 5 arrays (n,)."""
    n = len(labels)
    groups = [np.zeros(n, dtype=np.int64)]
    groups += [np.unique(labels[:, : depth + 1], axis=0, return_inverse=True)[1].reshape(n) for depth in range(3)]
    return [*groups, np.arange(n)]


def _coefficient(level: Ints, within: Ints) -> float:
    """What one unit of a level's component adds to the sum over groups g of ``n_g |mean_g|^2``.

    For a level finer than g it is the sum over g of ``sum over its h of n_h^2 / n_g``; a level that is as coarse or
    coarser is the same for all of g, which gives n.
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
        name: Its level, one of :data:`LEVELS`.
        variance: Unbiased estimate, may be negative; None where the design cannot tell it.
        dof: Degrees of freedom of its level, summed over positions.
        includes: Finer levels that the design cannot tell from it and that are therefore in it.
        note: Why there is no estimate, or what stands out; empty otherwise.
    """

    name: str
    variance: float | None
    dof: int
    includes: tuple[str, ...] = ()
    note: str = ""

    @property
    def truncated(self) -> float | None:
        """The estimate, 0 where it is negative."""
        return None if self.variance is None else max(0.0, self.variance)


def components(sums: NestedSums) -> tuple[Component, ...]:
    """The four components, outermost first.

    A level at which every group has one member (one print of each texture, one repeat, one printer) has no degree of
    freedom. What it holds is then in the next coarser level that has some, which says so in ``includes``.

    Args:
        sums: Pooled sums of squares.
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
    alone = ("one texture only", "one printer-filament only", "one print of each block only", "one repeat only")[level]
    coarser = [LEVELS[j] for j in active if j < level]
    return f"{alone}; it is in the component of the {coarser[-1]}" if coarser else f"{alone}; no estimate"


#: ISO 5725's standard deviations and the components in each: the same print pressed again; another print from the same
#: printer and filament; another printer or filament. The item is the texture's design and the "laboratory" a printer.
PRECISION: Mapping[str, tuple[str, ...]] = {
    "repeatability": ("repeat",),
    "intermediate": ("print", "repeat"),
    "reproducibility": ("printer", "print", "repeat"),
}


def precision(estimates: Sequence[Component]) -> dict[str, float | None]:
    """The standard deviations of :data:`PRECISION`, in the reading's unit; None where the design cannot tell one.

    A negative component counts as 0 (ISO 5725-2, 7.4.5.4). A sum needs each of its components, alone or within a
    coarser one that is itself in the sum. Two single readings differ by less than :data:`LIMIT_FACTOR` standard
    deviations in 95 of 100 cases.

    Args:
        estimates: The four of :func:`components`.
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
    """Rows of ``components.csv``: the components, then ISO 5725's variances as sums of truncated components.

    Args:
        force_level: Level from 1, or ``all``.
        estimates: The four of :func:`components`.
        intervals: Low and high by component, where there are some (print and repeat; printers and textures are chosen
            and few, so that an interval of their component would say nothing).
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
