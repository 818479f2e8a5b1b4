"""The one door for data from outside: files are opened here, and TOML, JSON and CSV are parsed here, within limits.

A file that somebody else wrote can be anything: a named pipe that never ends, a link to a device, a terabyte, a number
of 400 digits, a list nested 10,000 deep. Nothing of that gets further than this module. Every refusal is an
:class:`~tacbench_cad.util.errors.InputError` that names the file. The limits are generous; the environment variable
``TACBENCH_LIMITS`` multiplies them (``TACBENCH_LIMITS=4``).
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import stat
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

from tacbench_cad.util.errors import InputError, nearest, one_line

#: Multiplies every limit.
LIMITS_VARIABLE = "TACBENCH_LIMITS"
#: The largest file of each kind, in megabytes.
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
#: The deepest nesting of a document, the most values in it, and the largest whole number.
MAX_DEPTH, MAX_VALUES, MAX_WHOLE = 40, 20_000_000, 2**63 - 1
#: The most rows of a CSV table, columns in a row and characters in a field.
MAX_ROWS, MAX_COLUMNS, MAX_FIELD = 5_000_000, 1000, 1_000_000
#: What stands between the fields of a table; the first one where the header has none.
_SEPARATORS = ",;\t"


def limits_factor() -> float:
    """What the user multiplies all limits by.

    Raises:
        InputError: The environment variable is not a positive number.
    """
    text = os.environ.get(LIMITS_VARIABLE, "1")
    try:
        factor = float(text)
    except ValueError:
        factor = math.nan
    if not 0.0 < factor < math.inf:
        raise InputError(LIMITS_VARIABLE, text, "must be a positive number, which multiplies all limits")
    return factor


def require_within(what: str, value: float, limit: float, unit: str, where: str | None = None) -> None:
    """Refuse what exceeds a limit, and say how the limit is raised.

    Args:
        what: What has the value, as the field of the message: ``image``.
        value: The size that was met.
        limit: The limit, before the user's factor.
        unit: The unit of both: ``MB``, ``triangles``.
        where: The file or place; None where ``what`` says it.

    Raises:
        InputError: The value is larger than the limit.
    """
    if not value <= limit * limits_factor():
        needed = math.ceil(value / limit) if math.isfinite(value) else 0
        raising = f"; {LIMITS_VARIABLE}={needed} in the environment allows it" if 0 < needed < 10**6 else ""
        size = f"{value:,.10g}" if math.isfinite(value) else str(value)
        raise InputError(
            what, where, f"has {size} {unit}, more than the {limit * limits_factor():,.10g} allowed{raising}"
        )


def open_input(path: Path, what: str = "file", kind: str = "any", *, within: Path | None = None) -> BinaryIO:
    """Open a file from outside for reading bytes.

    Args:
        path: The file.
        what: What it is, for the messages: ``texture``.
        kind: Its kind, one of :data:`MAX_MB`, which limits its size.
        within: A folder out of which no link may lead.

    Raises:
        InputError: It is missing, unreadable, too large, not a regular file, or a link out of ``within``.
    """
    try:
        _require_regular(path, what, path.stat().st_mode)
        if within is not None and not path.resolve().is_relative_to(within.resolve()):
            raise InputError(what, str(path), f"is a link that leads out of {within}; put the file itself there")
        # A named pipe that took the file's place since is opened without waiting, and refused.
        stream = os.fdopen(os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)), "rb")
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
        raise InputError(what, str(path), "is not a regular file but a pipe, a socket or a device")


def read_bytes(path: Path, what: str = "file", kind: str = "any", *, within: Path | None = None) -> bytes:
    """The bytes of a file from outside; arguments and errors as of :func:`open_input`."""
    with open_input(path, what, kind, within=within) as stream:
        try:
            return stream.read()
        except OSError as error:
            raise InputError(what, str(path), f"cannot be read: {error.strerror or error}") from None


def read_text(path: Path, what: str = "file", kind: str = "any", *, within: Path | None = None) -> str:
    """The UTF-8 text of a file from outside, without a byte order mark; arguments as of :func:`open_input`.

    Raises:
        InputError: As :func:`open_input`, or it is not UTF-8.
    """
    try:
        return read_bytes(path, what, kind, within=within).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(what, str(path), "is not UTF-8 text") from None


def read_document(path: Path, what: str, kind: str, *, within: Path | None = None) -> Any:
    """The plain values of a TOML or JSON file from outside; ``kind`` is ``toml`` or ``json``.

    Raises:
        InputError: As :func:`open_input` and :func:`parse_toml`.
    """
    if kind == "toml":
        return parse_toml(read_text(path, what, kind, within=within), what, str(path))
    return parse_json(read_bytes(path, what, kind, within=within), what, str(path))


def parse_toml(text: str, what: str, name: str) -> dict[str, Any]:
    """A TOML document as plain values, all of them bounded.

    Args:
        text: The document.
        what: What it is, for the messages: ``texture``.
        name: The file's name, for the messages.

    Raises:
        InputError: It is not TOML, or nested too deep, or has a number or a text that cannot be used.
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
    """A JSON document as plain values, all of them bounded; arguments and errors as of :func:`parse_toml`."""
    try:
        document = json.loads(text, parse_constant=_no_constant)
    except UnicodeDecodeError:
        raise InputError(what, name, "is not UTF-8 text") from None
    except ValueError as error:
        raise InputError(what, name, f"is not valid JSON: {one_line(error, 200)}") from None
    except RecursionError:
        raise InputError(what, name, f"is nested deeper than {MAX_DEPTH} levels") from None
    require_bounded(document, name)
    return document


def _no_constant(word: str) -> NoReturn:
    raise ValueError(f"{word} is not a number")


def read_rows(path: Path, what: str, columns: Sequence[str], *, within: Path | None = None) -> list[list[str]]:
    """The rows of a CSV table below its header line.

    Args:
        path: The file.
        what: What it is, for the messages: ``layout``.
        columns: The names that the header must have, in this order.
        within: As of :func:`open_input`.

    Returns:
        Texts, as many in each row as there are columns.

    Raises:
        InputError: The file cannot be read, has another header, a row of another length, or too much of anything.
    """
    header, rows = read_table(path, what, within=within)
    if header != list(columns):
        unknown = [name for name in header if name not in columns]
        hint = f'; "{unknown[0]}" is unknown, {nearest(unknown[0], columns)}' if unknown else ""
        raise InputError(f"{path} header", ",".join(header), f"must be {','.join(columns)}{hint}")
    return rows


def read_table(path: Path, what: str, *, within: Path | None = None) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of a CSV table; arguments and errors as of :func:`read_rows`."""
    return parse_table(read_text(path, what, "table", within=within), what, str(path))


def parse_table(text: str, what: str, name: str) -> tuple[list[str], list[list[str]]]:
    """The header and the rows of a CSV table; blank lines are left out.

    The fields are separated as the header's are: by commas, semicolons (spreadsheets in many languages) or tabs.

    Args:
        text: The table.
        what: What it is, for the messages.
        name: The file's name, for the messages.

    Raises:
        InputError: It is no CSV table, has no header, a row of another length, or too much of anything.
    """
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
                    f"{name} line {reader.line_num}", None, f"has {len(row)} fields, the header {len(rows[0])}"
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
        raise InputError(what, name, "is empty; a header line is needed")
    if "\0" in text:
        raise InputError(what, name, "has null characters; it is not a table")
    return rows[0], rows[1:]


def require_bounded(document: Any, name: str) -> None:
    """Refuse what no document of ours can hold: absurd nesting and counts, numbers beyond 64 bits, half characters.

    Args:
        document: Plain values, as a parser gives them.
        name: The file's name, for the message.

    Raises:
        InputError: There is such a value; the message names its key.
    """
    count, level, depth = 0, [(document, "")], 0
    while level:
        if depth > MAX_DEPTH:
            raise InputError(name, None, f"is nested deeper than {MAX_DEPTH} levels")
        inner: list[tuple[Any, str]] = []
        for value, key in level:
            if isinstance(value, str):
                _require_characters(value, name, key)
            elif isinstance(value, int):
                if abs(value) > MAX_WHOLE:
                    raise InputError(f"{name}: {key}", None, f"must be a whole number of at most {MAX_WHOLE}")
            elif isinstance(value, float):
                if not math.isfinite(value):
                    raise InputError(f"{name}: {key}", value, "must be a finite number")
            elif isinstance(value, dict):
                for word, each in value.items():
                    _require_characters(word, name, key)
                    inner.append((each, _key(key, word, each)))
            elif isinstance(value, list):
                inner += [(each, key) for each in value]
        count += len(inner)
        if count > MAX_VALUES:
            require_within(name, count, MAX_VALUES, "values")
        level, depth = inner, depth + 1


def _key(table: str, word: str, value: Any) -> str:
    """``[protocol] depth_mm``, as in every message about a document."""
    word = word if len(word) <= 80 else f"{word[:77]}..."
    if isinstance(value, dict):
        return f"{table[:-2]}.{word}] " if table.endswith("] ") else f"[{word}] "
    return f"{table}{word}"


def _require_characters(text: str, name: str, key: str) -> None:
    if not text.isascii():
        try:
            text.encode()
        except UnicodeEncodeError:
            raise InputError(f"{name}: {key}".rstrip(), text[:80], "has half a character (a lone surrogate)") from None
