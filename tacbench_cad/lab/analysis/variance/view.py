"""What people, files and other programs see of a variance table: put together here, rendered elsewhere.

The command prints these tables, ``--json`` has their records, the folder of results their CSV files, and the report
reads those files again and shows the same tables.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tacbench_cad import __version__
from tacbench_cad.lab.analysis import answers
from tacbench_cad.lab.analysis.collection import Collection
from tacbench_cad.lab.analysis.published import FLOOR, PAPER_FLOORS
from tacbench_cad.lab.analysis.tables import Column, Row, Table, read_settings, write_settings
from tacbench_cad.lab.analysis.variance.cells import (
    ALL_LEVELS,
    FRAMES,
    REPEATS,
    Cell,
    Level,
    name_of,
    parts_of,
    short_texture,
    shown_levels,
    squared,
)
from tacbench_cad.lab.analysis.variance.components import LIMIT_FACTOR
from tacbench_cad.lab.analysis.variance.notes import variance_warnings
from tacbench_cad.lab.analysis.variance.registration import Seating
from tacbench_cad.lab.analysis.variance.table import Protocol, VarianceResult
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked
from tacbench_cad.util.text import interval, short

#: What was asked for, beside the tables.
SETTINGS_FILE = "variance_settings.json"


def _level(text: str) -> Level:
    return text if text == ALL_LEVELS else int(text)


_PRINTER = (Column("printer"), Column("filament"))
_CELL = (*_PRINTER, Column("texture"), Column("force_level", _level))
#: Fields of a cell by their columns in ``floor_removed.csv``, where these have other names.
_REMOVED = {"variance": "unbiased", "low": "floor_removed_low", "high": "floor_removed_high"}
#: The columns of each CSV file, by its name without suffix.
COLUMNS: Mapping[str, tuple[Column, ...]] = {
    "printer_answers": answers.COLUMNS,
    "variance": (
        *_CELL,
        *(Column(name, float) for name in ("variance", "floor", "low", "high")),
        *(Column(name, int) for name in ("prints", "presses")),
        Column("noise_alone", float),
        Column("quantity"),
        Column("published", float),
    ),
    # Everything in it is for ddof 1.
    "floor_removed": (
        *_CELL,
        Column("variance", float, source=_REMOVED["variance"]),
        Column("floor", float),
        Column("floor_from"),
        Column("floor_removed", float),
        *(Column(name, float, source=_REMOVED[name]) for name in ("low", "high")),
    ),
    "components": (
        Column("force_level", _level),
        Column("component"),
        *(Column(name, float) for name in ("variance", "truncated", "low", "high")),
        Column("degrees_of_freedom", int),
        Column("includes"),
        Column("note"),
    ),
    "between_textures": (
        *_PRINTER,
        Column("force_level", _level),
        Column("texture"),
        Column("other_texture"),
        Column("variance", float),
        Column("presses", int),
    ),
    "positions": (
        *_CELL,
        Column("position", int),
        *(Column(name, float) for name in ("x_mm", "y_mm", "variance")),
    ),
    "displacements": (
        *_CELL,
        Column("marker", int),
        *(Column(name, float) for name in ("x_px", "y_px", "dx_px", "dy_px")),
    ),
    "permutation": (
        Column("force_level", _level),
        Column("first"),
        Column("second"),
        Column("textures", int, source="outcome.textures"),
        Column("prints_first", int, source=lambda test: test.outcome.prints[0]),
        Column("prints_second", int, source=lambda test: test.outcome.prints[1]),
        *(Column(name, float, source=f"outcome.{name}", text=short) for name in ("ratio", "statistic", "p")),
        Column("p_holm", float, "p for all pairs", text=short),
        Column("least_p", float, "least p possible", source="outcome.least_p", text=short),
    ),
    "registration": (
        *_CELL,
        Column("copy", int),
        *(Column(name, float) for name in ("x_mm", "y_mm")),
        *(Column(name, float, text=short) for name in ("variance", "seating")),
        Column("variance_without_seating", float, "without seating", text=short),
    ),
}
#: The files that hold the quantity of the protocol ``as-published``; the others are of the text's.
AS_PUBLISHED_FILES = ("variance", "floor_removed", "positions")
_COMPONENTS = {"texture": "texture", "printer": "printer-filament", "print": "print", "repeat": "repeat on one print"}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What was asked for: a report's methods paragraph names it. The fields are the keys of the settings file."""

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
    features: Literal["pixels", "markers"] = "pixels"
    markers: int = 0
    roi: str = ""
    outside: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class VarianceView:
    """A variance table as it is shown.

    Args:
        collection: The study.
        settings: What was asked for.
        cells: The cells.
        tables: By the names of :data:`COLUMNS`; read from files without those that nobody is shown.
    """

    collection: Collection
    settings: Settings
    cells: tuple[Cell, ...]
    tables: Mapping[str, Table]

    @classmethod
    def of(cls, result: VarianceResult, seatings: Sequence[Seating] = ()) -> VarianceView:
        """The view of a result.

        Args:
            result: The result.
            seatings: What registration gave, if it was asked for.
        """
        items: dict[str, Sequence[object]] = {
            "printer_answers": list(answers.print_answers(result)) if result.protocol == "paper" else (),
            "variance": result.cells,
            "floor_removed": result.cells,
            "components": result.components,
            "between_textures": list(_pairs(result)),
            "positions": list(_positions(result)),
            "displacements": list(_displacements(result)),
            "permutation": result.tests,
            "registration": [row for seating in seatings for row in seating.rows()],
        }
        preprocess = result.preprocess
        return cls(
            collection=result.collection,
            settings=Settings(
                protocol=result.protocol,
                colour=preprocess.colour,
                resolution=preprocess.resolution,
                ddof=result.ddof,
                seed=result.seed,
                registered=bool(seatings),
                left_out=result.left_out,
                data=result.collection.data_key,
                features=preprocess.features,
                markers=preprocess.markers.count if preprocess.markers else 0,
                roi=preprocess.region.text if preprocess.region else "",
                outside=result.outside,
            ),
            cells=result.cells,
            tables={
                name: Table.of(COLUMNS[name], rows)
                for name, rows in items.items()
                if result.protocol == "paper" or name in AS_PUBLISHED_FILES
            },
        )

    @classmethod
    def read(cls, folder: Path, collection: Collection) -> VarianceView:
        """The view in a folder that ``tacbench variance`` wrote.

        Raises:
            InputError: A file is missing or damaged.
        """
        settings = read_settings(folder / SETTINGS_FILE, Settings)
        names = ["variance", "floor_removed"]
        if settings.protocol == "paper":
            names += ("printer_answers", "components", "permutation", *["registration"] * settings.registered)
        tables = {name: Table.read(folder / f"{name}.csv", COLUMNS[name]) for name in names}
        try:
            cells = tuple(
                Cell(
                    **cell,
                    floor_from=removed["floor_from"] or "",
                    floor_removed=removed["floor_removed"],
                    **{attribute: removed[name] for name, attribute in _REMOVED.items()},
                )
                for cell, removed in zip(tables["variance"].rows, tables["floor_removed"].rows, strict=True)
            )
        except (InputError, TypeError, ValueError) as error:
            raise InputError("table", str(folder / "variance.csv"), f"holds a wrong value: {error}") from None
        collection = replace(collection, features=settings.features)
        return cls(collection=collection, settings=settings, cells=cells, tables=tables)

    def write(self, folder: Path) -> list[Path]:
        """Write every table as CSV, and the settings.

        Raises:
            InputError: A file cannot be written.
        """
        optional = {"registration": self.settings.registered, "displacements": self.settings.features == "markers"}
        names = [name for name in self.tables if optional.get(name, True)]
        paths = [self.tables[name].write(folder / f"{name}.csv", self.collection.simulated) for name in names]
        return [*paths, write_settings(folder / SETTINGS_FILE, self.settings)]

    def document(self) -> dict[str, Any]:
        """The values of ``--json``."""
        keys = [column.name for column in COLUMNS["variance"]]
        return {
            "simulated": list(self.collection.simulated),
            "protocol": self.settings.protocol,
            "units": self.unit,
            "grey": not self.settings.colour,
            "ddof": self.settings.ddof,
            **{key: getattr(self.settings, key) for key in ("features", "markers", "roi", "outside")},
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
                if name not in (*AS_PUBLISHED_FILES, "displacements")
            },
            "warnings": list(self.warnings),
            "left_out": list(self.settings.left_out),
        }

    @property
    def unit(self) -> str:
        """The unit of a variance: ``counts^2``."""
        return squared(self.collection.units)

    @property
    def floor_sources(self) -> list[str]:
        """Where the noise floors come from."""
        return sorted({cell.floor_from for cell in self.cells if cell.floor_from})

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know, a sentence each."""
        return variance_warnings(self.collection, self.cells, self.settings.left_out)

    @property
    def notes(self) -> list[str]:
        """How the tables are to be read, a sentence or two each."""
        words = {
            FRAMES: "stationary frames in contact, at the middle force",
            REPEATS: "repeats on one print, an upper bound",
        }
        sources = "; or ".join(words[source] for source in self.floor_sources if source in words)
        notes = [
            "Noise alone: what the table would show if a cell's readings differed by the sensor's noise only"
            f"{f' ({sources})' if sources else ''}. Interval: prints are its unit. Floor removed: variance with ddof 1 "
            "less the floor."
        ]
        if self.settings.features == "markers":
            notes.append(
                f"Variance of displacement: of each of {self.settings.markers} markers from its place without contact, "
                "mean over the markers and both axes of the image. Where one is hidden, its neighbours predict it. "
                "Lighting does not change these figures, and the paper's in counts^2 cannot be compared with them."
            )
        if self.settings.roi:
            notes.append(f"Region of interest: {self.settings.roi}; what lies outside of it is not in any figure.")
        elif self.settings.outside is not None:
            how = ": --roi auto leaves them out" if self.settings.protocol == "paper" else ""
            outside = f"{100 * self.settings.outside:.0f} %"
            notes.append(f"{outside} of the pixels lie outside the sensor and are in each variance{how}.")
        if self.collection.in_counts and self.collection.beside_paper:
            notes.append(self._on_the_paper)
        return notes

    @property
    def _on_the_paper(self) -> str:
        """What the paper's figures are beside these: of images, since its own are counts."""
        if self.settings.protocol == "paper":
            return (
                "The paper's printed figures are another quantity, the variance over the two repeats on one print; "
                '"tacbench variance --protocol as-published" computes it and sets them beside it.'
            )
        readings = ", ".join(f"{value:.3g} counts^2 if it is a {what}" for what, value in PAPER_FLOORS.items())
        return (
            "The variance over the repeats on one print, then the mean over prints, positions and pixels, is what the "
            "paper's printed figures are by the authors' notebooks; it says nothing of how prints differ. The printed "
            "figures are of four prints at the lowest force, from frames of other textures too (row numbers were kept "
            f"in 8 bits). The paper gives the average pixel variation of a stationary sensor as {FLOOR:g}, without a "
            f"unit: {readings}."
        )

    @property
    def answers(self) -> Table:
        """What the data say of the printers in plain words; not of the protocol ``as-published``."""
        return answers.shown(self.tables["printer_answers"])

    def shown(self) -> Iterator[tuple[str, Table]]:
        """The tables that people are shown, each with the name of the file that has it with every digit."""
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
        """The variance table at one level: a few lines for each printer-filament, a column for each texture."""
        collection = self.collection
        by_key = {(cell.combination, cell.texture): cell for cell in self.cells if cell.force_level == level}
        most = max(cell.variance for cell in by_key.values())
        decimals = 2 if most <= 0.0 else min(12, max(0, 2 - math.floor(math.log10(most))))

        def number(value: float | None) -> str:
            return "" if value is None else f"{round(value, decimals) + 0.0:.{decimals}f}"  # no minus where all are 0

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
        """What was made of images first."""
        kind = f"; {'colour' if self.settings.colour else 'grey'}, full size" if self.collection.in_counts else ""
        if self.settings.protocol == "as-published":
            kind = f"; grey not rounded, {100.0 * self.settings.resolution:g} % of the size" if kind else ""
        kind += "; displacement of markers" if self.settings.features == "markers" else ""
        return kind + (f"; inside of {self.settings.roi}" if self.settings.roi else "")

    def _component_table(self) -> Table:
        """The components and ISO 5725's standard deviations, a column for each level."""
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
            rows.append({"name": f"{name} s.d. ({self.collection.units})", **texts})
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
            title="do two printers vary alike from print to print? (permutation test, prints permuted)",
        )

    def _seating_table(self) -> Table:
        """The variance of each cell with and without differences in placement, and the largest of these."""
        cells: dict[tuple[Any, ...], dict[str, Any]] = {}
        for row in self.tables["registration"].rows:
            cell = cells.setdefault(tuple(row[column.name] for column in _CELL), {**row, "x_mm": None, "y_mm": None})
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
        folder: The folder; it is made if it is not there.
        seatings: What registration gave, if it was asked for.

    Returns:
        The files.

    Raises:
        InputError: The folder cannot be written, or another process is writing to it.
        MissingToolError: matplotlib is not installed; the tables are written all the same.
    """
    from tacbench_cad.lab.analysis.variance.figures import draw_all

    with locked(folder):
        return [*VarianceView.of(result, seatings).write(folder), *draw_all(result, folder)]


def _pairs(result: VarianceResult) -> Iterator[Row]:
    """Rows of ``between_textures.csv``: each pair once, and each texture with itself."""
    for matrix in result.matrices:
        for i, j in zip(*np.triu_indices(len(matrix.textures)), strict=True):
            if matrix.presses[i, j]:
                yield {
                    **parts_of(matrix.combination),
                    "force_level": matrix.force_level,
                    "texture": matrix.textures[i],
                    "other_texture": matrix.textures[j],
                    "variance": float(matrix.variance[i, j]),
                    "presses": int(matrix.presses[i, j]),
                }


def _displacements(result: VarianceResult) -> Iterator[Row]:
    """Rows of ``displacements.csv``: mean displacement of each marker, and its place at rest in the first run."""
    markers = result.preprocess.markers
    places = [] if markers is None else next(iter(markers.references_px.values())).tolist()
    for (level, (combination, texture)), moved in result.fields.items():
        for number, ((x, y), (dx, dy)) in enumerate(zip(places, moved.tolist(), strict=True), start=1):
            cell = {**parts_of(combination), "texture": texture, "force_level": level, "marker": number}
            yield {**cell, "x_px": x, "y_px": y, "dx_px": dx, "dy_px": dy}


def _positions(result: VarianceResult) -> Iterator[Row]:
    """Rows of ``positions.csv``."""
    places = result.collection.pressing.positions_mm
    for (level, (combination, texture)), values in result.positions.items():
        for number in np.flatnonzero(np.isfinite(values)).tolist():
            yield {
                **parts_of(combination),
                "texture": texture,
                "force_level": level,
                "position": number + 1,
                "x_mm": float(places[number, 0]),
                "y_mm": float(places[number, 1]),
                "variance": float(values[number]),
            }


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
    """A table of texts in which what a row lacks is empty."""
    empty = dict.fromkeys((column.name for column in columns), "")
    return Table(columns=tuple(columns), rows=tuple({**empty, **row} for row in rows), title=title)
