"""CSV files that only grow: a line is whole and on the disk before the next one begins; a torn last line is known."""

from __future__ import annotations

import csv
import errno
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic

from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.runs.schema import T, cells, columns, parse_row
from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError, located
from tacbench_cad.util.files import refusing


@dataclass(frozen=True, kw_only=True)
class TableText:
    """The text of a CSV file.

    Args:
        header: The columns.
        rows: Line number (from 1, the header is line 1) and the columns' texts of every whole line after the header.
        torn: The bytes behind the last whole line; empty if the file ends as it should.
        whole_bytes: End of the last whole line.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[int, dict[str, str]], ...]
    torn: bytes
    whole_bytes: int


@dataclass(frozen=True, kw_only=True)
class RunTable(Generic[T]):
    """A CSV file of a run.

    Args:
        rows: Its rows.
        text: Their texts, and what is torn at the end of the file.
    """

    rows: tuple[T, ...]
    text: TableText


def read_table(
    folder: Path,
    kind: type[T],
    check: Callable[[int, T], None] | None = None,
    faults: list[InputError] | None = None,
) -> RunTable[T]:
    """Read a table of a run. A file that does not exist, or is empty, has no rows.

    Args:
        folder: The run folder.
        kind: What its rows are.
        check: Called with the line number and the row; raises an InputError where the row contradicts the others.
        faults: A list that takes the faults of single rows instead of their being raised.

    Raises:
        InputError: As :func:`read_lines`, or a row cannot be read; the message names its line.
    """
    path = folder / kind.FILE
    text = read_lines(path, columns(kind), faults, within=folder)
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

    A line counts as torn if its newline is missing, or if zero bytes stand in it: both are what a power cut leaves of
    a line that was being appended. Only the end of the file can be torn so.

    Args:
        path: The file. One that does not exist, or is empty, has no rows.
        names: The columns that it must have; further ones are ignored.
        faults: A list that takes the faults of lines with another number of fields instead of their being raised.
        within: A folder out of which no link may lead.

    Raises:
        InputError: It cannot be read, is not UTF-8, lacks a column, or a line has another number of fields.
    """
    content = door.read_bytes(path, kind="table", within=within) if os.path.lexists(path) else b""
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
        raise InputError(f"{path} line 1", ",".join(header)[:120], f"lacks the column {missing[0]}")
    rows = []
    for number, texts in enumerate(parsed[1:], start=2):
        if len(texts) == len(header):
            rows.append((number, dict(zip(header, texts, strict=True))))
            continue
        fault = InputError(
            f"{path} line {number}", ",".join(texts)[:120], f"has {len(texts)} fields where {len(header)} belong"
        )
        if faults is None:
            raise fault
        faults.append(fault)
    return TableText(header=tuple(header), rows=tuple(rows), torn=content[end:], whole_bytes=end)


def cut_torn_line(path: Path, text: TableText) -> None:
    """Cut off what stands behind the last whole line, and force that to the disk.

    Raises:
        InputError: The file cannot be written.
    """
    with refusing(path.parent), path.open("rb+") as stream:
        stream.truncate(text.whole_bytes)
        os.fsync(stream.fileno())


class GrowingTable(Closing, Generic[T]):
    """A CSV file to append to; it is made with its header if it does not exist.

    Args:
        folder: The run folder.
        kind: What its rows are.
        check: As of :func:`read_table`.
        durable: Force every line to the disk before :meth:`append` returns.

    Raises:
        InputError: What is there cannot be appended to; nothing was changed.

    Attributes:
        path: The file.
        rows: The rows that were there.
        torn: What was cut off its end, as bytes.
    """

    def __init__(
        self, folder: Path, kind: type[T], check: Callable[[int, T], None] | None = None, *, durable: bool
    ) -> None:
        table = read_table(folder, kind, check)
        self.path = path = folder / kind.FILE
        self.rows, self.torn = table.rows, table.text.torn
        self._durable = durable
        with refusing(path.parent):
            if self.torn:
                cut_torn_line(path, table.text)
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
            try:
                if table.text.whole_bytes == 0:
                    self._write(columns(kind))
                    if durable:
                        sync_folder(path.parent)
                elif table.text.header != columns(kind):
                    raise InputError(str(path), None, "has its columns in another order than this program appends")
            except BaseException:
                os.close(self._handle)
                raise

    def append(self, row: T) -> None:
        """Add a row; it is there as a whole or not at all, and with ``durable`` on the disk.

        Raises:
            InputError: The disk is full, or the file cannot be written any more.
        """
        with refusing(self.path.parent):
            self._write(cells(row))

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
        """Let go of the file."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1


def sync_folder(folder: Path) -> None:
    """Force a folder's list of files to the disk, where the system can.

    Windows needs no such thing; some network file systems cannot, and a folder may be writable without being readable:
    neither is a reason not to run.
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
