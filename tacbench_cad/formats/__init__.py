"""The formats that a part can be written in. A new format is one file here and one row of ``FORMATS``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.formats import step, stl, threemf
from tacbench_cad.geometry.part import Part
from tacbench_cad.util.errors import InputError, nearest


@dataclass(frozen=True, kw_only=True)
class Format:
    """One file format.

    Args:
        name: What ``--formats`` calls it.
        suffix: End of the file's name, with the dot.
        shape: Whether it holds a part's ``mesh`` or its ``solid``.
        write: Writes a part to a path (a temporary one; see :func:`tacbench_cad.util.files.replacing`).
        why_missing: Why it cannot be written on this machine, or None.
    """

    name: str
    suffix: str
    shape: str
    write: Callable[[Part, Path], None]
    why_missing: Callable[[], str | None] = lambda: None


#: The file formats by their names.
FORMATS: dict[str, Format] = {
    row.name: row
    for row in (
        Format(
            name="stl",
            suffix=".stl",
            shape="mesh",
            write=stl.write_stl,
        ),
        Format(
            name="3mf",
            suffix=".3mf",
            shape="mesh",
            write=threemf.write_3mf,
            why_missing=threemf.why_missing,
        ),
        Format(
            name="step",
            suffix=".step",
            shape="solid",
            write=step.write_step,
            why_missing=step.why_missing,
        ),
    )
}

#: Endings that files made elsewhere have, and the format that reads them.
SUFFIXES: dict[str, str] = {".stl": "stl", ".3mf": "3mf", ".step": "step", ".stp": "step"}


def format_of(path: Path) -> Format:
    """The format of a file, by the end of its name.

    Raises:
        InputError: The ending is none that can be read.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(
            "file", str(path), f"its ending must be one of {', '.join(SUFFIXES)}; {nearest(suffix, SUFFIXES)}"
        )
    return FORMATS[SUFFIXES[suffix]]
