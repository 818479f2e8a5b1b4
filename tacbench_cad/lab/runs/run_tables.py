"""CSV files that rows are only added to. Each line is completely on the disk before the next is written.

An incomplete last line, as a power cut leaves it, is recognised.
"""

from __future__ import annotations

import csv
import errno
import io
import os
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.runs.schema import T, TableRow, cells, columns, parse_row
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError, located
from tacbench_cad.util.files import refusing


@dataclass(frozen=True, kw_only=True)
class RunTable(Generic[T]):
    """A CSV file of a run.

    Args:
        rows: The rows.
        header: The columns.
        torn: The bytes after the last complete line; empty if the file ends with a complete line.
        whole_bytes: The length of the file up to the end of the last complete line, in bytes.
    """

    rows: tuple[T, ...]
    header: tuple[str, ...]
    torn: bytes
    whole_bytes: int


def read_table(
    folder: Path,
    kind: type[T],
    check: Callable[[int, T], None] | None = None,
    faults: list[InputError] | None = None,
    *,
    below: str = "",
) -> RunTable[T]:
    """Read a table of a run. A missing or empty file has no rows. Columns that the rows do not have are ignored.

    A line is incomplete if its newline is missing or if it contains zero bytes. A power cut can leave such a line while
    it is being written, but only at the end of the file.

    Args:
        folder: The run folder.
        kind: The dataclass of the rows.
        check: A function that is called with the line number and the row, and raises an InputError if the row
            contradicts the run or another row.
        faults: A list for the faults of single rows; None to raise the first fault.
        below: The path of the table's folder, relative to the run folder, for a table that each press has.

    Raises:
        InputError: The file cannot be read, is not UTF-8 or lacks a column, or a row cannot be read. The message names
            the line.
    """
    path = folder / below / kind.FILE
    content = untrusted.read_bytes(path, kind="table", within=folder) if os.path.lexists(path) else b""
    end = content.rfind(b"\n") + 1
    zero = content.find(b"\0")
    if zero >= 0:
        end = min(end, content.rfind(b"\n", 0, zero) + 1)
    try:
        lines = list(csv.reader(io.StringIO(content[:end].decode("utf-8-sig"), newline=""), strict=True))
    except UnicodeDecodeError:
        raise InputError("file", str(path), "is not UTF-8 text") from None
    except csv.Error as error:
        raise InputError("file", str(path), f"is not a CSV file: {error}") from None
    header = lines[0] if lines else columns(kind)
    missing = [name for name in columns(kind, ()) if name not in header]
    if missing:
        raise InputError(f"{path} line 1", ",".join(header)[:120], f"the column {missing[0]} is missing")
    rows = []
    for line, texts in enumerate(lines[1:], start=2):
        try:
            with located(f"{path} line {line}: "):
                if len(texts) != len(header):
                    counts = f"has {len(texts)} fields, but the header has {len(header)}"
                    raise InputError("row", ",".join(texts)[:120], counts)
                row = parse_row(kind, dict(zip(header, texts, strict=True)))
                if check is not None:
                    check(line, row)
            rows.append(row)
        except InputError as fault:
            if faults is None:
                raise
            faults.append(fault)
    return RunTable(rows=tuple(rows), header=tuple(header), torn=content[end:], whole_bytes=end)


def table_text(names: Sequence[str], rows: Iterable[TableRow]) -> str:
    """Return the text of a CSV file with some columns of rows."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([names, *(cells(row, names) for row in rows)])
    return text.getvalue()


def cut_torn_line(path: Path, table: RunTable[Any]) -> None:
    """Remove the bytes after the last complete line, and force the change to the disk.

    Raises:
        InputError: The file cannot be written.
    """
    with refusing(path.parent), path.open("rb+") as stream:
        stream.truncate(table.whole_bytes)
        os.fsync(stream.fileno())


class GrowingTable(Closing, Generic[T]):
    """A CSV file that rows are added to. If it does not exist, it is created with its header.

    Args:
        folder: The run folder.
        kind: The dataclass of the rows.
        check: Same as for :func:`read_table`.
        durable: Force every line to the disk before :meth:`append` returns.
        optional: The optional fields of the rows that the table has.

    Raises:
        InputError: Rows cannot be added to the existing file. Nothing was changed.

    Attributes:
        path: The file.
        columns: Its columns.
        rows: The rows that the file had when it was opened.
        torn: The bytes of an incomplete last line, which was removed; empty if there was none.
    """

    def __init__(
        self,
        folder: Path,
        kind: type[T],
        check: Callable[[int, T], None] | None = None,
        *,
        durable: bool,
        optional: Collection[str] = (),
    ) -> None:
        table = read_table(folder, kind, check)
        self.path = path = folder / kind.FILE
        self.columns = columns(kind, optional)
        self.rows, self.torn = table.rows, table.torn
        self._durable = durable
        with refusing(path.parent):
            if self.torn:
                cut_torn_line(path, table)
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
            try:
                if table.whole_bytes == 0:
                    self._write(self.columns)
                    if durable:
                        sync_folder(path.parent)
                elif table.header != self.columns:
                    advice = "has other columns, or another order; restore the columns that this program wrote"
                    raise InputError(str(path), None, advice)
            except BaseException:
                os.close(self._handle)
                raise

    def append(self, row: T) -> None:
        """Add a row, completely or not at all. With ``durable``, the row is then on the disk.

        Raises:
            InputError: The disk is full, or the file can no longer be written.
        """
        with refusing(self.path.parent):
            self._write(cells(row, self.columns))

    def _write(self, texts: Sequence[str]) -> None:
        line = io.StringIO(newline="")
        csv.writer(line, lineterminator="\n").writerow(texts)
        data = line.getvalue().encode()
        before = os.fstat(self._handle).st_size
        try:
            left = data
            while left:
                left = left[os.write(self._handle, left) :]
            if self._durable:
                os.fsync(self._handle)
        except BaseException:
            os.ftruncate(self._handle, before)
            raise

    def close(self) -> None:
        """Close the file."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def sync_folder(folder: Path) -> None:
    """Force a folder's list of files to the disk, if the system can do so.

    Windows does not need this. Some network file systems cannot do it, and a writable folder may not be readable; both
    are ignored.
    """
    if os.name == "nt":
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EACCES):
            raise
