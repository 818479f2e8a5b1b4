"""Safe reading of untrusted files. All input files are opened here, and TOML, JSON and CSV are parsed here.

An untrusted file can be a named pipe that never ends, a link to a device, a terabyte large, or a document with a number
of 400 digits or with 10,000 nested lists. This module refuses all of these with an
:class:`~tacbench_cad.util.errors.InputError` that names the file. The limits are generous. The environment variable
``TACBENCH_LIMITS`` multiplies them (for example ``TACBENCH_LIMITS=4``).
"""

from __future__ import annotations

import codecs
import csv
import io
import math
import os
import stat
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from tacbench_cad.util.errors import InputError, nearest, one_line

#: The environment variable that multiplies every limit.
LIMITS_VARIABLE = "TACBENCH_LIMITS"
#: The largest allowed size of each kind of file, in MB.
MAX_MB: Mapping[str, float] = {
    "toml": 8,
    "json": 64,
    "table": 128,
    "image": 256,
    "array": 65_536,  # mapped into memory, not read
    "mesh": 512,
    "step": 512,
    "gcode": 512,
    "any": 1024,
}
#: The limits of a document: levels of nesting, number of values, and largest whole number.
MAX_DEPTH, MAX_VALUES, MAX_WHOLE = 40, 20_000_000, 2**63 - 1
#: The limits of a CSV table: rows, columns, and characters in a field.
MAX_ROWS, MAX_COLUMNS, MAX_FIELD = 5_000_000, 1000, 1_000_000
#: The possible separators of a CSV table. The first is used if the header contains none of them.
_SEPARATORS = ",;\t"


def limits_factor() -> float:
    """Return the user's factor for all limits.

    Raises:
        InputError: The environment variable is not a positive number.
    """
    text = os.environ.get(LIMITS_VARIABLE, "1")
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise InputError(LIMITS_VARIABLE, text, "must be a positive number")
    return factor


def require_within(what: str, value: float, limit: float, unit: str, where: str | None = None) -> None:
    """Check that a size does not exceed a limit. The error message says how to raise the limit.

    Args:
        what: The kind of object, for the error message: ``image``.
        value: The size.
        limit: The limit, without the user's factor.
        unit: The unit of the size and the limit: ``MB``, ``triangles``.
        where: The file; None if ``what`` already names it.

    Raises:
        InputError: The value is larger than the limit.
    """
    if not value <= limit * limits_factor():
        needed = math.ceil(value / limit) if math.isfinite(value) else 0
        raising = f"; set the environment variable {LIMITS_VARIABLE}={needed} to allow it" if 0 < needed < 10**6 else ""
        size = f"{value:,.10g}" if math.isfinite(value) else str(value)
        raise InputError(
            what, where, f"has {size} {unit}, more than the {limit * limits_factor():,.10g} allowed{raising}"
        )


def open_input(path: Path, what: str = "file", kind: str = "any", *, within: Path | None = None) -> BinaryIO:
    """Open an untrusted file for reading bytes.

    Args:
        path: The file.
        what: The kind of document, for error messages: ``texture``.
        kind: The kind of file, a key of :data:`MAX_MB`, which limits its size.
        within: A folder that the file must lie in, also if ``path`` is a link.

    Raises:
        InputError: The file is missing, unreadable, too large, not a regular file, or outside ``within``.
    """
    try:
        _require_regular(path, what, path.stat().st_mode)
        if within is not None and not path.resolve().is_relative_to(within.resolve()):
            raise InputError(what, str(path), f"is a link to a file outside {within}; put the file itself there")
        # If a named pipe has replaced the file since the check above, it is opened without waiting and then refused.
        stream = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb")
    except InputError:
        raise
    except (OSError, ValueError, RuntimeError) as error:  # a null character in the name; a link to itself
        raise InputError(what, str(path), f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    try:
        status = os.fstat(stream.fileno())
        _require_regular(path, what, status.st_mode)
        require_within(what, math.ceil(status.st_size / 1e4) / 100, MAX_MB[kind], "MB", str(path))
    except BaseException:
        stream.close()
        raise
    return stream


def _require_regular(path: Path, what: str, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise InputError(what, str(path), "is a folder; name a file")
    if not stat.S_ISREG(mode):
        raise InputError(what, str(path), "is a pipe, a socket or a device; name a regular file")


def read_bytes(path: Path, what: str = "file", kind: str = "any", *, within: Path | None = None) -> bytes:
    """Read the bytes of an untrusted file; same arguments and errors as :func:`open_input`."""
    with open_input(path, what, kind, within=within) as stream:
        try:
            return stream.read()
        except OSError as error:
            raise InputError(what, str(path), f"cannot be read: {error.strerror or error}") from None


def read_text(path: Path, what: str = "file", kind: str = "any", *, within: Path | None = None) -> str:
    """Read an untrusted UTF-8 file without its byte order mark; same arguments as :func:`open_input`.

    Raises:
        InputError: Same as :func:`open_input`, or the file is not UTF-8 text.
    """
    try:
        return read_bytes(path, what, kind, within=within).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(what, str(path), "is not UTF-8 text") from None


def read_document(path: Path, what: str, kind: str, *, within: Path | None = None) -> Any:
    """Read an untrusted TOML or JSON file as plain values; ``kind`` is ``toml`` or ``json``.

    Raises:
        InputError: Same as :func:`open_input` and :func:`parse_toml`.
    """
    if kind == "toml":
        return parse_toml(read_text(path, what, kind, within=within), what, str(path))
    return parse_json(read_bytes(path, what, kind, within=within), what, str(path))


def parse_toml(text: str, what: str, name: str) -> dict[str, Any]:
    """Parse a TOML document into plain values within the limits of :func:`require_bounded`.

    Args:
        text: The document.
        what: The kind of document, for error messages: ``texture``.
        name: The name of the file, for error messages.

    Raises:
        InputError: The document is not valid TOML, or exceeds a limit.
    """
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, ValueError) as error:  # ValueError: a date or a number that Python cannot hold
        raise InputError(what, name, f"is not valid TOML: {one_line(error, 200)}") from None
    except RecursionError:
        raise InputError(what, name, f"is nested deeper than {MAX_DEPTH} levels") from None
    require_bounded(document, name)
    return document


def parse_json(text: str | bytes, what: str, name: str) -> Any:
    """Parse a JSON document into plain values; same arguments and errors as :func:`parse_toml`."""
    from pydantic_core import from_json  # imported here, so that commands that read no document start faster

    try:
        document = from_json(
            text.removeprefix(codecs.BOM_UTF8) if isinstance(text, bytes) else text, allow_inf_nan=False
        )
    except ValueError as error:
        raise InputError(what, name, f"is not valid JSON: {one_line(error, 200)}") from None
    require_bounded(document, name)
    return document


def read_rows(path: Path, what: str, columns: Sequence[str], *, within: Path | None = None) -> list[list[str]]:
    """Read the rows of a CSV table with a known header.

    Args:
        path: The file.
        what: The kind of document, for error messages: ``layout``.
        columns: The column names that the header must have, in this order.
        within: Same as for :func:`open_input`.

    Returns:
        The rows below the header, as lists of strings.

    Raises:
        InputError: The file cannot be read, has another header, a row of another length, or exceeds a limit.
    """
    header, rows = read_table(path, what, within=within)
    if header != list(columns):
        unknown = [name for name in header if name not in columns]
        hint = f'; "{unknown[0]}" is unknown, {nearest(unknown[0], columns)}' if unknown else ""
        raise InputError(f"{path} header", ",".join(header), f"must be {','.join(columns)}{hint}")
    return rows


def read_table(path: Path, what: str, *, within: Path | None = None) -> tuple[list[str], list[list[str]]]:
    """Read the header and the rows of a CSV table without blank lines; same arguments and errors as :func:`read_rows`.

    The header decides which separator is used: comma, semicolon (as spreadsheets write in many languages) or tab.
    """
    text, name = read_text(path, what, "table", within=within), str(path)
    rows: list[list[str]] = []
    previous_limit = csv.field_size_limit(MAX_FIELD)
    header = text.lstrip("\r\n").partition("\n")[0]
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=max(_SEPARATORS, key=header.count), strict=True)
    try:
        for row in reader:
            if not row:
                continue
            if len(row) != len(rows[0] if rows else row):
                raise InputError(
                    f"{name} line {reader.line_num}", None, f"has {len(row)} fields, but the header has {len(rows[0])}"
                )
            if len(row) > MAX_COLUMNS:
                raise InputError(f"{name} line {reader.line_num}", None, f"has more than {MAX_COLUMNS} columns")
            rows.append(row)
            if len(rows) > MAX_ROWS:
                require_within(what, math.inf, MAX_ROWS, "rows", name)
    except csv.Error as error:
        raise InputError(f"{name} line {reader.line_num}", None, f"is not valid CSV: {one_line(error, 200)}") from None
    finally:
        csv.field_size_limit(previous_limit)
    if not rows:
        raise InputError(what, name, "is empty; it needs a header line")
    if "\0" in text:
        raise InputError(what, name, "contains null characters, so it is not a CSV table")
    return rows[0], rows[1:]


def require_bounded(document: Any, name: str) -> None:
    """Check the limits of a document: nesting, number of values, and numbers within 64 bits.

    Args:
        document: The plain values that a parser returned.
        name: The name of the file, for the error message.

    Raises:
        InputError: A value exceeds a limit. The message names its key.
    """
    count, level, depth = 0, [(document, "")], 0
    while level:
        if depth > MAX_DEPTH:
            raise InputError(name, None, f"is nested deeper than {MAX_DEPTH} levels")
        inner: list[tuple[Any, str]] = []
        for value, key in level:
            if isinstance(value, int):
                if abs(value) > MAX_WHOLE:
                    raise InputError(f"{name}: {key}", None, f"must be a whole number of at most {MAX_WHOLE}")
            elif isinstance(value, float):
                if not math.isfinite(value):
                    raise InputError(f"{name}: {key}", value, "must be a finite number")
            elif isinstance(value, dict):
                inner += [(each, _key(key, word, each)) for word, each in value.items()]
            elif isinstance(value, list):
                inner += [(each, key) for each in value]
        count += len(inner)
        if count > MAX_VALUES:
            require_within(name, count, MAX_VALUES, "values")
        level, depth = inner, depth + 1


def _key(table: str, word: str, value: Any) -> str:
    """Return the name of a key in error messages: ``[protocol] depth_mm``."""
    word = word if len(word) <= 80 else f"{word[:77]}..."
    if isinstance(value, dict):
        return f"{table[:-2]}.{word}] " if table.endswith("] ") else f"[{word}] "
    return f"{table}{word}"
