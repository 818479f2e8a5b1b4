"""The tables and notes of a variance table, for terminal, JSON, CSV files and report.

The command prints these tables, ``--json`` contains their records, and the results folder has their CSV files. The
report reads the CSV files again and shows the same tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tacbench_cad import __version__
from tacbench_cad.lab.analysis import conclusions
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.feature import Words
from tacbench_cad.lab.analysis.pixels import Pixels
from tacbench_cad.lab.analysis.tables import Column, Row, Table, read_settings, write_settings
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
from tacbench_cad.lab.analysis.variance.result_tables import AS_PUBLISHED_FILES, CELL, COLUMNS, REMOVED, tables_of
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
        tables: The tables by the names in ``COLUMNS``. If they were read from files, tables that are never shown
            are missing.
    """

    collection: Collection
    settings: Settings
    cells: tuple[Cell, ...]
    tables: Mapping[str, Table]

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
        settings = read_settings(folder / SETTINGS_FILE, Settings)
        names = ["variance", "floor_removed"]
        if settings.protocol == "paper":
            names += ("printer_answers", "components", "permutation", *["registration"] * settings.registered)
            # Earlier versions did not write this file.
            names += ["print_distances"] * (folder / "print_distances.csv").is_file()
        tables = {name: Table.read(folder / f"{name}.csv", COLUMNS[name]) for name in names}
        try:
            cells = tuple(
                Cell(
                    **cell,
                    floor_from=removed["floor_from"] or "",
                    floor_removed=removed["floor_removed"],
                    **{attribute: removed[name] for name, attribute in REMOVED.items()},
                )
                for cell, removed in zip(tables["variance"].rows, tables["floor_removed"].rows, strict=True)
            )
        except (InputError, TypeError, ValueError) as error:
            raise InputError("table", str(folder / "variance.csv"), f"contains a wrong value: {error}") from None
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
        paths = [self.tables[name].write(folder / f"{name}.csv", self.collection.simulated) for name in names]
        return [*paths, write_settings(folder / SETTINGS_FILE, self.settings)]

    def document(self) -> dict[str, Any]:
        """Return the document of ``--json``."""
        keys = [column.name for column in COLUMNS["variance"]]
        return {
            "simulated": list(self.collection.simulated),
            "protocol": self.settings.protocol,
            "units": self.unit,
            "grey": not self.settings.colour,
            "ddof": self.settings.ddof,
            **{key: getattr(self.settings, key) for key in ("features", "series", "roi", "outside")},
            "numbers": self.settings.words.numbers,
            "variance": [
                {
                    **{key: getattr(cell, key) for key in (*keys, "floor_from")},
                    "ddof_1": {name: removed[name] for name in ("variance", "floor_removed", "low", "high")},
                }
                for cell, removed in zip(self.cells, self.tables["floor_removed"].rows, strict=True)
            ],
            **{
                name: self.tables[name].records()
                for name in self.tables
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

    @property
    def answers(self) -> Table:
        """The answers about the printers in plain words; the protocol ``as-published`` has none."""
        return conclusions.shown(self.tables["printer_answers"])

    def shown(self) -> Iterator[tuple[str, Table]]:
        """Yield the shown tables, each with the name of the CSV file that has all digits."""
        if self.settings.protocol == "paper":
            yield "printer_answers", self.answers
        for level in shown_levels(self.cells):
            yield "variance", self._level_table(level)
        if self.settings.protocol == "as-published":
            return
        yield "components", self._component_table()
        if self.tables["permutation"].rows:
            yield "permutation", self._test_table()
        if self.settings.registered:
            yield "registration", self._seating_table()

    def _level_table(self, level: Level) -> Table:
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
        rows: list[Row] = []
        for combination in collection.combinations:
            cells = {t: by_key[combination, t] for t in collection.textures if (combination, t) in by_key}
            if not cells:
                continue
            counts = {name: _range([getattr(cell, name) for cell in cells.values()]) for name in ("prints", "presses")}
            values = {texture: number(cell.variance) for texture, cell in cells.items()}
            rows.append({"name": name_of(combination), "what": what, **values, **counts})
            bound = any(cell.floor_from == REPEATS for cell in cells.values())
            for name, text in lines.items():
                texts = {texture: text(cell) for texture, cell in cells.items()}
                if any(texts.values()):
                    rows.append({"what": f"{name}, at most" if bound and name == "noise alone" else name, **texts})
        columns = [Column("name", head="printer, filament"), Column("what", head="")]
        columns += [Column(texture, head=short_texture(texture), right=True) for texture in collection.textures]
        columns += [Column(name, right=True) for name in ("prints", "presses")]
        title = f"{title}, {self._level_name(level)} ({self.unit}{self._kind}, ddof {self.settings.ddof})"
        return _filled(columns, rows, title)

    @property
    def _kind(self) -> str:
        """What the numbers are, in a few words, for titles."""
        kind = f"; {'colour' if self.settings.colour else 'grey'}, full size" if self.in_counts else ""
        if self.settings.protocol == "as-published":
            kind = f"; grey not rounded, {100.0 * self.settings.resolution:g} % of the size" if kind else ""
        kind += "; series of moving frames" if self.settings.series else ""
        kind += f"; {self.settings.words.title}" if self.settings.words.title else ""
        return kind + (f"; inside {self.settings.roi}" if self.settings.roi else "")

    def _component_table(self) -> Table:
        """Return the components and ISO 5725's standard deviations, with a column for each level."""
        by_key = {(row["force_level"], row["component"]): row for row in self.tables["components"].rows}
        levels = shown_levels(self.cells)
        rows = [
            {"name": text, **{str(level): _component(by_key[level, name]) for level in levels}}
            for name, text in _COMPONENTS.items()
        ]
        for name in ("repeatability", "intermediate", "reproducibility"):
            texts = {}
            for level in levels:
                value = by_key[level, name]["variance"]
                sd = None if value is None else math.sqrt(value)
                texts[str(level)] = "" if sd is None else f"{short(sd)} (limit {short(LIMIT_FACTOR * sd)})"
            rows.append({"name": f"{name} SD ({self.settings.units})", **texts})
        columns = [Column("name", head="")]
        columns += [Column(str(level), head=self._level_name(level), right=True) for level in levels]
        return _filled(columns, rows, f"variance components of the nested design ({self.unit}, unbiased) and ISO 5725")

    def _test_table(self) -> Table:
        table = self.tables["permutation"]
        pooled = table.where(lambda row: row["force_level"] == ALL_LEVELS)
        return (pooled if pooled.rows else table).select(
            Column("force", derived=lambda row: self._level_name(row["force_level"])),
            Column("first", text=name_of),
            Column("second", text=name_of),
            Column("prints", derived=lambda row: f"{row['prints_first']}, {row['prints_second']}", right=True),
            *("ratio", "p", "p_holm", "least_p"),
            title="do two printers have the same variance between prints? (permutation test of prints)",
        )

    def _seating_table(self) -> Table:
        """Return the variance of each cell with and without differences in placement, and the largest offsets."""
        cells: dict[tuple[Any, ...], dict[str, Any]] = {}
        for row in self.tables["registration"].rows:
            cell = cells.setdefault(tuple(row[column.name] for column in CELL), {**row, "x_mm": None, "y_mm": None})
            for axis in ("x_mm", "y_mm"):
                offsets = [abs(values[axis]) for values in (cell, row) if values[axis] is not None]
                cell[axis] = max(offsets, default=None)
        table = Table(columns=COLUMNS["registration"], rows=tuple(cells.values()))
        return table.select(
            Column("force", derived=lambda row: self._level_name(row["force_level"])),
            *("printer", "filament", "texture", "variance", "seating", "variance_without_seating"),
            *(Column(f"{axis}_mm", head=f"largest offset {axis} (mm)", text=lambda mm: f"{mm:.3f}") for axis in "xy"),
            title="registration: the part of the variance that differences in placement explain (not in the paper)",
        )

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


def _component(row: Row) -> str:
    if row["variance"] is None:
        return str(row["note"] or "not estimated")
    ends = f" ({interval(row['low'], row['high'])})" if row["low"] is not None else ""
    return f"{short(row['variance'])}{ends}" + (
        f", with {row['includes'].replace(' ', ', ')}" if row["includes"] else ""
    )


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def _filled(columns: Sequence[Column], rows: Sequence[Row], title: str) -> Table:
    """Return a table of texts; missing values of a row are empty."""
    empty = dict.fromkeys((column.name for column in columns), "")
    return Table(columns=tuple(columns), rows=tuple({**empty, **row} for row in rows), title=title)
