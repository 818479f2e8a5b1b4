"""Height maps in files: pictures, arrays, tables, and the files of instruments."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacbench_cad.spec.interpolation import MAX_SAMPLES, height_map, smoothed
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.wavefit import fit_waves
from tacbench_cad.util.errors import InputError, located, one_line
from tacbench_cad.util.npyfile import mapped
from tacbench_cad.util.numbers import read_numbers
from tacbench_cad.util.packages import require
from tacbench_cad.util.processes import read_isolated
from tacbench_cad.util.untrusted import open_input

#: The endings of pictures.
PICTURES = (".png", ".tif", ".tiff")
#: The endings of tables of numbers.
TABLES = (".csv", ".txt", ".asc")
#: The time limit in s for reading the file of an instrument, and the additional time for each MB of the file.
INSTRUMENT_LIMITS_S = (60.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class HeightFile:
    """The content of a file with heights.

    Args:
        values: The values, shape (rows, columns), the first row at the largest y.
        mm_per_pixel: The distances of neighbouring columns and rows in mm; None if the file does not say them.
        in_mm: Whether the values are heights in mm.
    """

    values: Any
    mm_per_pixel: tuple[float, float] | None = None
    in_mm: bool = False


def read_heights(path: Path) -> HeightFile:
    """Read a height map.

    - PNG and TIFF, 8 or 16 bit; a colour picture becomes grey. This needs the package Pillow.
    - NPY, an array of numbers; CSV, TXT or ASC, a table of numbers (see :func:`.read_numbers`). Their values are
      heights in mm.
    - Any other file is read by the package surfalize, which knows the formats of many instruments.

    Args:
        path: The file.

    Raises:
        InputError: The file cannot be read, or is too large.
        MissingToolError: The package for this kind of file is not installed.
    """
    suffix = path.suffix.lower()
    if suffix in PICTURES:
        return HeightFile(values=_picture(path))
    if suffix == ".npy":
        return HeightFile(values=_array(path), in_mm=True)
    if suffix in TABLES:
        values = read_numbers(path, "height map", "table")
        _require_size(path, *values.shape)
        return HeightFile(values=values, in_mm=True)
    return _instrument(path)


def image_texture(
    name: str,
    path: Path,
    *,
    mm_per_pixel: float | tuple[float, float] | None = None,
    height_mm: float | tuple[float, float] | None = None,
    smooth_mm: float = 0.0,
    repeats: bool = False,
    waves: int | None = None,
) -> Texture:
    """Make a texture from a height map in a file: a picture, an array, a table, or the file of an instrument.

    Args:
        name: The name of the texture.
        path: The file; :func:`read_heights` lists the formats.
        mm_per_pixel: The distance of neighbouring columns, or of columns and rows, in mm; None if the file says it.
        height_mm: The heights of the lowest and the highest value, or their difference; None if the values of the file
            are heights in mm.
        smooth_mm: The standard deviation of a Gaussian filter, in mm. It smooths the steps of a picture with 8 bits.
        repeats: Whether the height map repeats beyond its ends.
        waves: The number of waves that are fitted; None for a spline through all samples.

    Raises:
        InputError: The file cannot be read, or a number is missing or not allowed.
        MissingToolError: A package that reads the file is not installed.
    """
    file = read_heights(path)
    steps = mm_per_pixel if mm_per_pixel is not None else file.mm_per_pixel
    if steps is None:
        raise InputError("mm_per_pixel", None, f"is missing; {path.name} does not say how far apart its samples are")
    if height_mm is None and not file.in_mm:
        raise InputError(
            "height_mm", None, "is missing; give the height in mm of the brightest pixel above the darkest"
        )
    heights = file.values
    with located(f"{path.name}: "):
        if smooth_mm:
            heights = smoothed(heights, smooth_mm, steps, repeats or waves is not None)
        if waves is not None:
            fit = fit_waves(heights, waves=waves, mm_per_pixel=steps, height_mm=height_mm)
            return Texture(name=name, surface=fit.surface, equation=f"{path.name} as {fit}")
        surface = height_map(heights, mm_per_pixel=steps, height_mm=height_mm, repeats=repeats)
    rows, columns = np.shape(heights)
    text = f"{path.name}, {columns} x {rows} samples"
    return Texture(name=name, surface=surface, equation=text)


def _require_size(path: Path, rows: int, columns: int) -> None:
    if rows * columns > MAX_SAMPLES:
        size = f"has {columns} x {rows} samples, more than the {MAX_SAMPLES:,} allowed; make it smaller first"
        raise InputError("height map", str(path), size)


def _picture(path: Path) -> Any:
    require(f"{path}: a picture as height map", "PIL")
    from PIL import Image, UnidentifiedImageError

    unreadable = (
        "is not a PNG or TIFF picture of a known kind; export 16 bits or 32-bit floating-point numbers for each pixel"
    )
    with open_input(path, "height map", "image") as stream, warnings.catch_warnings():
        # the size is checked here, before the picture is decoded
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(stream, formats=("PNG", "TIFF")) as picture:
                _require_size(path, picture.height, picture.width)
                is_grey = picture.mode in ("L", "I", "F") or picture.mode.startswith("I;")
                return np.asarray(picture if is_grey else picture.convert("L"))
        except Image.DecompressionBombError:
            allowed = f"has more samples than the {MAX_SAMPLES:,} allowed; make it smaller first"
            raise InputError("height map", str(path), allowed) from None
        except UnidentifiedImageError:
            raise InputError("height map", str(path), unreadable) from None
        except InputError:
            raise
        except (OSError, ValueError, SyntaxError, EOFError) as error:
            raise InputError("height map", str(path), f"cannot be decoded: {one_line(str(error))}") from None


def _array(path: Path) -> Any:
    array = mapped(path, what="height map")
    if array.ndim != 2 or array.dtype.kind not in "iuf":
        allowed = f"must be a table of numbers, but has the shape {array.shape} and the type {array.dtype}"
        raise InputError("height map", str(path), allowed)
    _require_size(path, *array.shape)
    return np.array(array)


def _instrument(path: Path) -> HeightFile:
    """Read the file of an instrument in a child process, because a damaged file can block the package surfalize."""
    if not path.is_file():
        raise InputError("height map", str(path), "does not exist")
    require(f"{path}: a height map of this kind", "surfalize")
    file: HeightFile = read_isolated(path, "the package surfalize", INSTRUMENT_LIMITS_S, _surface, path)
    return file


def _surface(path: Path) -> HeightFile:
    """Read the file of an instrument. The package surfalize gives heights and distances in micrometres."""
    from surfalize import Surface

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            surface = Surface.load(path)
    except Exception as error:
        raise InputError("height map", str(path), f"cannot be read: {one_line(str(error))}") from None
    values = np.asarray(surface.data, dtype=np.float64)
    _require_size(path, *values.shape)
    steps = (float(surface.step_x) / 1000.0, float(surface.step_y) / 1000.0)
    return HeightFile(values=values / 1000.0, mm_per_pixel=steps, in_mm=True)
