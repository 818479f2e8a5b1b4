"""The file formats of parts. To add a format, add a module to this package and a row to ``FORMATS``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacbench_cad.formats import step, stl, threemf
from tacbench_cad.formats.stl import read_stl as read_stl
from tacbench_cad.formats.threemf import read_foreign_mesh as read_foreign_mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.util.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Format:
    """A file format.

    Args:
        name: The word for ``--formats``.
        suffix: The end of the file name, with the dot.
        shape: The shape that the format stores: ``mesh`` or ``solid``.
        write: A function that writes a part to a temporary path; see :func:`tacbench_cad.util.files.replacing`.
        why_missing: A function that returns the reason why this machine cannot write the format, or None if it can.
    """

    name: str
    suffix: str
    shape: str
    write: Callable[[PrintPart, Path], None]
    why_missing: Callable[[], str | None] = lambda: None


#: The file formats, by their names.
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

#: The suffixes of files from other programs, and the format that reads them.
SUFFIXES: dict[str, str] = {".stl": "stl", ".3mf": "3mf", ".step": "step", ".stp": "step"}


def format_of(path: Path) -> Format:
    """Return the format of a file, based on the suffix of its name.

    Raises:
        InputError: The suffix belongs to no known format.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError("file", str(path), f"the file name must end in {', '.join(SUFFIXES)}")
    return FORMATS[SUFFIXES[suffix]]
