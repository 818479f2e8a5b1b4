"""The options of an import, and the paths that the user gave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tacbench_cad.lab.rig.colours import OUTSIDE, Channels
from tacbench_cad.lab.runs.importing import companions
from tacbench_cad.util.convert import Checked
from tacbench_cad.util.errors import InputError


@dataclass(frozen=True, kw_only=True)
class ImportOptions(Checked):
    """Options for reading sources.

    Args:
        kind: The name of a format; None to recognise the format.
        columns: The columns of tables, by field: ``{"label": "material"}``. See
            :data:`~tacbench_cad.lab.runs.importing.sources.FIELDS` for the fields.
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
class Paths:
    """The paths that the user gave, for the tables and arrays that describe other paths."""

    given: tuple[Path, ...]
    _pairs: dict[Path, dict[Path, list[Path]]] = field(default_factory=dict)

    @property
    def tables(self) -> tuple[Path, ...]:
        """The tables."""
        return self.with_suffix(".csv")

    def with_suffix(self, *suffixes: str) -> tuple[Path, ...]:
        """Return the paths with one of some suffixes."""
        return tuple(path for path in self.given if path.suffix.lower() in suffixes)

    def table(self, path: Path) -> Path | None:
        """Return the table that belongs to a path.

        This is the table that the user gave, else the path itself if it is a table, else the only table in the path if
        it is a folder, else the table with the name of the file. The result is None if there is no such table.
        """
        if path.suffix.lower() == ".csv":
            return path
        if self.tables:
            return self.tables[0]
        if path.is_dir():
            return _only_table(path)
        beside = path.with_suffix(".csv")
        return beside if beside.is_file() else None

    def describing(self, path: Path) -> list[Path]:
        """Return the ``.npy`` files that describe the frames in a file: other paths of the user, or files beside it."""
        if path.parent not in self._pairs:
            files = dict.fromkeys([*self.with_suffix(".npy"), *sorted(path.parent.glob("[!.]*.npy"))])
            self._pairs[path.parent] = companions.pairs(list(files))
        return self._pairs[path.parent].get(path, [])


def _only_table(folder: Path) -> Path | None:
    """Return the only table in a folder; None if there is none.

    Raises:
        InputError: There are several tables.
    """
    tables = sorted(path for path in folder.glob("[!.]*.csv") if path.is_file())
    if len(tables) > 1:
        names = ", ".join(table.name for table in tables[:6])
        raise InputError("folder", str(folder), f"has several tables ({names}); also give the path of the one to use")
    return tables[0] if tables else None
