"""The message of a command about an unexpected exception."""

from __future__ import annotations

import os
import shlex
import tempfile
import traceback
from collections.abc import Sequence

from tacbench_cad import __version__
from tacbench_cad.cli.common import note
from tacbench_cad.util.errors import one_line

#: Environment variable with the path of the file that takes tracebacks.
LOG_VARIABLE = "TACBENCH_LOG"


def report_unexpected(error: Exception, words: Sequence[str]) -> None:
    """Print one line with the command and the exception, and write the traceback to a log file that the line names.

    Args:
        error: The exception.
        words: The arguments of the command line.
    """
    command = one_line(shlex.join(["tacbench", *words]), 300)
    try:
        where = f"the traceback is in {_logged(error, words)}"
    except OSError as failure:
        where = f"the log file cannot be written: {failure}"
    reason = one_line(error) or "no message"
    note(f"error: unexpected {type(error).__name__} in {command}: {reason}; {where}")


def _logged(error: Exception, words: Sequence[str]) -> str:
    """Append the traceback to the log file, or to a new one in the system's temporary folder, and return its path."""
    name = os.environ.get(LOG_VARIABLE)
    if name:
        descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
    else:
        descriptor, name = tempfile.mkstemp(prefix="tacbench-", suffix=".log")
    with os.fdopen(descriptor, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(f"tacbench {__version__}: {shlex.join(['tacbench', *words])}\n")
        file.writelines(traceback.format_exception(error))
    return name
