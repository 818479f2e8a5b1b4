"""The files of a clean checkout of the project."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[2]

#: Fills an empty folder.
Fill = Callable[[Path], None]
#: Returns the folder of a name. The first of the test processes that asks for it fills it.
Once = Callable[[str, Fill], Path]

#: Files and folders that do not belong to the project; used only if git cannot list the files.
_BESIDE = (
    ".venv*",
    "__pycache__",
    "*.egg-info",
    "_build",
    "generated",
    "build",
    "dist",
    ".git",
    ".*_cache",
    ".hypothesis",
)


def versioned_files() -> tuple[str, ...]:
    """Return the existing files of the project as paths from its root: those that git tracks or would add."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
        return tuple(sorted({name for name in listed if name and (ROOT / name).is_file()}))
    except (OSError, subprocess.CalledProcessError):  # no git, no checkout, or the checkout of another user
        files = (path.relative_to(ROOT) for path in ROOT.rglob("*") if path.is_file())
        paths = {path for path in files if not any(fnmatch(part, rule) for rule in _BESIDE for part in path.parts)}
        exported = {path for path in paths if path.parts[0] == "stl_out" and path.name != "README.md"}
        return tuple(sorted(path.as_posix() for path in paths - exported - {Path("PKG-INFO"), Path("setup.cfg")}))
