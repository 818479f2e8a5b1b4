"""The comparison of a printer's repeatability with the published figures: a verdict for each published printer.

The published figures are the variance over the two repeats on one print (:data:`.published.PAPER_VARIANCE`). They are
compared with the same quantity, the table of the protocol ``as-published``. These figures show how well a press on one
print repeats, but not how prints differ. A published figure has no interval and is used as an exact number. The unit of
our own intervals is the print.

With ddof 0 the expected figure depends on the number of repeats: R repeats show (R-1)/R of their variance. Our interval
is therefore converted to two repeats before the comparison.

A figure also contains sensor noise. The verdict is "repeats less well" only if our figure is above the published figure
even without the part that our noise floor adds (with the same divisor and the same number of repeats). The noise in the
published figures is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import pandas as pd

from tacbench_cad.lab.analysis import published
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import texture_number
from tacbench_cad.lab.analysis.tables import Shown
from tacbench_cad.lab.analysis.variance.cells import Cell, Level, squared
from tacbench_cad.lab.analysis.variance.grade_limits import limits, to_two_repeats
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import interval, short

#: The difference between our figure of a texture and a published one.
Difference = Literal["less", "more", "unclear"]

#: The result of a comparison of a printer with a published printer.
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
    """The comparison of a texture's figure with one published figure.

    Args:
        printer: The published printer.
        filament: Its filament.
        variance: The published figure.
        ours_is: Whether our figure is less or more; None without an interval, or in another unit.
        ratio: Our interval, converted to two repeats, divided by the published figure; None without an interval.
    """

    printer: str
    filament: str
    variance: float
    ours_is: Difference | None
    ratio: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True)
class GradedTexture:
    """The numbers of one of the paper's textures, and their comparison with the published figures."""

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
    """The comparison of a printer with one published printer.

    Args:
        printer: The published printer.
        filament: Its filament.
        verdict: The result of the comparison.
        less: The numbers of the textures that vary less.
        more: The numbers of the textures that vary more.
        unclear: The numbers of the textures without a clear difference.
        at_least: The largest lower end of a texture in ``more``, as a multiple of the published figure; None if
            ``more`` is empty.
        at_most: The largest upper end of a texture in ``unclear``, as a multiple of the published figure; None if
            ``unclear`` is empty.
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
    """The comparison of a printer and filament with the paper's table; the fields are the keys of ``--json``.

    Args:
        printer: The name of the printer.
        filament: The name of the filament.
        force_level: The compared force level.
        units: The unit of the variances: ``counts^2``.
        textures: The measured textures that are in the paper, by number.
        verdicts: The result for each row of the paper.
        limits: The limits of the comparison, one sentence each.
    """

    printer: str
    filament: str
    force_level: Level
    units: str
    textures: tuple[GradedTexture, ...]
    verdicts: tuple[Judgement, ...]
    limits: tuple[str, ...]

    @property
    def table(self) -> Shown:
        """The textures with their figures and the published figures."""
        frame = pd.DataFrame(
            {
                "texture": texture.texture,
                "prints": texture.prints,
                f"variance of repeats ({self.units})": short(texture.variance),
                "95 % interval": interval(texture.low, texture.high),
                "noise alone": "none" if texture.noise_alone is None else short(texture.noise_alone),
                **{
                    name: f"{of.variance:.2f} {of.ours_is or '-'}"
                    for name, of in zip(published.PAPER_ROW_NAMES.values(), texture.published, strict=True)
                },
            }
            for texture in self.textures
        )
        level = f"force level {self.force_level}"
        title = f"{self.printer}, {self.filament}: {level}; published figures, and whether yours is less or more"
        return Shown(title, frame)


def grade(cells: Sequence[Cell], collection: Collection, left_out: Sequence[str] = ()) -> tuple[Grade, ...]:
    """Compare each printer-filament of a variance table with the published table.

    Args:
        cells: The cells of a table of the protocol ``as-published``.
        collection: The study.
        left_out: The frames that could not be used.

    Returns:
        One grade for each printer and filament, in the order of the cells.

    Raises:
        InputError: The cells have another quantity than the published figures, none of their textures is in the paper,
            or the print, the position or the force of some press is unknown.
    """
    collection.require("the grade", "print", "position", "force")
    if any(cell.quantity != "repeats of one print" for cell in cells):
        what = "must be as-published: the published figures are the variance over the repeats on one print"
        raise InputError("protocol", "paper", what)
    if not any(texture_number(cell.texture) for cell in cells):
        names = ", ".join(dict.fromkeys(cell.texture for cell in cells))
        raise InputError(
            "texture", names, "none of them is one of the paper's six textures; for others use `tacbench variance`"
        )
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


def _texture(cell: Cell, number: int, collection: Collection) -> GradedTexture:
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
    return GradedTexture(texture=number, published=tuple(compared), **numbers)


def _judged(row: int, textures: Sequence[GradedTexture], comparable: bool) -> Judgement:
    """Compare the textures with one of the published rows."""
    by: dict[Difference, list[tuple[GradedTexture, tuple[float, float]]]] = {"less": [], "more": [], "unclear": []}
    for texture in textures:
        of = texture.published[row]
        if of.ours_is and of.ratio:
            by[of.ours_is].append((texture, of.ratio))
    # Whether noise cannot explain the lower end. Interval and noise are both for ddof 0 and our number of repeats.
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
