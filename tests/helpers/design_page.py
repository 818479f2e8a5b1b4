"""The design page, served by the real command."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def served(*words: str, out: Path) -> Iterator[str]:
    """Run ``tacbench design`` with these words, yield the address of its page, and interrupt it in the end."""
    command = [sys.executable, "-m", "tacbench_cad", "design", *words, "--no-browser", "-o", str(out)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        first = process.stderr.readline()
        assert first.startswith("open http://127.0.0.1:"), first + process.stderr.read()
        try:
            yield first.split()[1]
        finally:
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=30) == 0
