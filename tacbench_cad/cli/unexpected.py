"""The message of a command about an unexpected exception."""

from __future__ import annotations

import os
import shlex
import tempfile
import traceback
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from tacbench_cad import __version__
from tacbench_cad.cli.common import note
from tacbench_cad.util.errors import InputError, one_line

#: Environment variable with the path of the file that takes tracebacks.
LOG_VARIABLE = "TACBENCH_LOG"


def report_unexpected(error: Exception, words: Sequence[str]) -> int:
    """Print one line about the exception, and write the traceback to a log file that the line names.

    Args:
        error: The exception.
        words: The arguments of the command line.

    Returns:
        The exit code: 2 if one of the input files was being read, otherwise 1.
    """
    path = _file_being_read(error, words)
    blamed = "" if path is None else f"{path}: "
    command = shlex.join(["tacbench", *words])
    text = "".join([f"tacbench {__version__}: {command}\n", *traceback.format_exception(error)])
    try:
        where = f"the traceback is in {_logged(text)}"
    except OSError as failure:
        where = f"the log file cannot be written: {failure}"
    note(f"error: {blamed}unexpected {type(error).__name__}: {one_line(error) or 'no message'}; {where}")
    return 1 if path is None else InputError.exit_code


def _logged(text: str) -> str:
    """Append to the log file, or to a new one in the system's temporary folder."""
    name = os.environ.get(LOG_VARIABLE)
    if name:
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    else:
        descriptor, name = tempfile.mkstemp(prefix="tacbench-", suffix=".log")
    with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(text)
    return name


def _file_being_read(error: Exception, words: Sequence[str]) -> Path | None:
    """The file that the innermost function worked on, if it is one of the inputs or is in an input folder."""
    inputs = list(_inputs(words))
    for path in _paths(error):
        place = _place(path, Path.is_file)
        if place is not None and any(place.is_relative_to(root) for root in inputs):
            return path
    return None


def _place(path: Path, test: Callable[[Path], bool]) -> Path | None:
    """The absolute path, or None if it does not pass a test. A path that may not be read passes it."""
    place = path
    try:
        place = path.absolute()
        return place if test(place) else None
    except PermissionError:
        return place
    except (OSError, ValueError, RuntimeError):  # too long, a null character, a link to itself, no current folder
        return None


def _paths(error: Exception) -> Iterator[Path]:
    """The paths in an exception and in the local variables of the functions that it left, the innermost first."""
    if isinstance(error, OSError) and isinstance(error.filename, str):
        yield Path(error.filename)
    for frame, _ in reversed(list(traceback.walk_tb(error.__traceback__))):
        yield from (value for value in list(frame.f_locals.values()) if isinstance(value, Path))


def _inputs(words: Sequence[str]) -> Iterator[Path]:
    """The absolute paths of the files and folders in the command line that exist, except the output."""
    for before, word in pairwise(("", *words)):
        if before not in ("-o", "--out") and not word.startswith(("-o", "--out")):
            paths = [Path(part) for part in word.rpartition("=")[2].split(",") if part]
            yield from (place for path in paths if (place := _place(path, Path.exists)) is not None)
