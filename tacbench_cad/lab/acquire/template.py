"""The file that ``tacbench acquire --init`` writes: every key with its meaning and default."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_text

#: The file.
TEMPLATE_FILE = Path(__file__).with_name("template.toml")


def write_template(path: Path) -> None:
    """Write :data:`TEMPLATE_FILE` to a new file.

    Raises:
        InputError: The path already exists or cannot be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError("init", str(path), "already exists; name a new file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, TEMPLATE_FILE.read_text("utf-8"))
