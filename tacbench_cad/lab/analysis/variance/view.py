"""The tables and notes of a variance table, for terminal, JSON, CSV files and report.

The command prints these tables, ``--json`` contains their records, and the results folder has their CSV files. The
report reads the CSV files again and shows the same tables.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pandas as pd

from tacbench_cad import __version__
from tacbench_cad.lab.analysis import conclusions
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Words
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.tables import Shown, read_csv, records, write_csv, write_settings
from tacbench_cad.lab.analysis.variance.cells import (
    ALL_LEVELS,
    FRAMES,
    REPEATS,
    Cell,
    Level,
    name_of,
    short_texture,
    shown_levels,
    squared,
)
from tacbench_cad.lab.analysis.variance.components import LIMIT_FACTOR
from tacbench_cad.lab.analysis.variance.notes import relation_to_paper, variance_warnings
from tacbench_cad.lab.analysis.variance.registration import Seating
from tacbench_cad.lab.analysis.variance.result import Protocol, VarianceResult
from tacbench_cad.lab.analysis.variance.result_tables import AS_PUBLISHED_FILES, CELL, REMOVED, VARIANCE, tables_of
from tacbench_cad.util.convert import read_json
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import counted, interval, short

#: The name of the settings file beside the tables.
SETTINGS_FILE = "variance_settings.json"


_COMPONENTS = {"texture": "texture", "printer": "printer-filament", "print": "print", "repeat": "repeat on one print"}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of a variance table. The fields are the keys of the settings file."""

    analysis: Literal["variance"] = "variance"
    version: str = __version__
    protocol: Protocol = "paper"
    colour: bool
    resolution: float
    ddof: int
    seed: int
    registered: bool
    left_out: tuple[str, ...]
    data: str
    features: str = "pixels"
    units: str = "counts"
    words: Words = Words()  # noqa: RUF009 (it is frozen)
    exhibit: str = ""
    caption: str = ""
    series: bool = False
    roi: str = ""
    outside: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class VarianceView:
    """A variance table in the form in which it is shown and stored.

    Args:
        collection: The study.
        settings: The settings.
        cells: The cells.
        tables: The tables by the names of their CSV files. If they were read from files, tables that are never shown
            are missing.
    """

    collection: Collection
    settings: Settings
    cells: tuple[Cell, ...]
    tables: Mapping[str, pd.DataFrame]

    @classmethod
    def of(cls, result: VarianceResult, seatings: Sequence[Seating] = ()) -> VarianceView:
        """Make the view of a result.

        Args:
            result: The result.
            seatings: The offsets of the prints, if registration was computed.
        """
        feature, exhibit = result.feature, result.feature.exhibit
        pixels = feature if isinstance(feature, Pixels) else Pixels()
        return cls(
            collection=result.collection,
            settings=Settings(
                protocol=result.protocol,
                colour=pixels.colour,
                resolution=pixels.resolution,
                ddof=result.ddof,
                seed=result.seed,
                registered=bool(seatings),
                left_out=result.left_out,
                data=result.collection.data_key,
                features=feature.name,
                units=result.units,
                words=feature.words,
                exhibit=exhibit.name if exhibit else "",
                caption=exhibit.caption if exhibit else "",
                series=result.collection.series,
                roi=feature.region.text if feature.region else "",
                outside=result.outside,
            ),
            cells=result.cells,
            tables=tables_of(result, seatings),
        )

    @classmethod
    def read(cls, folder: Path, collection: Collection) -> VarianceView:
        """Read the view from an output folder of ``tacbench variance``.

        Raises:
            InputError: A file is missing or damaged.
        """
        settings = read_json(folder / SETTINGS_FILE, Settings, "settings")
        names = ["variance", "floor_removed"]
        if settings.protocol == "paper":
            names += ("printer_answers", "components", "permutation", "print_distances")
            names += ["registration"] * settings.registered
        tables = {name: read_csv(folder / f"{name}.csv") for name in names}
        removed = tables["floor_removed"].rename(columns={name: field or name for name, field in REMOVED.items()})
        both = pd.concat(
            [tables["variance"], removed.drop(columns=tables["variance"].columns, errors="ignore")], axis=1
        )
        fields = {field.name for field in dataclasses.fields(Cell)}
        try:
            rows = [{name: value for name, value in row.items() if name in fields} for row in records(both)]
            cells = tuple(Cell(**{**row, "floor_from": row["floor_from"] or ""}) for row in rows)
        except (InputError, TypeError, KeyError, ValueError) as error:
            raise InputError("table", str(folder / "variance.csv"), f"contains a wrong value: {error}") from None
        if any(cell.variance < 0.0 or cell.prints < 1 for cell in cells):
            raise InputError("table", str(folder / "variance.csv"), "must have no negative variance and no 0 prints")
        collection = collection.viewed(settings.series)
        return cls(collection=collection, settings=settings, cells=cells, tables=tables)

    def write(self, folder: Path) -> list[Path]:
        """Write every table as CSV, and the settings as JSON.

        Raises:
            InputError: A file cannot be written.
        """
        optional = {
            "registration": self.settings.registered,
            "motion": self.settings.series,
        }
        names = [name for name in self.tables if optional.get(name, True)]
        simulated = self.collection.simulated
        paths = [write_csv(folder / f"{name}.csv", self.tables[name], simulated) for name in names]
        return [*paths, write_settings(folder / SETTINGS_FILE, self.settings)]

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        removed = records(self.tables["floor_removed"][["variance", "floor_removed", "low", "high"]])
        return {
            "simulated": list(self.collection.simulated),
            "protocol": self.settings.protocol,
            "units": self.unit,
            "grey": not self.settings.colour,
            "ddof": self.settings.ddof,
            **{key: getattr(self.settings, key) for key in ("features", "series", "roi", "outside")},
            "numbers": self.settings.words.numbers,
            "variance": [
                {**{key: getattr(cell, key) for key in (*VARIANCE, "floor_from")}, "ddof_1": of_cell}
                for cell, of_cell in zip(self.cells, removed, strict=True)
            ],
            **{
                name: records(table)
                for name, table in self.tables.items()
                if name not in (*AS_PUBLISHED_FILES, self.settings.exhibit)
            },
            "warnings": list(self.warnings),
            "left_out": list(self.settings.left_out),
        }

    @property
    def unit(self) -> str:
        """The unit of a variance: ``counts^2``."""
        return squared(self.settings.units)

    @property
    def in_counts(self) -> bool:
        """Whether the values are counts of images, as in the paper."""
        return self.settings.units == "counts"

    @property
    def floor_sources(self) -> list[str]:
        """The sources of the noise floors."""
        return sorted({cell.floor_from for cell in self.cells if cell.floor_from})

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings about the data, one sentence each."""
        return variance_warnings(self.collection, self.cells, self.settings.left_out)

    @property
    def notes(self) -> list[str]:
        """Notes that explain the tables."""
        words = {
            FRAMES: "stationary frames in contact, at the middle force",
            REPEATS: "repeats on one print, an upper bound",
        }
        sources = "; or ".join(words[source] for source in self.floor_sources if source in words)
        notes = [
            f"Noise alone is the variance expected from sensor noise alone{f' ({sources})' if sources else ''}. The "
            "unit of the intervals is the print. Floor removed is the variance with ddof 1 minus the noise floor."
        ]
        if self.settings.series:
            moving = counted(self.collection.info.series_frames, "frame")
            notes.append(
                f"Each figure is the mean over the {moving} of a series. They were taken while the sensor moved in "
                "contact; the paper's sensor did not move."
            )
        if self.settings.words.note:
            notes.append(self.settings.words.note)
        if self.settings.roi:
            notes.append(f"The region of interest is {self.settings.roi}; pixels outside of it are not used.")
        elif self.settings.outside is not None:
            advice = "; --roi auto leaves them out" if self.settings.protocol == "paper" else ""
            outside = f"{100 * self.settings.outside:.0f} %"
            notes.append(f"{outside} of the pixels do not show the sensor, but are part of each variance{advice}.")
        if self.in_counts and self.collection.beside_paper:
            notes.append(relation_to_paper(self.settings.protocol))
        return notes

    def shown(self) -> Iterator[tuple[str, Shown]]:
        """Yield the shown tables, each with the name of the CSV file that has all digits."""
        if self.settings.protocol == "paper":
            yield "printer_answers", conclusions.shown_answers(self.tables["printer_answers"])
        for level in shown_levels(self.cells):
            yield "variance", self._level_table(level)
        if self.settings.protocol == "as-published":
            return
        yield "components", self._component_table()
        if len(self.tables["permutation"]):
            yield "permutation", self._test_table()
        if self.settings.registered:
            yield "registration", self._seating_table()

    def _level_table(self, level: Level) -> Shown:
        """Return the variance table at one level: a few rows for each printer-filament, a column for each texture."""
        collection = self.collection
        by_key = {(cell.combination, cell.texture): cell for cell in self.cells if cell.force_level == level}
        largest = max(cell.variance for cell in by_key.values())
        decimals = 2 if largest <= 0.0 else min(12, max(0, 2 - math.floor(math.log10(largest))))

        def number(value: float | None) -> str:
            # + 0.0 removes the sign of -0
            return "" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"

        lines: dict[str, Callable[[Cell], str]] = {
            "noise alone": lambda cell: number(cell.noise_alone),
            "floor removed (ddof 1)": lambda cell: number(cell.floor_removed),
            "95 % interval": lambda cell: "" if cell.low is None else interval(cell.low, cell.high),
            "the paper": lambda cell: "" if cell.published is None else f"{cell.published:g}",
        }
        what, title = "variance", "variance"
        if self.settings.protocol == "as-published":
            what, title = "variance of repeats", "variance of the repeats on one print"
        rows: list[dict[str, str]] = []
        for combination in collection.combinations:
            cells = {t: by_key[combination, t] for t in collection.textures if (combination, t) in by_key}
            if not cells:
                continue
            counts = {name: _range([getattr(cell, name) for cell in cells.values()]) for name in ("prints", "presses")}
            values = {short_texture(texture): number(cell.variance) for texture, cell in cells.items()}
            rows.append({"printer, filament": name_of(combination), "": what, **values, **counts})
            bound = any(cell.floor_from == REPEATS for cell in cells.values())
            for name, text in lines.items():
                texts = {short_texture(texture): text(cell) for texture, cell in cells.items()}
                if any(texts.values()):
                    rows.append({"": f"{name}, at most" if bound and name == "noise alone" else name, **texts})
        columns = ["printer, filament", "", *map(short_texture, collection.textures), "prints", "presses"]
        title = f"{title}, {self._level_name(level)} ({self.unit}{self._kind}, ddof {self.settings.ddof})"
        return Shown(title, pd.DataFrame(rows, columns=columns))

    @property
    def _kind(self) -> str:
        """What the numbers are, in a few words, for titles."""
        kind = f"; {'colour' if self.settings.colour else 'grey'}, full size" if self.in_counts else ""
        if self.settings.protocol == "as-published":
            kind = f"; grey not rounded, {100.0 * self.settings.resolution:g} % of the size" if kind else ""
        kind += "; series of moving frames" if self.settings.series else ""
        kind += f"; {self.settings.words.title}" if self.settings.words.title else ""
        return kind + (f"; inside {self.settings.roi}" if self.settings.roi else "")

    def _component_table(self) -> Shown:
        """Return the components and ISO 5725's standard deviations, with a column for each level."""
        by_key = {(row["force_level"], row["component"]): row for row in records(self.tables["components"])}
        levels = shown_levels(self.cells)
        rows = {text: [_component(by_key[level, name]) for level in levels] for name, text in _COMPONENTS.items()}
        for name in ("repeatability", "intermediate", "reproducibility"):
            deviations = [
                None if variance is None else math.sqrt(variance)
                for level in levels
                for variance in [by_key[level, name]["variance"]]
            ]
            rows[f"{name} SD ({self.settings.units})"] = [
                "" if sd is None else f"{short(sd)} (limit {short(LIMIT_FACTOR * sd)})" for sd in deviations
            ]
        frame = pd.DataFrame.from_dict(rows, orient="index", columns=[self._level_name(level) for level in levels])
        title = f"variance components of the nested design ({self.unit}, unbiased) and ISO 5725"
        return Shown(title, frame.reset_index(names=""))

    def _test_table(self) -> Shown:
        table = self.tables["permutation"]
        pooled = table[table["force_level"] == ALL_LEVELS]
        table = pooled if len(pooled) else table
        frame = pd.DataFrame(
            {
                "force": [self._level_name(level) for level in table["force_level"]],
                "first": table["first"].map(name_of).tolist(),
                "second": table["second"].map(name_of).tolist(),
                "prints": [f"{a}, {b}" for a, b in zip(table["prints_first"], table["prints_second"], strict=True)],
                "ratio": table["ratio"].map(short, na_action="ignore").tolist(),
                "p": table["p"].map(short).tolist(),
                "p for all pairs": table["p_holm"].map(short).tolist(),
                "smallest possible p": table["least_p"].map(short).tolist(),
            }
        )
        return Shown("do two printers have the same variance between prints? (permutation test of prints)", frame)

    def _seating_table(self) -> Shown:
        """Return the variance of each cell with and without differences in placement, and the largest offsets."""
        table = self.tables["registration"]
        offsets = {axis: pd.to_numeric(table[axis]).abs() for axis in ("x_mm", "y_mm")}
        cells = (
            table.assign(**offsets)
            .groupby(list(CELL), sort=False, as_index=False)
            .agg(
                dict.fromkeys(("variance", "seating", "variance_without_seating"), "first")
                | dict.fromkeys(("x_mm", "y_mm"), "max")
            )
        )
        figures = {"variance": "variance", "seating": "seating", "without seating": "variance_without_seating"}
        frame = pd.DataFrame(
            {
                "force": [self._level_name(level) for level in cells["force_level"]],
                **{name: cells[name] for name in ("printer", "filament", "texture")},
                **{head: cells[name].map(short) for head, name in figures.items()},
                **{
                    f"largest offset {axis} (mm)": cells[f"{axis}_mm"].map("{:.3f}".format, na_action="ignore")
                    for axis in "xy"
                },
            }
        )
        title = "registration: the part of the variance that differences in placement explain (not in the paper)"
        return Shown(title, frame)

    def _level_name(self, level: Level) -> str:
        return self.collection.pressing.level_name(level)


def write_all(result: VarianceResult, folder: Path, seatings: Sequence[Seating] = ()) -> list[Path]:
    """Write every table as CSV and every figure as PNG and PDF.

    Args:
        result: The variance table.
        folder: The folder; it is created if it does not exist.
        seatings: The offsets of the prints, if registration was computed.

    Returns:
        The paths of the files.

    Raises:
        InputError: The folder cannot be written, or another process is writing to it.
        MissingToolError: matplotlib is not installed. The tables are written nevertheless.
    """
    from tacbench_cad.lab.analysis.variance.variance_figures import draw_all

    with locked(folder):
        return [*VarianceView.of(result, seatings).write(folder), *draw_all(result, folder)]


def _component(row: Mapping[str, Any]) -> str:
    if row["variance"] is None:
        return str(row["note"] or "not estimated")
    ends = f" ({interval(row['low'], row['high'])})" if row["low"] is not None else ""
    return f"{short(row['variance'])}{ends}" + (
        f", with {row['includes'].replace(' ', ', ')}" if row["includes"] else ""
    )


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"
