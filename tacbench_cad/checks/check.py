"""The function that checks any part file: it compares the file with a given part, or identifies the part."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tacbench_cad.checks.identify import examine
from tacbench_cad.checks.report import Report
from tacbench_cad.checks.verify import verify
from tacbench_cad.formats import format_of
from tacbench_cad.formats.step import require_readable
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError


def check(
    path: Path | str,
    part: Any = None,
    *,
    texture: Texture | str | Path | None = None,
    preset: str | None = None,
    scale: float | None = None,
    full: bool | None = None,
) -> Report:
    """Check an STL, 3MF or STEP file from any source.

    With a part, the file must contain exactly this part: the bounding box, the through holes, the volume in closed form
    and, for a block, the distance from the formula are checked. Without a part, a file written by this package must
    agree with the name of the part in it. A file from another source is compared with all known blocks.

    Args:
        path: The file. Its ending determines the format.
        part: The expected part: a Block, a Holder, a Jig, a Coupon or a ``PrintPart``; None for any part.
        texture: The expected texture: a texture, its number or name, or a TOML file; None for the nearest texture.
        preset: ``paper`` or ``released``; None for the nearest preset.
        scale: The expected scale; None to compute it from the file.
        full: Whether the checks by pymeshlab are done. None does them without ``part`` if pymeshlab is installed.

    Returns:
        The report. Its ``ok`` is True if all checks passed, and ``print`` shows a line for each check.

    Raises:
        InputError: The file does not exist, its format is unknown, or an argument is not allowed.
        MissingToolError: A package that the format or ``full`` needs is not installed.
    """
    if part is None:
        return examine(Path(path), texture, preset, scale, full=full)
    if (texture, preset, scale) != (None, None, None):
        raise InputError("part", None, "already has a texture, a preset and a scale; leave out these arguments")
    if format_of(Path(path)).shape == "solid":
        require_readable(Path(path))
    return verify(as_part(part), Path(path), full=bool(full))
