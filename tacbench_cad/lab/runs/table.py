"""CSV files that only grow: a line is whole and on the disk before the next one begins; a torn last line is known."""

from __future__ import annotations

import csv
import errno
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.runs.schema import cell
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import refusing


@dataclass(frozen=True, kw_only=True)
class Lines:
    """What a CSV file holds.

    Args:
        rows: Line number (from 1, the head is line 1) and the columns' texts of every whole line after the head.
        torn: The bytes behind the last whole line; empty if the file ends as it should.
        whole_bytes: Where the last whole line ends.
    """

    rows: tuple[tuple[int, dict[str, str]], ...]
    torn: bytes
    whole_bytes: int


def read_lines(path: Path, columns: Sequence[str], faults: list[InputError] | None = None) -> Lines:
    """Read a CSV file.

    A line counts as torn if its newline is missing, or if zero bytes stand in it: both are what a power cut leaves of
    a line that was being appended. Only the end of the file can be torn so.

    Args:
        path: The file. One that is not there, or is empty, has no rows.
        columns: The columns that it must have; further ones are left alone.
        faults: A list to which lines with another number of fields are added, where they shall not be raised.

    Raises:
        InputError: It cannot be read, is not UTF-8, lacks a column, or a line has another number of fields.
    """
    if path.is_dir():
        raise InputError("file", str(path), "is a folder; it must be a CSV file")
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        content = b""
    except OSError as error:
        raise InputError("file", str(path), f"cannot be read: {error.strerror}") from None
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
    head = parsed[0] if parsed else list(columns)
    missing = [column for column in columns if column not in head]
    if missing:
        raise InputError(f"{path} line 1", ",".join(head)[:120], f"lacks the column {missing[0]}")
    rows = []
    for number, fields in enumerate(parsed[1:], start=2):
        if len(fields) != len(head):
            fault = InputError(
                f"{path} line {number}", ",".join(fields)[:120], f"has {len(fields)} fields where {len(head)} belong"
            )
            if faults is None:
                raise fault
            faults.append(fault)
            continue
        rows.append((number, dict(zip(head, fields, strict=True))))
    return Lines(rows=tuple(rows), torn=content[end:], whole_bytes=end)


class GrowingTable(Closing):
    """A CSV file to append to.

    Args:
        path: The file; it is made with its head if it is not there.
        columns: Its columns.
        durable: Force every line to the disk before :meth:`append` returns.

    Raises:
        InputError: What is there cannot be appended to; nothing was changed.

    Attributes:
        rows: The rows that were there: line number and texts.
        torn: What was cut off its end, as bytes.
    """

    def __init__(self, path: Path, columns: Sequence[str], *, durable: bool) -> None:
        found = read_lines(path, columns)
        self.path = path
        self.rows = found.rows
        self.torn = found.torn
        self._columns = tuple(columns)
        self._durable = durable
        with refusing(path.parent):
            self._handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0), 0o666)
            try:
                if found.torn:
                    os.ftruncate(self._handle, found.whole_bytes)
                if found.whole_bytes == 0:
                    self._write(columns)
                    sync_folder(path.parent)
                elif self._head() != self._columns:
                    raise InputError(str(path), None, "has its columns in another order than this program appends")
            except BaseException:
                os.close(self._handle)
                raise

    def append(self, values: Sequence[Any]) -> None:
        """Add a row; it is there as a whole or not at all, and with ``durable`` on the disk.

        Raises:
            InputError: The disk is full, or the file cannot be written any more.
        """
        with refusing(self.path.parent):
            self._write([cell(value) for value in values])

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

    def _head(self) -> tuple[str, ...]:
        with self.path.open(encoding="utf-8-sig", newline="") as stream:
            return tuple(next(csv.reader(stream)))

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
