"""Blocks and surfaces as plain values of JSON, for run folders, manifests and the headers of part files.

A surface is stored as the waves of a sum, or as the knots and the packed poles of a spline. A surface of another kind
is stored as a spline through it, with the measured error.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from typing import Any, get_args

import numpy as np

from tacbench_cad.spec.block import Block
from tacbench_cad.spec.interpolation import MAX_POLES, MAX_SAMPLES
from tacbench_cad.spec.operations import SAMPLED_FRACTION, as_spline
from tacbench_cad.spec.outlines import outline_of_word
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM, Tolerance
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.spec.surface import Surface, Unit
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.convert import from_plain, to_plain
from tacbench_cad.util.errors import InputError, located, one_of
from tacbench_cad.util.types import Floats

#: The largest size of the blocks of a file once they are unpacked, in bytes.
MAX_UNPACKED = 64_000_000
#: The number formats of packed poles. Single precision is used where it loses nothing.
_FORMATS = {"float32": "<f4", "float64": "<f8"}


def surface_values(surface: Surface) -> dict[str, Any]:
    """Return everything that is needed to make a surface again, as plain values.

    Returns:
        The key ``unit``, and the key ``waves`` with rows ``amplitude, f, g, phase`` or the key ``spline`` with a table.
    """
    if (waves := surface.plane_waves) is not None:
        return {"unit": surface.unit, "waves": [[w.amplitude, w.f, w.g, w.phase] for w in waves]}
    surface = as_spline(surface, SAMPLED_FRACTION * surface.amplitude_sum)
    single = np.array_equal(surface.poles.astype(np.float32).astype(np.float64), surface.poles)
    number = "float32" if single else "float64"
    packed = zlib.compress(np.ascontiguousarray(surface.poles, dtype=_FORMATS[number]).tobytes())
    return {
        "unit": surface.unit,
        "spline": {
            **surface_summary(surface)["spline"],
            "knots": [surface.u.knots.tolist(), surface.v.knots.tolist()],
            "numbers": number,
            "data": base64.b64encode(packed).decode("ascii"),
        },
    }


def surface_summary(surface: Surface) -> dict[str, Any]:
    """Return the same without the knots and the poles of a spline, for people and for manifests."""
    if (waves := surface.plane_waves) is not None:
        return {
            "unit": surface.unit,
            "waves": [{"amplitude": w.amplitude, "f": w.f, "g": w.g, "phase": w.phase} for w in waves],
        }
    if (spline := surface.spline) is None:
        return {"unit": surface.unit, "surface": str(surface), "error": surface.error, "evidence": surface.evidence}
    return {
        "unit": surface.unit,
        "spline": {
            "degree": [spline.u.degree, spline.v.degree],
            "poles": list(spline.poles.shape),
            "repeats": [spline.u.repeats, spline.v.repeats],
            "error": spline.error,
            "evidence": spline.evidence,
            "sha256": spline.digest,
        },
    }


def surface_from(values: Mapping[str, Any], where: str = "") -> Surface:
    """Make a surface from the plain values of :func:`surface_values`.

    Args:
        values: A table with the key ``unit``, and the key ``waves`` or ``spline``. Other keys are ignored.
        where: The beginning of every error message.

    Raises:
        InputError: The values were not written by this program.
    """
    unit: Unit = values["unit"]
    with located(f"{where}[block] "):
        one_of("unit", unit, get_args(Unit))
    if "spline" not in values:
        try:
            return WaveSum(tuple(Wave(amplitude=a, f=f, g=g, phase=phase) for a, f, g, phase in values["waves"]), unit)
        except (TypeError, ValueError):
            raise InputError(f"{where}[block]", None, "is not a block that this program wrote") from None
    try:
        table = dict(values["spline"])
        counts = tuple(int(count) for count in table["poles"])
        if not 0 < int(np.prod(counts)) <= MAX_POLES + MAX_SAMPLES:
            raise ValueError
        number = np.dtype(_FORMATS[table["numbers"]])
        unpack = zlib.decompressobj()
        data = unpack.decompress(base64.b64decode(table["data"], validate=True), int(np.prod(counts)) * number.itemsize)
        poles: Floats = np.frombuffer(data, dtype=number).reshape(counts).astype(np.float64)
        axes = [
            SplineAxis(np.array(knots, dtype=np.float64), int(degree), bool(repeats))
            for knots, degree, repeats in zip(table["knots"], table["degree"], table["repeats"], strict=True)
        ]
        for axis in axes:
            if axis.knots.ndim != 1 or not np.isfinite(axis.knots).all() or np.any(np.diff(axis.knots) < 0.0):
                raise ValueError
        one_of("evidence", table["evidence"], ("proved", "measured"))
        error, evidence = float(table["error"]), table["evidence"]
        return SplineSurface(axes[0], axes[1], poles, error=error, evidence=evidence, unit=unit)
    except (KeyError, TypeError, ValueError, zlib.error, InputError):
        raise InputError(f"{where}[block] spline", None, "is not a spline that this program wrote") from None


def block_values(block: Block) -> dict[str, Any]:
    """Return a block as plain values, from which :func:`block_from` makes it again."""
    texture = block.texture
    return {
        "texture": texture.name,
        "number": texture.number,
        "equation": texture.equation,
        **surface_values(texture.surface),
        "texture_block": to_plain(texture.block, without_none=True),
        "preset": block.preset,
        "scale": block.scale,
        "nominal_size_mm": list(block.nominal_size_mm),
        "nominal_height_mm": block.nominal_height_mm,
        "nominal_mm_per_unit": list(block.nominal_mm_per_unit),
        "origin_uv": list(block.origin_uv),
        "key_mm": block.key_mm,
        **({} if block.nominal_outline is None else {"outline": block.nominal_outline.word}),
        "sampling": (
            {"tolerance_mm": block.sampling.mm}
            if isinstance(block.sampling, Tolerance)
            else {"grid": [block.sampling.nx, block.sampling.ny]}
        ),
        "label": block.label,
        "engraved_copy": block.copy,
        **({} if block.step_tolerance_mm == STEP_TOLERANCE_MM else {"step_tolerance_mm": block.step_tolerance_mm}),
    }


def block_from(values: Any, where: str = "") -> Block:
    """Make a block from the plain values of :func:`block_values`. The texture is made from its surface.

    Args:
        values: The plain values.
        where: The beginning of every error message.

    Raises:
        InputError: A key is missing, or a value is not allowed.
    """
    try:
        block = dict(values)
        surface = surface_from({key: block.pop(key) for key in ("unit", "waves", "spline") if key in block}, where)
        sampling = block.pop("sampling")
        texture = {"name": block.pop("texture"), "surface": surface, "block": block.pop("texture_block")}
        texture |= {key: block.pop(key) for key in ("number", "equation")}
        outline = None
        if "outline" in block and (outline := outline_of_word(str(block.pop("outline")))) is None:
            raise ValueError
        block |= {
            "texture": texture,
            "nominal_outline": outline,
            "copy": block.pop("engraved_copy"),
            "sampling": (
                {"mm": sampling["tolerance_mm"]}
                if "tolerance_mm" in sampling
                else dict(zip(("nx", "ny"), sampling["grid"], strict=True))
            ),
        }
    except KeyError as error:
        raise InputError(f"{where}[block]", None, f"the key {error.args[0]!r} is missing") from None
    except InputError:
        raise
    except (TypeError, ValueError):
        raise InputError(f"{where}[block]", None, "is not a block that this program wrote") from None
    one_of(f"{where}[block] preset", str(block.get("preset")), PRESETS)
    return from_plain(Block, block, f"{where}[block] ")


def packed_blocks(blocks: Mapping[str, Block]) -> str:
    """Return the blocks of a file as a text of letters, digits, ``+``, ``/`` and ``=``, which every format can hold.

    Args:
        blocks: The blocks by the names of their bodies.
    """
    values = {name: block_values(block) for name, block in blocks.items()}
    return base64.b64encode(zlib.compress(json.dumps(values, allow_nan=False).encode())).decode("ascii")


def unpacked_blocks(text: str | bytes) -> bytes:
    """Return the plain values of packed blocks as JSON.

    Raises:
        ValueError: The text is damaged.
    """
    try:
        return zlib.decompressobj().decompress(base64.b64decode(text), MAX_UNPACKED)
    except zlib.error as error:
        raise ValueError from error
