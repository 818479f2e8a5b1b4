"""A printer's repeatability beside the published figures: a verdict for each published printer, with its reasons.

The published figures are the variance over the two repeats on one print (:data:`.published.PAPER_VARIANCE`), so ours
are the same: the table of the protocol ``as-published``. They say how well a print repeats, not how prints differ. A
published figure has no interval and is taken as it stands; ours has prints as the unit of its interval.

With ddof 0 the expected figure depends on the number of repeats: R of them show (R-1)/R of their variance. Before it is
compared, our interval is brought to two repeats.

A figure contains the sensor's noise too. The verdict is "repeats less well" only where our figure stays above the
published one once what our noise floor adds to it (the same divisor, the same number of repeats) is taken off; the
noise in the published figures is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import texture_number
from tacbench_cad.lab.analysis.tables import Column, Table
from tacbench_cad.lab.analysis.variance.cells import Cell, Level, squared
from tacbench_cad.lab.analysis.variance.grade_limits import limits, to_two_repeats
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import interval, short

#: What our figure of a texture is against a published one.
Difference = Literal["less", "more", "unclear"]

#: What can be said of a printer beside a published one.
Verdict = Literal[
    "repeats as well, or better",
    "repeats less well",
    "varies more, but the sensor's noise may explain it",
    "varies more, but without a noise floor the reason is unknown",
    "not enough data",
    "no interval",
    "another unit",
]


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A published figure beside ours.

    Args:
        printer: The published printer.
        filament: Its filament.
        variance: Its figure.
        ours_is: What ours is; None without an interval, or in another unit.
        ratio: Our interval, brought to two repeats, over the published figure; None without an interval.
    """

    printer: str
    filament: str
    variance: float
    ours_is: Difference | None
    ratio: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True)
class Texture:
    """One of the paper's textures as a printer printed it: the cell's numbers, and the published ones beside them."""

    texture: int
    variance: float
    noise_alone: float | None
    low: float | None
    high: float | None
    prints: int
    presses: int
    published: tuple[Compared, ...]


@dataclass(frozen=True, kw_only=True)
class Judgement:
    """A printer beside one of the published ones.

    Args:
        printer: The published printer.
        filament: Its filament.
        verdict: What can be said.
        less: Numbers of the textures that vary less.
        more: Those that vary more.
        unclear: Those that cannot be told apart.
        at_least: How many times as much as the published figure the clearest of ``more`` varies at least.
        at_most: How many times as much the most open of ``unclear`` may vary.
    """

    printer: str
    filament: str
    verdict: Verdict
    less: tuple[int, ...]
    more: tuple[int, ...]
    unclear: tuple[int, ...]
    at_least: float | None
    at_most: float | None

    @property
    def text(self) -> str:
        """The verdict with its numbers: ``Form 3 resin: not enough data (unclear: 1, 2, up to 3.1 times as much)``."""
        parts = [
            f"{what}: {', '.join(map(str, numbers))}" + ("" if times is None else f", {word} {times:.2g} times as much")
            for what, numbers, word, times in (
                ("more", self.more, "at least", self.at_least),
                ("less", self.less, "", None),
                ("unclear", self.unclear, "up to", self.at_most),
            )
            if numbers
        ]
        name = published.PAPER_ROW_NAMES[self.printer, self.filament]
        return f"{name}: {self.verdict}" + (f" ({'; '.join(parts)})" if parts else "")


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A printer and filament beside the paper's table; the fields are the keys of ``--json``.

    Args:
        printer: Printer.
        filament: Filament.
        force_level: The level that was compared.
        units: The unit of the variances: ``counts^2``.
        textures: The paper's textures that there are, by number.
        verdicts: What the data say, for each of the paper's rows.
        limits: What they cannot say, and why: a sentence each.
    """

    printer: str
    filament: str
    force_level: Level
    units: str
    textures: tuple[Texture, ...]
    verdicts: tuple[Judgement, ...]
    limits: tuple[str, ...]

    @property
    def table(self) -> Table:
        """The textures with the published figures beside them."""
        names = list(published.PAPER_ROW_NAMES.values())

        def beside(place: int, texture: Texture) -> str:
            of = texture.published[place]
            return f"{of.variance:.2f} {of.ours_is or '-'}"

        columns = (
            Column("texture"),
            Column("prints"),
            Column("variance", head=f"variance of repeats ({self.units})", text=short),
            Column("interval", head="95 % interval", source=lambda t: interval(t.low, t.high), right=True),
            Column(
                "noise_alone", source=lambda t: "none" if t.noise_alone is None else short(t.noise_alone), right=True
            ),
            *(Column(name, source=partial(beside, place), right=True) for place, name in enumerate(names)),
        )
        level = f"force level {self.force_level}"
        title = f"{self.printer}, {self.filament}: {level}; published figures with what yours is beside them"
        return Table.of(columns, self.textures, title)


def grade(cells: Sequence[Cell], collection: Collection, left_out: Sequence[str] = ()) -> tuple[Grade, ...]:
    """Each printer-filament of a variance table beside the published table.

    Args:
        cells: The cells of a table of the protocol ``as-published``.
        collection: The study.
        left_out: Readings that could not be used.

    Returns:
        One grade for each printer and filament, in the order of the cells.

    Raises:
        InputError: The cells are of another quantity than the published figures, none is of one of the paper's
            textures, or the print, the place or the force of some press is unknown.
    """
    collection.require("the grade", "print", "position", "force")
    if any(cell.quantity != "repeats of one print" for cell in cells):
        what = "must be as-published: the published figures are the variance over the repeats on one print"
        raise InputError("protocol", "paper", what)
    if not any(texture_number(cell.texture) for cell in cells):
        names = ", ".join(dict.fromkeys(cell.texture for cell in cells))
        raise InputError("texture", names, "none of them is one of the paper's six; `tacbench variance` takes any")
    grades = []
    for printer, filament in dict.fromkeys((cell.printer, cell.filament) for cell in cells):
        mine = [cell for cell in cells if (cell.printer, cell.filament) == (printer, filament)]
        textures = [_texture(cell, number, collection) for cell in mine if (number := texture_number(cell.texture))]
        textures.sort(key=lambda texture: texture.texture)
        grades.append(
            Grade(
                printer=printer,
                filament=filament,
                force_level=mine[0].force_level,
                units=squared(collection.units),
                textures=tuple(textures),
                verdicts=tuple(
                    _judged(i, textures, collection.in_counts) for i in range(len(published.PAPER_VARIANCE))
                ),
                limits=limits(mine, collection, left_out),
            )
        )
    return tuple(grades)


def _texture(cell: Cell, number: int, collection: Collection) -> Texture:
    compared = []
    for (printer, filament), values in published.PAPER_VARIANCE.items():
        value, ratio = values[number - 1], None
        ours_is: Difference | None = None
        if cell.low is not None and cell.high is not None and collection.in_counts:
            two = to_two_repeats(collection.pressing.repeats)
            ratio = (two * cell.low / value, two * cell.high / value)
            ours_is = "less" if ratio[1] < 1.0 else "more" if ratio[0] > 1.0 else "unclear"
        compared.append(Compared(printer=printer, filament=filament, variance=value, ours_is=ours_is, ratio=ratio))
    numbers = {name: getattr(cell, name) for name in ("variance", "noise_alone", "low", "high", "prints", "presses")}
    return Texture(texture=number, published=tuple(compared), **numbers)


def _judged(row: int, textures: Sequence[Texture], comparable: bool) -> Judgement:
    """What the textures say of one of the published rows."""
    by: dict[Difference, list[tuple[Texture, tuple[float, float]]]] = {"less": [], "more": [], "unclear": []}
    for texture in textures:
        of = texture.published[row]
        if of.ours_is and of.ratio:
            by[of.ours_is].append((texture, of.ratio))
    # What of the lower end the noise cannot explain. Interval and noise are both for ddof 0 and our number of repeats.
    beyond = [
        texture.noise_alone is not None
        and texture.low is not None
        and ratio[0] * (1.0 - texture.noise_alone / texture.low) > 1.0
        for texture, ratio in by["more"]
    ]
    verdict: Verdict
    if not comparable:
        verdict = "another unit"
    elif any(beyond):
        verdict = "repeats less well"
    elif any(texture.noise_alone is None for texture, _ in by["more"]):
        verdict = "varies more, but without a noise floor the reason is unknown"
    elif by["more"]:
        verdict = "varies more, but the sensor's noise may explain it"
    elif by["unclear"]:
        verdict = "not enough data"
    else:
        verdict = "repeats as well, or better" if by["less"] else "no interval"
    less, more, unclear = (tuple(texture.texture for texture, _ in members) for members in by.values())
    printer, filament = list(published.PAPER_VARIANCE)[row]
    return Judgement(
        printer=printer,
        filament=filament,
        verdict=verdict,
        less=less,
        more=more,
        unclear=unclear,
        at_least=max((ratio[0] for _, ratio in by["more"]), default=None),
        at_most=max((ratio[1] for _, ratio in by["unclear"]), default=None),
    )
