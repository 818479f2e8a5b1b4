"""Pages that are served by real commands."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def command(*words: str) -> subprocess.Popen[str]:
    """Start a command of this program that serves a page, without input."""
    return subprocess.Popen(
        [sys.executable, "-m", "tacbench_cad", *words, "--no-browser"],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def address_of(process: subprocess.Popen[str]) -> str:
    """Return the address of the page from the messages of the command."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("open http://127.0.0.1:"):
            return line.split()[1]
    raise AssertionError("the command ended without an address")


@contextmanager
def served(*words: str) -> Iterator[str]:
    """Run a command with these words, yield the address of its page, and interrupt it in the end."""
    with command(*words) as process:
        address = address_of(process)
        try:
            yield address
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=30) == 0
