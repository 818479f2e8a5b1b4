"""The samples of a source: their fields as texts, with functions that load their frames."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from tacbench_cad.lab.rig.colours import OUTSIDE, Channels
from tacbench_cad.lab.runs.origins import ORIGINS_FILE
from tacbench_cad.spec.block import Block
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError, nearest, one_line
from tacbench_cad.util.untrusted import read_table

#: The fields of a sample, each with the column names that are recognised automatically, in order of preference.
FIELDS: Mapping[str, tuple[str, ...]] = {
    "image": ("image", "file", "file_name", "filename", "path", "sensor_image", "image_name"),
    "label": ("label", "labels", "texture", "class", "class_name", "object_label", "obj_lbl", "obj_id"),
    "print": ("print", "copy", "print_id"),
    "printer": ("printer",),
    "filament": ("filament",),
    "position": ("position",),
    "force": ("force", "force_n", "target_force_n", "force_level"),
    "repeat": ("repeat",),
    "session": ("session",),
    "measured_force": ("measured_force", "measured_force_n"),
    "x": ("x_mm", "pose_x"),
    "y": ("y_mm", "pose_y"),
    "z": ("z_mm", "pose_z"),
    "Rx": ("rx_deg", "pose_rx"),
    "Ry": ("ry_deg", "pose_ry"),
    "Rz": ("rz_deg", "pose_rz"),
    "index": ("index",),
    "video": ("video",),
    "time": ("time_s", "time"),
    "array": (),
}
#: The fields that must be numbers, each with its attribute of a row of ``targets.csv``.
MEASURED: Mapping[str, str] = {
    **{axis: f"pose_{axis}" for axis in "xyz"},
    **{f"R{axis}": f"pose_r{axis}" for axis in "xyz"},
    "measured_force": "measured_force_n",
}
#: Other names of fields in ``--columns``.
SYNONYMS = {"texture": "label", "copy": "print", "rx": "Rx", "ry": "Ry", "rz": "Rz"}

#: The largest number of characters of a line of the report.
MAX_LINE = 1500

#: A loaded frame: the bytes of an image's file, or an array.
Loaded = bytes | NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class ImportOptions(Checked):
    """Options for reading sources.

    Args:
        kind: The name of a format; None to recognise the format.
        columns: The columns of tables, by field: ``{"label": "material"}``. See
            :data:`FIELDS` for the fields.
        names: A TOML file that gives the names of the printers, filaments and labels for the words in the data.
        channels: The order of the colours in arrays, except in those of the paper's authors, which is known.
        of_format: Options that only the format ``kind`` has, by their names, as texts.
    """

    kind: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    names: Path | None = None
    channels: Channels = OUTSIDE
    of_format: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Sample:
    """A frame of a source.

    Args:
        name: The name of the frame: ``img_3.png``.
        row: The row of a table that lists it: ``labels.csv line 7``; empty if there is none.
        fields: The values by the names of :data:`FIELDS`; never an empty text.
        load: A function that returns the frame, or raises an InputError or a CheckFailedError.
        file: The file with the frame.
        index: The number of the frame in the file, from 0; None if the file has only one frame.
        columns: Everything that the source says about the frame, by the source's own names.
        channels: The order of the colours, if ``load`` returns an array.
        block: The geometry of the block, if it was published.
    """

    name: str
    row: str = ""
    fields: Mapping[str, str]
    load: Callable[[], Loaded]
    file: Path
    index: int | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    channels: Channels = OUTSIDE
    block: Block | None = None

    @property
    def where(self) -> str:
        """The row and the name, for messages: ``labels.csv line 7 (img_3.png)``."""
        return f"{self.row} ({self.name})" if self.row else self.name


@dataclass(frozen=True, kw_only=True)
class LeftOutFile:
    """One or more samples that were not imported.

    Args:
        where: The file, or the row of a table.
        reason: The reason why it was left out.
        count: The number of samples.
    """

    where: str
    reason: str
    count: int = 1

    @property
    def line(self) -> str:
        """The place and the reason as a line of at most :data:`MAX_LINE` characters."""
        return one_line(f"{self.where}: {self.reason}", MAX_LINE)


@dataclass(frozen=True, kw_only=True)
class Source:
    """A folder or file that was recognised.

    Args:
        kind: A description of the kind of source for ``run.json``.
        path: The folder or file.
        samples: The samples, in order.
        left_out: The parts that cannot be imported.
        files: The files with many frames. Their checksums are stored in ``run.json``.
        facts: Further plain values for ``run.json``.
        notes: Notes for the user: the meaning that was given to each column.
        threads: Whether several threads may load frames, in any order.
        whole: Whether each file has only frames of a single print, so that it must not be imported as two prints.
        base: The folder that contains the path that the user gave. The names of files are recorded relative to it.
    """

    kind: str
    path: Path
    samples: Sequence[Sample]
    left_out: tuple[LeftOutFile, ...] = ()
    files: tuple[Path, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    threads: bool = False
    whole: bool = False
    base: Path = Path()


class TableLine(NamedTuple):
    """A row of a table: its place, for messages; its non-empty fields; and its texts by column."""

    where: str
    fields: dict[str, str]
    texts: dict[str, str]


@dataclass(frozen=True, kw_only=True)
class Rows:
    """A table with its columns mapped.

    Args:
        name: The name of the table, for messages.
        rows: The rows.
        columns: The column of each field.
        unused: The columns that are not used.
    """

    name: str
    rows: tuple[TableLine, ...]
    columns: Mapping[str, str]
    unused: tuple[str, ...]

    @classmethod
    def of(
        cls, name: str, header: Sequence[str], rows: Sequence[Sequence[str]], chosen: Mapping[str, str], line: int = 2
    ) -> Rows:
        """Map the columns of a table.

        Args:
            name: The name of the table, for messages.
            header: The names of the columns.
            rows: The texts of the rows.
            chosen: The columns that the user chose, by field.
            line: The number of the first row, for messages.

        Raises:
            InputError: A field or a column is unknown, or a column occurs twice.
        """
        columns = columns_of_fields(name, header, chosen)
        places = {field: header.index(column) for field, column in columns.items()}
        mapped = tuple(
            TableLine(
                f"{name} line {number}",
                {field: text for field, place in places.items() if (text := row[place].strip())},
                dict(zip(header, row, strict=True)),
            )
            for number, row in enumerate(rows, start=line)
        )
        unused = tuple(column for column in header if column not in columns.values())
        return cls(name=name, rows=mapped, columns=columns, unused=unused)

    @classmethod
    def read(cls, path: Path, chosen: Mapping[str, str], within: Path | None = None) -> Rows:
        """Read a CSV file and map its columns.

        Raises:
            InputError: The file cannot be read, or same as for :meth:`of`.
        """
        header, rows = read_table(path, "table", within=within)
        return cls.of(path.name, [column.strip() for column in header], rows, chosen)

    @property
    def note(self) -> str:
        """A note for the user with the column of each field."""
        used = ", ".join(f"{field}={column}" for field, column in self.columns.items())
        rest = f"; kept in {ORIGINS_FILE}: {', '.join(self.unused[:12])}" if self.unused else ""
        return one_line(f"{self.name}: {used or 'no column'}{rest}", MAX_LINE)


def columns_of_fields(name: str, header: Sequence[str], chosen: Mapping[str, str]) -> dict[str, str]:
    """Return the column of each field: the user's choice, or else a column with a usual name.

    Raises:
        InputError: A field or a column is unknown, or a column occurs twice.
    """
    twice = next((column for column in header if header.count(column) > 1), None)
    if twice is not None:
        raise InputError(f"{name} header", twice, "is the name of two columns; rename one of them")
    columns: dict[str, str] = {}
    for word, column in chosen.items():
        if field_of(word) == "array":
            continue
        if column not in header:
            raise InputError("columns", f"{word}={column}", f"{name} has no such column; {nearest(column, header)}")
        columns[field_of(word)] = column
    lowered = {column.lower(): column for column in header if column not in columns.values()}
    for name_of_field, usual in FIELDS.items():
        match = next((lowered.pop(word) for word in usual if word in lowered), None)
        if match is not None and name_of_field not in columns:
            columns[name_of_field] = match
    return {field: columns[field] for field in FIELDS if field in columns}


def field_of(word: str) -> str:
    """Return the field for a name in ``--columns``.

    Raises:
        InputError: The field is unknown.
    """
    name = SYNONYMS.get(word.lower(), word)
    if name not in FIELDS:
        raise InputError("columns", word, nearest(word, FIELDS))
    return name
