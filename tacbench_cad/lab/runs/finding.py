"""Where run folders lie."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from tacbench_cad.lab.runs import schema
from tacbench_cad.util.errors import InputError


def find_runs(folders: Iterable[Path]) -> list[Path]:
    """The run folders among and below some folders, each once, in order.

    Args:
        folders: Run folders, or folders that contain some.

    Raises:
        InputError: One is no folder, or has no run in it.
    """
    found: dict[Path, None] = {}
    for folder in folders:
        if not folder.is_dir():
            raise InputError("run", str(folder), "is not a folder" if folder.exists() else "there is no such folder")
        here = sorted(path for path in _walk(folder))
        if not here:
            raise InputError("run", str(folder), f"has no run folder in it (none has a {schema.RUN_FILE})")
        found.update(dict.fromkeys(here))
    return list(found)


def _walk(folder: Path) -> Iterator[Path]:
    for here, below, files in os.walk(folder):
        if schema.RUN_FILE in files or schema.TARGETS_FILE in files:
            below.clear()
            yield Path(here)
