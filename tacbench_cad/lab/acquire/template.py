"""The file that ``tacbench acquire --init`` writes: every key, what it means, and its default."""

from __future__ import annotations

from pathlib import Path

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_text

#: The file.
TEMPLATE_FILE = Path(__file__).with_name("template.toml")


def write_template(path: Path) -> None:
    """Write :data:`TEMPLATE_FILE` to a new file.

    Raises:
        InputError: There is something at that path already, or it cannot be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError("init", str(path), "is there already; name a new file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, TEMPLATE_FILE.read_text("utf-8"))
