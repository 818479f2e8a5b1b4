"""Import of the arrays of the paper's authors: one NumPy file for each block, printer, filament and force level.

The file names have the form ``<filament>_z<number>[.<copy>]_P<level>_<printer>.npy``, for example
``PLAminus_z0_P30_Bambu.npy``. z0 to z5 are textures 1 to 6. Other numbers occur too, and ``flat`` instead of
``z<number>``. An array has the shape (1, repeats, 5, 5, height, width, 3) or (repeats * 25, height, width[, 3]), and
contains uint8 or other real numbers. The colours of a frame are in the order blue, green, red.

The authors do not state which axis of the 5 x 5 positions is x. By default, the first index counts the rows (y) and
the second counts the columns (x), both in increasing order, as in our own runs. The scripts that the authors published
for their sliding tests loop in the same way (y outside, x inside), but with decreasing x. The other order is an option.
The contact forces are the nominal forces of the paper; they were not measured for each press.

The authors also do not state which printers ``Ender``, ``creality`` and ``crealty`` are, so these names are kept. A
file without a copy number is a separate print. The geometry of z0 to z5 is known, because the authors published the
files of the blocks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, cast, get_args

import numpy as np
from numpy.typing import NDArray

from tacbench_cad.lab.rig import Channels
from tacbench_cad.lab.runs import ImportFormat, ImportOptions, Loaded, Paths, Sample, Source
from tacbench_cad.spec import FORCES_N, PER_SIDE, PRESETS, Block, PressGrid, Spacing
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.npyfile import mapped

#: The options, each with its values; the first is the default. The authors printed the files that they ``released``.
#: Any force level by its name in the file names, such as ``P30``, is also an option.
OPTIONS: Mapping[str, tuple[str, ...]] = {
    "first-axis": ("y", "x"),
    "preset": ("released", *(name for name in PRESETS if name != "released")),
    "spacing": get_args(Spacing),
}
#: The usual force levels, by their names in the authors' file names.
LEVELS: Mapping[str, int] = {"P30": 1, "P40": 2, "P50": 3}
#: The number of press positions of a block.
POSITIONS = PER_SIDE * PER_SIDE
#: The order of the colours in the authors' arrays, which OpenCV recorded.
CHANNELS: Channels = "bgr"
#: The name of a print without a number.
UNNUMBERED = "unnumbered"
_NAME = re.compile(
    r"(?P<filament>[^_]+)_(?P<texture>z\d{1,4}|flat)(?:\.(?P<copy>\d{1,3}))?_(?P<level>[Pp]\d+)_(?P<printer>[^_]+)\.npy"
)


class _Options(NamedTuple):
    """The options: the force levels by name, the axis of the first index, the preset, and the spacing along y."""

    levels: Mapping[str, int]
    first_axis: str
    preset: str
    spacing: Spacing


def _options_of(words: Mapping[str, str]) -> _Options:
    """Return the options for the words of the user, such as ``{"first-axis": "x", "P30": "1"}``.

    Raises:
        InputError: An option is unknown, or its value is not allowed.
    """
    levels = {word.upper(): number for word, number in words.items() if re.fullmatch(r"[Pp]\d+", word)}
    numbers = [str(level) for level in range(1, len(FORCES_N) + 1)]
    for word, number in levels.items():
        if number not in numbers:
            raise InputError(word, number, f"must be from 1 to {len(FORCES_N)}, as the paper's forces")
    if len(set(levels.values())) < len(levels):
        raise InputError("force levels", levels, "must have each number only once")
    chosen = {name: allowed[0] for name, allowed in OPTIONS.items()}
    for name, value in words.items():
        if name.upper() not in levels:
            one_of("format options", name, (*OPTIONS, *LEVELS))
            chosen[name] = one_of(name, value, OPTIONS[name])
    return _Options(
        levels={word: int(number) for word, number in levels.items()} or LEVELS,
        first_axis=chosen["first-axis"],
        preset=chosen["preset"],
        spacing=cast("Spacing", chosen["spacing"]),
    )


def _read(path: Path, paths: Paths, options: ImportOptions) -> Source:
    """Open a file of the authors. Its images are not read yet.

    Raises:
        InputError: The level in the file name is unknown, or the array is damaged or has another shape.
    """
    name = _NAME.fullmatch(path.name)
    if name is None:
        raise InputError("file", str(path), "must be named <filament>_z<number>[.<copy>]_P<level>_<printer>.npy")
    chosen = _options_of(options.of_format)
    level = chosen.levels.get(name["level"].upper())
    if level is None:
        known = ", ".join(f"{word}={number}" for word, number in chosen.levels.items())
        what = f"is not a force level; known are {known}, and --format-options can name others"
        raise InputError("file", str(path), f"{name['level']} {what}")
    number = int(name["texture"][1:]) + 1 if name["texture"] != "flat" else 0
    block = _block(number, chosen.preset) if 1 <= number <= 6 else None
    shape = _frames_shape(path)
    places = PressGrid.paper(spacing=chosen.spacing).positions_mm.tolist()
    samples = []
    for index in range(shape[0] * POSITIONS):
        repeat, place = divmod(index, POSITIONS)
        i, j = divmod(place, PER_SIDE)
        position = place + 1 if chosen.first_axis == "y" else j * PER_SIDE + i + 1
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
        samples.append(
            Sample(name=where, fields=fields, load=load, file=path, index=index, channels=CHANNELS, block=block)
        )
    facts = {
        "first_axis": chosen.first_axis,
        "forces": "the paper's, nominal, not measured",
        "positions": f"the paper's, {chosen.spacing} along y, nominal, not measured",
    }
    if block is not None:
        facts["geometry"] = f"the files that the authors published (preset {chosen.preset})"
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
    """Return the shape of a file's array as (repeats, 5, 5, height, width[, 3])."""
    array = mapped(path)
    shape, grid = array.shape, (PER_SIDE, PER_SIDE)
    if len(shape) in (6, 7) and shape[0] == 1 and shape[2:4] == grid:
        frames = shape[1:]
    elif len(shape) in (3, 4) and shape[0] % POSITIONS == 0:
        frames = (shape[0] // POSITIONS, *grid, *shape[1:])
    else:
        frames = ()
    if not frames or not array.flags.c_contiguous or (len(frames) == 6 and frames[-1] != 3) or min(frames[3:5]) < 8:
        what = f"has shape {shape}; allowed are shapes such as (1, 2, 5, 5, 480, 640, 3), (50, 480, 640, 3) and"
        raise InputError("file", str(path), f"{what} (50, 192, 256)")
    return frames


def _frame(path: Path, shape: tuple[int, ...], at: tuple[int, int, int]) -> NDArray[Any]:
    return np.array(mapped(path).reshape(shape)[at])


FORMAT = ImportFormat(
    recognises=lambda path, *_: _NAME.fullmatch(path.name) is not None,
    read=_read,
    suffixes=(".npy",),
    check_options=_options_of,
)
