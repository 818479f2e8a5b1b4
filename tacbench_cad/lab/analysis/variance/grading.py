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

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from tacbench_cad.lab.analysis.published import PAPER_ROW_NAMES, PAPER_VARIANCE, texture_number
from tacbench_cad.lab.analysis.tables import Shown, records, write_csv
from tacbench_cad.lab.analysis.variance.cells import groups, squared
from tacbench_cad.lab.analysis.variance.grade_limits import limits, to_two_repeats
from tacbench_cad.lab.analysis.variance.result import Variance
from tacbench_cad.lab.analysis.variance.table import variance
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import interval, short

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PRINTER = ["printer", "filament"]
_ROW = ["published_printer", "published_filament"]
#: The columns of the table: our figure of one of the paper's textures, and its comparison with one published figure.
#: ``ours_is`` is ``less``, ``more`` or ``unclear``, and empty without an interval or in another unit. The ratio is our
#: interval, converted to two repeats, divided by the published figure.
_COLUMNS = [
    *(*_PRINTER, "force_level", "texture", "variance", "noise_alone", "low", "high", "prints", "presses"),
    *(*_ROW, "published", "ours_is", "ratio_low", "ratio_high"),
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Grades:
    """The comparison of printers and filaments with the paper's table.

    Args:
        variance: The variance table of the protocol ``as-published``.
        table: The comparisons, one row for each texture of a printer and each published figure.
        answers: The verdict on each printer for each published printer. ``less``, ``more`` and ``unclear`` are the
            numbers of the textures with this difference, ``at_least`` is the largest ``ratio_low`` among ``more``,
            ``at_most`` is the largest ``ratio_high`` among ``unclear``, and ``text`` is the verdict in words.
        limits: The limits of the comparison, one sentence each, by printer and filament.
    """

    variance: Variance
    table: pd.DataFrame
    answers: pd.DataFrame
    limits: Mapping[tuple[str, str], tuple[str, ...]]

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """All tables by the names of their CSV files."""
        return {"grade": self.table, "verdicts": self.answers}

    def verdicts(self, printer: tuple[str, str]) -> list[str]:
        """Return the verdicts on a printer and filament in words."""
        mine = (self.answers[_PRINTER] == list(printer)).all(axis=1)
        return self.answers.loc[mine, "text"].tolist()

    def shown(self) -> Iterator[tuple[str, Shown]]:
        """Yield the table of each printer and filament for readers, each with the name of its CSV file."""
        for (printer, filament), mine in groups(self.table, _PRINTER):
            rows = [_shown(of_texture, squared(self.variance.units)) for _, of_texture in mine.groupby("texture")]
            level = f"force level {mine['force_level'].iloc[0]}"
            title = f"{printer}, {filament}: {level}; published figures, and whether yours is less or more"
            yield "grade", Shown(title, pd.DataFrame(rows))

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        names = (dict(zip(_PRINTER, printer, strict=True)) for printer in self.limits)
        return {
            "simulated": list(self.variance.design.simulated),
            "units": squared(self.variance.units),
            **{name: records(table) for name, table in self.tables.items()},
            "limits": [{**name, "limits": list(of)} for name, of in zip(names, self.limits.values(), strict=True)],
        }

    def figure(self) -> Figure:
        """Draw the variances with their intervals, see :meth:`.Variance.figure`."""
        return self.variance.figure()

    def save(self, folder: str | Path) -> list[Path]:
        """Write the tables as CSV.

        Returns:
            The paths of the files.

        Raises:
            InputError: The folder cannot be written, or another process is writing to it.
        """
        path, simulated = Path(folder), self.variance.design.simulated
        with locked(path):
            return [write_csv(path / f"{name}.csv", table, simulated) for name, table in self.tables.items()]


def grade(
    presses: pd.DataFrame,
    *,
    jobs: int = 1,
    dask: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Grades:
    """Compare each printer-filament with the published table, at the lowest force level.

    Args:
        presses: The table of presses.
        jobs: The number of worker processes on this machine.
        dask: The address of a Dask scheduler, whose workers are then used instead.
        progress: Receives progress updates: the number of frames done and their total number.

    Raises:
        InputError: The presses have no such variance, none of their textures is in the paper, or the print, the
            position or the force of some press is unknown.
    """
    return graded(variance(presses, protocol="as-published", jobs=jobs, dask=dask, progress=progress))


def graded(result: Variance) -> Grades:
    """Compare each printer-filament of a variance table of the protocol ``as-published`` with the published table.

    Raises:
        InputError: The table has another quantity than the published figures, none of its textures is in the paper,
            or the print, the position or the force of some press is unknown.
    """
    design, cells = result.design, result.table
    design.require("the grade", "print", "position", "force")
    if result.protocol != "as-published":
        what = "must be as-published: the published figures are the variance over the repeats on one print"
        raise InputError("protocol", result.protocol, what)
    numbers = cells["texture"].map(texture_number)
    if numbers.isna().all():
        names = ", ".join(cells["texture"].unique())
        raise InputError(
            "texture", names, "none of them is one of the paper's six textures; for others use `tacbench variance`"
        )
    published = pd.DataFrame(
        [(*row, i, figure) for row, figures in PAPER_VARIANCE.items() for i, figure in enumerate(figures, start=1)],
        columns=[*_ROW, "texture", "published"],
    )
    known = cells.drop(columns="published").assign(texture=numbers)[numbers.notna()].astype({"texture": int})
    table = known.merge(published, on="texture")
    for end in ("low", "high"):
        ours = table[end] * to_two_repeats(design.repeats)
        table[f"ratio_{end}"] = ours / table["published"] if design.in_counts else np.nan
    conditions = [table["ratio_high"] < 1.0, table["ratio_low"] > 1.0, table["ratio_low"].notna()]
    table["ours_is"] = np.select(conditions, ["less", "more", "unclear"], "")
    verdicts = [
        dict(zip([*_PRINTER, *_ROW], key, strict=True)) | _judged(of_row, key[2:], design.in_counts)
        for key, of_row in groups(table, [*_PRINTER, *_ROW])
    ]
    of_printers = cells[numbers.groupby([cells[name] for name in _PRINTER]).transform("count") > 0]
    return Grades(
        variance=result,
        table=table[_COLUMNS],
        answers=pd.DataFrame(verdicts),
        limits={key: limits(mine, design, result.left_out) for key, mine in groups(of_printers, _PRINTER)},
    )


def _judged(table: pd.DataFrame, row: tuple[str, str], comparable: bool) -> dict[str, Any]:
    """Compare the textures of a printer with one of the published rows."""
    by = {name: table[table["ours_is"] == name].sort_values("texture") for name in ("more", "less", "unclear")}
    more = by["more"]
    # Whether noise cannot explain the lower end. Interval and noise are both for ddof 0 and our number of repeats.
    beyond = more["ratio_low"] * (1.0 - more["noise_alone"] / more["low"]) > 1.0
    if not comparable:
        verdict = "another unit"
    elif beyond.any():
        verdict = "repeats less well"
    elif more["noise_alone"].isna().any():
        verdict = "varies more, but without a noise floor the reason is unknown"
    elif len(more):
        verdict = "varies more, but the sensor's noise may explain it"
    elif len(by["unclear"]):
        verdict = "not enough data"
    else:
        verdict = "repeats as well, or better" if len(by["less"]) else "no interval"
    textures = {name: ", ".join(map(str, of["texture"])) for name, of in by.items()}
    ends = {"at_least": more["ratio_low"].max(), "at_most": by["unclear"]["ratio_high"].max()}
    times = {
        "more": f", at least {ends['at_least']:.2g} times as much",
        "less": "",
        "unclear": f", up to {ends['at_most']:.2g} times as much",
    }
    parts = "; ".join(f"{name}: {of}{times[name]}" for name, of in textures.items() if of)
    text = f"{PAPER_ROW_NAMES[row]}: {verdict}" + (f" ({parts})" if parts else "")
    return {"verdict": verdict, **textures, **ends, "text": text}


def _shown(of_texture: pd.DataFrame, unit: str) -> dict[str, Any]:
    """Return the row of a texture for readers."""
    first = of_texture.iloc[0]
    names = (PAPER_ROW_NAMES[row] for row in of_texture[_ROW].itertuples(index=False, name=None))
    compared = zip(names, of_texture["published"], of_texture["ours_is"], strict=True)
    return {
        "texture": first["texture"],
        "prints": first["prints"],
        f"variance of repeats ({unit})": short(first["variance"]),
        "95 % interval": "none" if pd.isna(first["low"]) else interval(first["low"], first["high"]),
        "noise alone": "none" if pd.isna(first["noise_alone"]) else short(first["noise_alone"]),
        **{name: f"{figure:.2f} {ours_is or '-'}" for name, figure, ours_is in compared},
    }
