"""One call for every file: is it the part that it should be, or, without a part, what is it?"""

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
    texture: Texture | str | None = None,
    preset: str | None = None,
    scale: float | None = None,
    full: bool | None = None,
) -> Report:
    """Examine an STL, 3MF or STEP file, whoever made it.

    With a part, the file must hold exactly that: its box, its through holes, its volume in closed form, and for a
    block the formula within the proved distance. Without one, a file of ours is held to what it says that it is, and
    any other is compared with all that is known.

    Args:
        path: The file; the end of its name says the format.
        part: What it should hold: a Block, a Holder, a Jig, a Coupon, a :class:`~tacbench_cad.Part`, or None.
        texture: What its relief should be: a texture, its number or name, or a TOML file; None for the nearest.
        preset: ``paper`` or ``released``; None for the nearest.
        scale: Its scale; None to take it from the file.
        full: Add pymeshlab's checks; None adds them to a foreign file where pymeshlab is installed.

    Returns:
        A report, whose ``ok`` says whether all is well and which prints one line for each check.

    Raises:
        InputError: There is no such file, its format is not known, or an argument is not allowed.
        MissingToolError: A package that the format, or ``full``, needs is not there.
    """
    if part is None:
        return examine(Path(path), texture, preset, scale, full=full)
    if (texture, preset, scale) != (None, None, None):
        raise InputError("part", None, "goes without texture, preset and scale: it says these itself")
    if format_of(Path(path)).shape == "solid":
        require_readable(Path(path))
    return verify(as_part(part), Path(path), full=bool(full))
