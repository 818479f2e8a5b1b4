"""A printer's variances beside the published ones, and in plain sentences what that supports and what it cannot.

A published figure is taken as it stands: it comes from six prints, has no interval, and the text does not say at which
force or in which colours it was taken. Ours is grey, ddof 0, with prints as the unit of its interval.

With ddof 0 the expected figure depends on the number of prints: k prints of R repeats show (k-1)/k of the variance
between prints and (kR-1)/(kR) of that between repeats, so three prints read up to 20 % lower than six would. Before it
is compared, an interval is brought to the paper's six prints of two repeats: its lower end by the smaller of the two
factors that this takes, its upper end by the larger one, because which share is the prints' is not known well.

A figure holds the sensor's noise too. That prints are less consistent is said only where our figure stays above the
published one with our noise floor taken off; the other way round the paper's own noise is not known, which is said.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.variance.cells import ALL_LEVELS, Cell
from tacbench_cad.lab.analysis.variance.grade_limits import UNITS, Context, factors, limits, texture_number
from tacbench_cad.util.errors import InputError, nearest

#: What our figure is against a published one.
Verdict = Literal["less", "more", "unclear"]
Combination = tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One texture of a printer beside the paper's three rows.

    Args:
        cell: Our figure.
        number: The texture's number, 1 to 6.
        low: Lower end of our interval, brought to six prints of two repeats; None without an interval.
        high: Upper end, likewise.
        verdicts: By the paper's row: what ours is; empty where nothing can be said.
    """

    cell: Cell
    number: int
    low: float | None
    high: float | None
    verdicts: Mapping[Combination, Verdict] = field(default_factory=dict)

    @property
    def prints_low(self) -> float | None:
        """What of the lower end the noise floor cannot explain; None without an interval or a floor."""
        return None if self.low is None or self.cell.floor is None else self.low - self.cell.floor


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A printer and filament beside the paper's table.

    Args:
        printer: Printer.
        filament: Filament.
        force_level: The level that was compared, or ``all``.
        textures: The paper's textures that there are, by number.
        supports: Sentences: what the data support.
        limits: Sentences: what they cannot support, and why.
    """

    printer: str
    filament: str
    force_level: int | str
    textures: tuple[Compared, ...]
    supports: tuple[str, ...]
    limits: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            "printer": self.printer,
            "filament": self.filament,
            "force_level": self.force_level,
            "textures": [
                {
                    "texture": one.number,
                    "variance": one.cell.variance,
                    "floor": one.cell.floor,
                    "low": one.cell.low,
                    "high": one.cell.high,
                    "prints": one.cell.prints,
                    "presses": one.cell.presses,
                    "published": [
                        {
                            "printer": row[0],
                            "filament": row[1],
                            "variance": values[one.number - 1],
                            "ours_is": one.verdicts.get(row),
                        }
                        for row, values in published.VARIANCE.items()
                    ],
                }
                for one in self.textures
            ],
            "supports": list(self.supports),
            "limits": list(self.limits),
        }


def grade(cells: Sequence[Cell], context: Context, force_level: int | str = ALL_LEVELS) -> tuple[Grade, ...]:
    """Each printer-filament of a variance table beside the published table.

    Args:
        cells: The variance table's cells.
        context: How they were taken.
        force_level: The level to compare, or ``all`` for the pooled cells.

    Returns:
        One grade for each printer and filament, in the order of the cells.

    Raises:
        InputError: There is no cell at this level, or none of one of the paper's textures.
    """
    levels = list(dict.fromkeys(str(one.force_level) for one in cells))
    chosen = [one for one in cells if str(one.force_level) == str(force_level)]
    if not chosen:
        raise InputError("force_level", force_level, nearest(str(force_level), levels))
    if not any(texture_number(one.texture) for one in chosen):
        names = ", ".join(dict.fromkeys(one.texture for one in chosen))
        raise InputError("texture", names, "none of them is one of the paper's six; `tacbench variance` takes any")
    grades = []
    for printer, filament in dict.fromkeys((one.printer, one.filament) for one in chosen):
        mine = [one for one in chosen if (one.printer, one.filament) == (printer, filament)]
        numbered = [(one, number) for one in mine if (number := texture_number(one.texture))]
        compared = sorted((_compared(*one, context) for one in numbered), key=lambda one: one.number)
        grades.append(
            Grade(
                printer=printer,
                filament=filament,
                force_level=force_level,
                textures=tuple(compared),
                supports=tuple(_supports(compared, context)),
                limits=limits(mine, context, force_level),
            )
        )
    return tuple(grades)


def _compared(cell: Cell, number: int, context: Context) -> Compared:
    if cell.low is None or cell.high is None or cell.prints < 2:
        return Compared(cell=cell, number=number, low=None, high=None)
    least, most = factors(cell.prints, context.repeats)
    low, high = least * cell.low, most * cell.high
    verdicts: dict[Combination, Verdict] = {}
    if context.comparable:
        for row, values in published.VARIANCE.items():
            value = values[number - 1]
            verdicts[row] = "less" if high < value else "more" if low > value else "unclear"
    return Compared(cell=cell, number=number, low=low, high=high, verdicts=verdicts)


def _supports(compared: Sequence[Compared], context: Context) -> list[str]:
    """A sentence for each of the paper's rows."""
    judged = [one for one in compared if one.verdicts]
    if not context.comparable:
        return [f"Nothing about the published figures: they are in {UNITS}^2, these in ({context.units})^2."]
    if not judged:
        return ["Nothing yet about prints: an interval needs at least two prints of a texture."]
    return [_sentence(row, judged) for row in published.VARIANCE]


def _sentence(row: Combination, judged: Sequence[Compared]) -> str:
    name, values = published.ROW_NAMES[row], published.VARIANCE[row]
    by: dict[Verdict, list[Compared]] = {"less": [], "more": [], "unclear": []}
    for one in judged:
        by[one.verdicts[row]].append(one)
    parts = []
    if by["more"]:
        times = max((one.low or 0.0) / values[one.number - 1] for one in by["more"])
        parts.append(f"{_textures(by['more'], 'vary')} more (the clearest at least {times:.2g} times as much)")
    if by["less"]:
        parts.append(f"{_textures(by['less'], 'vary')} less")
    if by["unclear"]:
        times = max((one.high or 0.0) / values[one.number - 1] for one in by["unclear"])
        parts.append(f"{_textures(by['unclear'])} cannot be told apart (up to {times:.2g} times as much is possible)")
    if any(one.prints_low is not None and one.prints_low > values[one.number - 1] for one in by["more"]):
        head = f"Less consistent than the published {name}"
    elif any(one.prints_low is None for one in by["more"]):
        head = f"Above the published {name}, but without a noise floor it is open whether by the prints"
    elif by["more"]:
        head = f"Above the published {name}, but the sensor's own noise is large enough to explain it"
    elif by["unclear"]:
        head = f"Neither shown nor contradicted to be as consistent as the published {name}"
    else:
        head = f"As consistent as the published {name}, or more so"
    return f"{head}: {'; '.join(parts)}."


def _textures(compared: Sequence[Compared], verb: str = "") -> str:
    """``texture 4 varies`` or ``textures 1, 4 vary``; without a verb the names alone."""
    numbers = ", ".join(str(one.number) for one in compared)
    alone = {"vary": " varies", "": ""}[verb]
    return f"texture {numbers}{alone}" if len(compared) == 1 else f"textures {numbers} {verb}".rstrip()
