"""The correction of a block's file for a printer, so that its print equals the formula.

For a print of a file, a :class:`~tacbench_cad.extensions.printer_models.model.PrinterModel` predicts the sides, the
height and the amplitude of each wave. A corrected file has the inverse of these errors, within limits. If a texture is
not a sum of waves, only sides and heights are corrected. The corrected file is an ordinary block, whose texture can be
written as a texture file.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.extensions.printer_models.prediction import Print, is_correctable, multiplied, transfers
from tacbench_cad.geometry import PrintPart, as_part, block_spec
from tacbench_cad.spec import Block, BlockTable, Texture, WaveSum, extremes_on
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.types import Floats

#: The largest factor by which the amplitude of a wave is corrected; the smallest is its inverse.
MAX_FACTOR = 2.0
#: The largest number of steps that bring the relief to that of the formula, and the difference that ends them, in mm.
_STEPS, _RELIEF_MM = 8, 1e-5
#: The digits after the point of the sides and heights of a file in mm, which its name contains.
_DIGITS = 4


@dataclass(frozen=True, kw_only=True)
class Corrected:
    """A block whose file is corrected for a printer. :func:`tacbench_cad.export` accepts it.

    Args:
        print: The block that the print is expected to equal.
        file: The block as it is in the file. The name of its texture is that of the print's texture with ``-corr``, or
            with ``-free`` if the relief of the print is free.
        model: The printer.
    """

    print: Block
    file: Block
    model: PrinterModel

    def part(self) -> PrintPart:
        """Return the file as a part. Its specification also names the print and the model of the printer."""
        part = as_part(self.file)
        about = {
            "corrected_for": self.model.fingerprint,
            "printer_model": to_plain(self.model, without_none=True),
            "print": block_spec(self.print),
        }
        return replace(part, title=f"{part.title}, corrected for {self.model.name}", spec=about | dict(part.spec))

    @property
    def for_fixtures(self) -> Block:
        """The block for which fixtures are made by the same printer: the sides of the file, one height for all."""
        return replace(self.file, nominal_height_mm=self.print.nominal_height_mm / self.model.scale[2])

    def toml(self, word: str) -> str:
        """Return the texture of the file as the text of a texture file.

        Args:
            word: The texture of the print as a texture file may name it. Only a texture that is not a sum of waves
                needs it.
        """
        import tomlkit  # imported here, because most uses of a correction write no such file

        texture, table = self.file.texture, to_plain(self.file.texture.block, without_none=True)
        family: dict[str, Any] = {"family": "plane-waves"}
        waves = texture.surface.waves if isinstance(texture.surface, WaveSum) else ()
        if not waves:
            family = {"family": "sum", "of": [word]}
            if texture.surface.unit == "mm":
                family["stretch"] = list(_stretch(self.print, self.file.nominal_size_mm, self.model))
        document: dict[str, Any] = {"texture": {"name": texture.name, **family}, "block": table}
        if waves:
            document["wave"] = [to_plain(wave) for wave in waves]
        return (
            f"# {self.print.name}, corrected for {self.model.fingerprint}.\n# A print of this file by that printer is "
            f"expected to equal {self.print.texture.name} at scale {self.print.scale:g}.\n{tomlkit.dumps(document)}"
        )


@lru_cache(maxsize=64)
def corrected_for(block: Block, model: PrinterModel) -> Corrected:
    """Correct the file of a block for a printer.

    Args:
        block: The block that the print is expected to equal.
        model: The printer.

    Raises:
        InputError: The corrected file is not allowed, for example because its base is too thin, or because a disc would
            be printed as an oval.
    """
    outline = None if block.nominal_outline is None else model.file_outline(block.nominal_outline, block.scale)
    sides = model.file_size_mm(block.size_mm)
    size = tuple(round(side / block.scale, _DIGITS) for side in sides) if outline is None else outline.size_mm
    own, key_mm = block.texture.surface, model.file_key_mm(block.key_mm)
    x, y, z = _stretch(block, (size[0], size[1]), model)
    units = tuple(unit * by for unit, by in zip(block.nominal_mm_per_unit, (x, y, z), strict=True))
    if isinstance(own, WaveSum):
        # Waves in mm become waves in units that are nearly 1 mm, because a texture in mm is never stretched.
        surface: Any = replace(multiplied(own, _factors(block, model)), unit="units")
    else:
        surface = own.mapped((x, y), z) if own.unit == "mm" else own
    start = block.origin_uv
    if surface.unit == "mm":
        units, start = (1.0, 1.0, 1.0), (start[0] * x, start[1] * y)

    def made(origin: tuple[float, float], height_mm: float) -> Block:
        domain = tuple((low, low + side / unit) for low, side, unit in zip(origin, size, units, strict=False))
        table = BlockTable(
            height_mm=round(height_mm, _DIGITS),
            mm_per_unit=None if surface.unit == "mm" else (units[0], units[1], units[2]),
            domain=(domain[0], domain[1]),
            outline=None if outline is None else outline.word,
        )
        return Block.of(
            Texture(name=_name(block.texture, model), surface=surface, block=table),
            block.preset,
            scale=block.scale,
            sampling=block.sampling,
            key_mm=None if key_mm is None else round(key_mm, _DIGITS),
            label=block.label,
            copy=block.copy,
            step_tolerance_mm=block.step_tolerance_mm,
            outline=outline,
        )

    file = made(start, block.nominal_height_mm + 2.0 * block.relief_mm / block.scale)
    if isinstance(own, WaveSum):
        corner_mm = Print(file=file, model=model).corner_mm
        start = (start[0] + corner_mm[0] / block.mm_per_unit[0], start[1] + corner_mm[1] / block.mm_per_unit[1])
        file = made(start, file.nominal_height_mm)
    # The highest point of the print determines the height of the formula's zero, and this the height of the file.
    top_mm = block.datum_mm + block.extremes.high
    datum_mm = (top_mm - Print(file=file, model=model).extremes.high) / model.scale[2]
    file = made(start, (datum_mm + file.height_mm - file.datum_mm) / block.scale)
    return Corrected(print=block, file=file, model=model)


def _name(texture: Texture, model: PrinterModel) -> str:
    """Return the name of a corrected texture. It is short, because it is engraved."""
    stem = f"t{texture.number}" if texture.number else texture.name[:27].rstrip("-")
    return f"{stem}-{'corr' if model.relief_rule == 'formula' else 'free'}"


def _stretch(block: Block, size_mm: tuple[float, float], model: PrinterModel) -> tuple[float, float, float]:
    """Return the factors along x, y and z from the texture of a print to that of its file.

    A spline may be unknown outside of its sides, so it keeps to them. The amplitudes of waves have their own factors.
    """
    x, y, z = model.scale
    if isinstance(block.texture.surface, WaveSum):
        return (1.0 / x, 1.0 / y, 1.0)
    return (size_mm[0] / block.nominal_size_mm[0], size_mm[1] / block.nominal_size_mm[1], 1.0 / z)


def _factors(block: Block, model: PrinterModel) -> Floats:
    """Return the factor by which the file multiplies the amplitude of each wave.

    Each factor is the inverse of the transfer function, within the limits. The waves that cannot be corrected leave a
    difference between the relief of the print and that of the formula. Unless the relief is free, the difference is
    removed by the smallest change of the other waves, in the sense of least squares.
    """
    design = block.surface
    assert isinstance(design, WaveSum)
    transfer, free = transfers(design, model), is_correctable(design, model)
    amplitude = design.table[:, 0]
    free &= amplitude != 0.0
    low, high = np.ones(len(free)), np.ones(len(free))
    low[free], high[free] = 1.0 / MAX_FACTOR, MAX_FACTOR
    factors = np.clip(1.0 / np.where(free, transfer, 1.0), low, high)
    for _ in range(_STEPS if model.relief_rule == "formula" else 0):
        extremes = extremes_on(multiplied(design, factors * transfer), block.size_mm, block.region)
        missing = block.relief_mm - (extremes.high - extremes.low)
        # How much the relief grows with the amplitude of each wave, while the extremes stay where they are.
        (x0, y0), (x1, y1) = extremes.at_low, extremes.at_high
        _, f, g, phase = design.table.T
        growth = np.sin(f * x1 + g * y1 + phase) - np.sin(f * x0 + g * y0 + phase)
        room = free & np.where(growth * amplitude * missing > 0.0, factors < high, factors > low)
        total = float(np.sum(growth[room] ** 2))
        if abs(missing) <= _RELIEF_MM or total == 0.0:
            break
        change = np.where(room, growth * missing / total, 0.0)
        factors = np.clip(
            factors + np.divide(change, amplitude * transfer, out=np.zeros_like(change), where=room), low, high
        )
    return factors
