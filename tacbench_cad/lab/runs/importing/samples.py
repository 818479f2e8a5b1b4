"""What every kind of source gives: samples with their fields as texts, each with a function that loads its frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from tacbench_cad.spec.block import Block
from tacbench_cad.util.door import read_table
from tacbench_cad.util.errors import InputError, nearest, one_line

#: What may be said of a sample, each with the names of columns that are recognised without being mapped, best first.
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
    "index": ("index",),
    "video": ("video",),
    "time": ("time_s", "time"),
    "array": (),
}
#: Other words for fields in ``--columns``.
SYNONYMS = {"texture": "label", "copy": "print"}

#: The longest line about something that was left out, and about a table's columns.
MAX_LINE = 1500

#: The bytes of an image's file, or an array.
Loaded = bytes | NDArray[Any]


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One frame of a source.

    Args:
        name: What is loaded: ``img_3.png``.
        row: What says so: ``labels.csv line 7``; empty if nothing does.
        fields: What is said of it, by the names of :data:`FIELDS`; never an empty text.
        load: Gives its frame; raises an InputError or a CheckFailedError.
        block: The geometry of what was pressed, where the source's authors published it.
    """

    name: str
    row: str = ""
    fields: Mapping[str, str]
    load: Callable[[], Loaded]
    block: Block | None = None

    @property
    def where(self) -> str:
        """Where it stands, for messages: ``labels.csv line 7 (img_3.png)``."""
        return f"{self.row} ({self.name})" if self.row else self.name


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Something that was not imported.

    Args:
        where: Where it stands.
        reason: Why it was left out.
        count: Samples that it stands for.
    """

    where: str
    reason: str
    count: int = 1

    @property
    def line(self) -> str:
        """Both as a line of bounded length, whatever a file has in place of a name."""
        return one_line(f"{self.where}: {self.reason}", MAX_LINE)


@dataclass(frozen=True, kw_only=True)
class Source:
    """A folder or file that was recognised.

    Args:
        kind: What it is, in words for ``run.json``.
        path: The folder or file.
        samples: Its samples in order.
        left_out: What of it cannot be imported.
        files: Files that hold many frames; their checksums go into ``run.json``.
        facts: Further plain values for ``run.json``.
        notes: What the person should know: which columns were taken as what.
        threads: Whether frames may be loaded by several threads in any order.
        whole: Whether a file holds frames of one print only, so that the same file must not become two prints.
    """

    kind: str
    path: Path
    samples: Sequence[Sample]
    left_out: tuple[LeftOut, ...] = ()
    files: tuple[Path, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    threads: bool = False
    whole: bool = False


@dataclass(frozen=True, kw_only=True)
class Rows:
    """A table with its columns mapped.

    Args:
        name: What it is called in messages.
        rows: For each row where it stands, and its fields that are not empty.
        columns: The column behind each field.
        unused: Columns that are not used.
    """

    name: str
    rows: tuple[tuple[str, dict[str, str]], ...]
    columns: Mapping[str, str]
    unused: tuple[str, ...]

    @classmethod
    def of(
        cls, name: str, header: Sequence[str], rows: Sequence[Sequence[str]], chosen: Mapping[str, str], line: int = 2
    ) -> Rows:
        """Map the columns of a table.

        Args:
            name: What it is called.
            header: Its columns.
            rows: The texts of its rows.
            chosen: Columns by field, as the user maps them.
            line: Number of the first row in messages.

        Raises:
            InputError: A field or a column is unknown, or a column occurs twice.
        """
        columns = columns_of(name, header, chosen)
        places = {field: header.index(column) for field, column in columns.items()}
        mapped = tuple(
            (
                f"{name} line {number}",
                {field: text for field, place in places.items() if (text := row[place].strip())},
            )
            for number, row in enumerate(rows, start=line)
        )
        unused = tuple(column for column in header if column not in columns.values())
        return cls(name=name, rows=mapped, columns=columns, unused=unused)

    @classmethod
    def read(cls, path: Path, chosen: Mapping[str, str], within: Path | None = None) -> Rows:
        """Read a CSV file and map its columns.

        Raises:
            InputError: It cannot be read, or as :meth:`of`.
        """
        header, rows = read_table(path, "table", within=within)
        return cls.of(path.name, [column.strip() for column in header], rows, chosen)

    @property
    def note(self) -> str:
        """Which columns were taken as what."""
        taken = ", ".join(f"{field}={column}" for field, column in self.columns.items())
        rest = f"; not used: {', '.join(self.unused[:12])}" if self.unused else ""
        return one_line(f"{self.name}: {taken or 'no column'}{rest}", MAX_LINE)


def columns_of(name: str, header: Sequence[str], chosen: Mapping[str, str]) -> dict[str, str]:
    """The column of each field: as mapped, else one that has a usual name.

    Raises:
        InputError: A field or a column is unknown, or a column occurs twice.
    """
    twice = next((column for column in header if header.count(column) > 1), None)
    if twice is not None:
        raise InputError(f"{name} header", twice, "is the name of two columns; rename one")
    columns: dict[str, str] = {}
    for word, column in chosen.items():
        if field_of(word) == "array":
            continue
        if column not in header:
            raise InputError("columns", f"{word}={column}", f"{name} has no such column; {nearest(column, header)}")
        columns[field_of(word)] = column
    lowered = {column.lower(): column for column in header if column not in columns.values()}
    for name_of_field, usual in FIELDS.items():
        found = next((lowered.pop(word) for word in usual if word in lowered), None)
        if found is not None and name_of_field not in columns:
            columns[name_of_field] = found
    return {field: columns[field] for field in FIELDS if field in columns}


def field_of(word: str) -> str:
    """The field that a word of ``--columns`` means.

    Raises:
        InputError: There is no such field.
    """
    name = SYNONYMS.get(word, word)
    if name not in FIELDS:
        raise InputError("columns", word, nearest(word, FIELDS))
    return name
