"""The paper's authors' arrays: one NumPy file for each block, printer, filament and force level.

``PLAminus_z0_P30_Bambu.npy`` is ``<filament>_z<number>[.<copy>]_P<level>_<printer>.npy``; z0 to z5 are textures 1 to 6,
further ones occur, and ``flat`` in place of the number. An array is (1, repeats, 5, 5, height, width, 3) or
(repeats * 25, height, width[, 3]), of uint8 or of other real numbers. Which axis of the 5 x 5 positions is x is written
nowhere. It is read as ours are: the first index counts the rows (y), the second the columns (x), both rising; the
scripts that the authors publish for their sliding tests loop so too (y outside, x inside, there with x falling). The
other order is an option. The contact forces are the paper's nominal ones; nobody measured them for each press.

Which printers ``Ender``, ``creality`` and ``crealty`` are is written nowhere either, so names stay as they are. A set
without a number is a print of its own. What z0 to z5 look like is known: the authors published the files of the blocks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.runs.importing.samples import Loaded, Sample, Source
from tacbench_cad.lab.runs.npyfile import mapped
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N, PER_SIDE, PressGrid, Spacing
from tacbench_cad.util.errors import InputError

FirstAxis = Literal["x", "y"]
#: The force levels of the authors' file names.
LEVELS: Mapping[str, int] = {"P30": 1, "P40": 2, "P50": 3}
#: Press positions of a block.
POSITIONS = PER_SIDE * PER_SIDE
#: What a print without a number is called.
UNNUMBERED = "unnumbered"
_NAME = re.compile(
    r"(?P<filament>[^_]+)_(?P<texture>z\d{1,4}|flat)(?:\.(?P<copy>\d{1,3}))?_(?P<level>[Pp]\d+)_(?P<printer>[^_]+)\.npy"
)


@dataclass(frozen=True, kw_only=True)
class AuthorsOptions:
    """How the authors' files are read where they leave it open.

    Args:
        force_levels: What the file names call each force level, and its number from 1.
        first_axis: Which axis of the block the first index of the 5 x 5 positions runs along.
        preset: The geometry of textures 1 to 6; the authors printed what they ``released``.
        spacing: Which reading of the press grid is taken along y.
    """

    force_levels: Mapping[str, int] = field(default_factory=lambda: dict(LEVELS))
    first_axis: FirstAxis = "y"
    preset: str = "released"
    spacing: Spacing = "even"

    def __post_init__(self) -> None:
        if self.first_axis not in ("x", "y"):
            raise InputError("first-axis", self.first_axis, "allowed: x, y")
        numbers = list(self.force_levels.values())
        if not numbers or len(set(numbers)) < len(numbers):
            raise InputError("force-levels", dict(self.force_levels), "must name each level's number once")
        for word, number in self.force_levels.items():
            if not re.fullmatch(r"P\d+", word):
                raise InputError("force-levels", word, "must be as P30")
            if not 1 <= number <= len(FORCES_N):
                raise InputError("force-levels", number, f"must be from 1 to {len(FORCES_N)}, the paper's forces")


def is_authors_file(path: Path) -> bool:
    """Whether a file has a name of the authors'."""
    return _NAME.fullmatch(path.name) is not None


def of_authors(path: Path, options: AuthorsOptions) -> Source:
    """One of the authors' files; its images are not read yet.

    Raises:
        InputError: The level in its name is unknown, or the array is damaged or has another shape.
    """
    name = _NAME.fullmatch(path.name)
    if name is None:
        raise InputError("file", str(path), "must be named <filament>_z<number>[.<copy>]_P<level>_<printer>.npy")
    level = options.force_levels.get(name["level"].upper())
    if level is None:
        known = ", ".join(f"{word}={number}" for word, number in options.force_levels.items())
        raise InputError("file", str(path), f"{name['level']} is no known force level; --force-levels has {known}")
    number = int(name["texture"][1:]) + 1 if name["texture"] != "flat" else 0
    block = _block(number, options.preset) if 1 <= number <= 6 else None
    shape = _frames_shape(path)
    places = PressGrid.paper(spacing=options.spacing).positions_mm.tolist()
    samples = []
    for index in range(shape[0] * POSITIONS):
        repeat, place = divmod(index, POSITIONS)
        i, j = divmod(place, PER_SIDE)
        position = place + 1 if options.first_axis == "y" else j * PER_SIDE + i + 1
        x_mm, y_mm = places[position - 1]
        load: Callable[[], Loaded] = partial(_frame, path, shape, (repeat, i, j))
        fields = {
            "label": f"texture-{number}" if number else "flat",
            "print": name["copy"] or UNNUMBERED,
            "printer": name["printer"],
            "filament": name["filament"],
            "position": str(position),
            "force": repr(FORCES_N[level - 1]),
            "repeat": str(repeat + 1),
            "x": repr(x_mm),
            "y": repr(y_mm),
        }
        where = f"{path.name} repeat {repeat + 1} position {position}"
        samples.append(Sample(name=where, fields=fields, load=load, block=block))
    facts = {
        "first_axis": options.first_axis,
        "forces": "the paper's, nominal, not measured",
        "positions": f"the paper's, {options.spacing} along y, nominal, not measured",
    }
    if block is not None:
        facts["geometry"] = f"the files that the authors published (preset {options.preset})"
    return Source(
        kind="the authors' NumPy files",
        path=path,
        samples=samples,
        files=(path,),
        facts=facts,
        threads=True,
        whole=True,
    )


_block = cache(Block.of)


def _frames_shape(path: Path) -> tuple[int, ...]:
    """Shape of a file's array as (repeats, 5, 5, height, width[, 3])."""
    array = mapped(path)
    shape, grid = array.shape, (PER_SIDE, PER_SIDE)
    if len(shape) in (6, 7) and shape[0] == 1 and shape[2:4] == grid:
        frames = shape[1:]
    elif len(shape) in (3, 4) and shape[0] % POSITIONS == 0:
        frames = (shape[0] // POSITIONS, *grid, *shape[1:])
    else:
        frames = ()
    if not frames or not array.flags.c_contiguous or (len(frames) == 6 and frames[-1] != 3) or min(frames[3:5]) < 8:
        what = f"has shape {shape}; (1, 2, 5, 5, 480, 640, 3), (50, 480, 640, 3) and (50, 192, 256) are the authors'"
        raise InputError("file", str(path), what)
    return frames


def _frame(path: Path, shape: tuple[int, ...], at: tuple[int, int, int]) -> NDArray[Any]:
    return np.array(mapped(path).reshape(shape)[at])
