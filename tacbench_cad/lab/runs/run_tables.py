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
from typing import Generic

from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.runs.schema import T, TableRow, cells, columns, parse_row
from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError, located
from tacbench_cad.util.files import refusing


@dataclass(frozen=True, kw_only=True)
class TableText:
    """The text of a CSV file.

    Args:
        header: The columns.
        rows: The line number (the header is line 1) and the texts by column of every complete line after the header.
        torn: The bytes after the last complete line; empty if the file ends with a complete line.
        whole_bytes: The length of the file up to the end of the last complete line, in bytes.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[int, dict[str, str]], ...]
    torn: bytes
    whole_bytes: int


@dataclass(frozen=True, kw_only=True)
class RunTable(Generic[T]):
    """A CSV file of a run.

    Args:
        rows: The rows.
        text: The text of the file.
    """

    rows: tuple[T, ...]
    text: TableText


def read_table(
    folder: Path,
    kind: type[T],
    check: Callable[[int, T], None] | None = None,
    faults: list[InputError] | None = None,
    *,
    below: str = "",
) -> RunTable[T]:
    """Read a table of a run. A missing or empty file has no rows.

    Args:
        folder: The run folder.
        kind: The dataclass of the rows.
        check: A function that is called with the line number and the row, and raises an InputError if the row
            contradicts the run or another row.
        faults: A list for the faults of single rows; None to raise the first fault.
        below: The path of the table's folder, relative to the run folder, for a table that each press has.

    Raises:
        InputError: Same as for :func:`read_lines`, or a row cannot be read. The message names the line.
    """
    path = folder / below / kind.FILE
    text = read_lines(path, columns(kind, ()), faults, within=folder)
    rows = []
    for line, values in text.rows:
        try:
            with located(f"{path} line {line}: "):
                row = parse_row(kind, values)
                if check is not None:
                    check(line, row)
            rows.append(row)
        except InputError as fault:
            if faults is None:
                raise
            faults.append(fault)
    return RunTable(rows=tuple(rows), text=text)


def read_lines(
    path: Path, names: Sequence[str], faults: list[InputError] | None = None, *, within: Path | None = None
) -> TableText:
    """Read the lines of a CSV file.

    A line is incomplete if its newline is missing or if it contains zero bytes. A power cut can leave such a line while
    it is being written, but only at the end of the file.

    Args:
        path: The file. A missing or empty file has no rows.
        names: The columns that the file must have. Other columns are ignored.
        faults: A list for the faults of lines with a wrong number of fields; None to raise the first fault.
        within: A folder that the file must lie in, also if ``path`` is a link.

    Raises:
        InputError: The file cannot be read, is not UTF-8 or lacks a column, or a line has a wrong number of fields.
    """
    content = untrusted.read_bytes(path, kind="table", within=within) if os.path.lexists(path) else b""
    end = content.rfind(b"\n") + 1
    zero = content.find(b"\0")
    if zero >= 0:
        end = min(end, content.rfind(b"\n", 0, zero) + 1)
    try:
        text = content[:end].decode("utf-8-sig")
        parsed = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except UnicodeDecodeError:
        raise InputError("file", str(path), "is not UTF-8 text") from None
    except csv.Error as error:
        raise InputError("file", str(path), f"is not a CSV file: {error}") from None
    header = parsed[0] if parsed else list(names)
    missing = [name for name in names if name not in header]
    if missing:
        raise InputError(f"{path} line 1", ",".join(header)[:120], f"the column {missing[0]} is missing")
    rows = []
    for number, texts in enumerate(parsed[1:], start=2):
        if len(texts) == len(header):
            rows.append((number, dict(zip(header, texts, strict=True))))
            continue
        fault = InputError(
            f"{path} line {number}",
            ",".join(texts)[:120],
            f"has {len(texts)} fields, but the header has {len(header)}",
        )
        if faults is None:
            raise fault
        faults.append(fault)
    return TableText(header=tuple(header), rows=tuple(rows), torn=content[end:], whole_bytes=end)


def table_text(names: Sequence[str], rows: Iterable[TableRow]) -> str:
    """Return the text of a CSV file with some columns of rows."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([names, *(cells(row, names) for row in rows)])
    return text.getvalue()


def cut_torn_line(path: Path, text: TableText) -> None:
    """Remove the bytes after the last complete line, and force the change to the disk.

    Raises:
        InputError: The file cannot be written.
    """
    with refusing(path.parent), path.open("rb+") as stream:
        stream.truncate(text.whole_bytes)
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
        self.rows, self.torn = table.rows, table.text.torn
        self._durable = durable
        with refusing(path.parent):
            if self.torn:
                cut_torn_line(path, table.text)
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
            try:
                if table.text.whole_bytes == 0:
                    self._write(self.columns)
                    if durable:
                        sync_folder(path.parent)
                elif table.text.header != self.columns:
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
