"""The project as a clean checkout has it."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[2]

#: Fills an empty folder.
Fill = Callable[[Path], None]
#: Gives the folder of a name, filled by the first of the processes that share the tests.
Once = Callable[[str, Fill], Path]

#: What a folder may hold beside the project; counts only where git does not say.
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
    """The files that belong to the project, as paths from its root: what git has or would take, and is there."""
    asked = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        listed = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
        return tuple(sorted({name for name in listed if name and (ROOT / name).is_file()}))
    except (OSError, subprocess.CalledProcessError):  # no git, no checkout, or one of somebody else
        files = (path.relative_to(ROOT) for path in ROOT.rglob("*") if path.is_file())
        found = {one for one in files if not any(fnmatch(part, rule) for rule in _BESIDE for part in one.parts)}
        made = {one for one in found if one.parts[0] == "stl_out" and one.name != "README.md"}
        return tuple(sorted(one.as_posix() for one in found - made - {Path("PKG-INFO"), Path("setup.cfg")}))
