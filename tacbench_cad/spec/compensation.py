"""The correction of a block's file for a printer, so that its print equals the formula, and the prediction of prints.

For a print of a file, a :class:`~tacbench_cad.spec.printermodel.PrinterModel` predicts the sides, the height and the
amplitude of each wave. A corrected file has the inverse of these errors, within limits. If a texture is not a sum of
waves, only sides and heights are corrected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from tacbench_cad.spec.block import Block, extremes_on
from tacbench_cad.spec.distance import distance_along_normal
from tacbench_cad.spec.extremes import Extremes
from tacbench_cad.spec.outlines import Circle, Outline
from tacbench_cad.spec.printermodel import PrinterModel, ReliefRule
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: The largest factor by which the amplitude of a wave is corrected; the smallest is its inverse.
MAX_FACTOR = 2.0
#: If a printer leaves less than this fraction of a wave, the wave is lost, and it is not corrected.
MIN_TRANSFER = 0.1
#: The largest number of steps that bring the relief to that of the formula, and the difference that ends them, in mm.
_STEPS, _RELIEF_MM = 8, 1e-5
#: The number of points along each side at which vertical deviations are predicted. Deviations along the normal take
#: longer, so they are predicted at every n-th of these points.
_POINTS, _EVERY = 401, 4


def corrected_for(block: Block, model: PrinterModel) -> Block:
    """Return a block whose file is corrected for a printer. All values of the block still describe the print.

    Raises:
        InputError: The corrected file is not allowed.
    """
    corrected = replace(block, correction=model)
    in_file(corrected)
    return corrected


def in_file(block: Block) -> Block:
    """Return the block with the sizes and the waves of its file; the block itself if it is not corrected.

    Raises:
        InputError: The corrected file is not allowed, for example because its base is too thin, or because a disc would
            be printed as an oval.
    """
    return block if block.correction is None else _in_file(block, block.correction)


@lru_cache(maxsize=64)
def _in_file(block: Block, model: PrinterModel) -> Block:
    scale_x, scale_y, scale_z = model.scale
    outline = None if block.nominal_outline is None else model.file_outline(block.nominal_outline, block.scale)
    width, depth = model.file_size_mm(block.size_mm)
    size = (width / block.scale, depth / block.scale) if outline is None else outline.size_mm
    texture, units = block.texture, block.nominal_mm_per_unit
    if isinstance(texture.surface, WaveSum):
        texture = replace(texture, surface=_multiplied(texture.surface, _factors(block, model)))
        units = (units[0] / scale_x, units[1] / scale_y, units[2])
    else:  # a spline may be unknown outside of its sides, so it keeps to them
        stretch = (size[0] / block.nominal_size_mm[0], size[1] / block.nominal_size_mm[1])
        units = (units[0] * stretch[0], units[1] * stretch[1], units[2] / scale_z)
    start = replace(
        block,
        texture=texture,
        nominal_size_mm=size,
        nominal_mm_per_unit=units,
        nominal_height_mm=block.nominal_height_mm + 2.0 * block.relief_mm / block.scale,
        nominal_outline=outline,
        key_mm=model.file_key_mm(block.key_mm),
        correction=None,
        design=block,
    )
    if isinstance(texture.surface, WaveSum):
        moved = zip(block.origin_uv, Print(file=start, model=model).corner_mm, block.mm_per_unit[:2], strict=True)
        u, v = (origin + corner / per_unit for origin, corner, per_unit in moved)
        start = replace(start, origin_uv=(u, v))
    # The highest point of the print determines the height of the formula's zero, and this the height of the file.
    top_mm = block.datum_mm + block.extremes.high
    datum_mm = (top_mm - Print(file=start, model=model).extremes.high) / scale_z
    return replace(start, nominal_height_mm=(datum_mm + start.height_mm - start.datum_mm) / block.scale)


def for_fixtures(block: Block) -> Block:
    """Return the block for which fixtures are made. If it is corrected, it has the sides of the file.

    The same printer prints the fixtures, so they need the same scales. The height is the same for all textures.
    """
    if block.correction is None:
        return block
    height_mm = block.nominal_height_mm / block.correction.scale[2]
    return replace(in_file(block), texture=block.texture, nominal_height_mm=height_mm, design=None)


@dataclass(frozen=True, kw_only=True)
class Print:
    """The predicted print of a file, in its own frame with the lower corner at (0, 0).

    Args:
        file: The block as it is in the file; see :func:`in_file`.
        model: The printer.
    """

    file: Block
    model: PrinterModel

    @cached_property
    def outline(self) -> Outline | None:
        """The outline of the print; None for a rectangle."""
        (x, y, _), outline = self.model.scale, self.file.outline
        return None if outline is None else outline.stretched(x, y).moved_outwards(self.model.wall_offset_mm)

    @property
    def size_mm(self) -> tuple[float, float]:
        """The sides of the print."""
        if self.outline is None or isinstance(self.outline.loops[0], Circle):  # a disc can become slightly oval
            return self.model.print_size_mm(self.file.size_mm)
        return self.outline.size_mm

    @cached_property
    def corner_mm(self) -> tuple[float, float]:
        """How far the lower corner of the print lies outside of that of the scaled file, along x and y."""
        (x, y, _), offset, outline = self.model.scale, self.model.wall_offset_mm, self.file.outline
        if outline is None:
            return (offset, offset)
        (low_x, low_y), _ = outline.stretched(x, y).loops[0].moved_outwards(offset).box
        return (-low_x, -low_y)

    def shift_mm(self, block: Block) -> tuple[float, float]:
        """Return the place along x and y in the print at which the lower corner of the formula's block lies.

        The point of the texture in the middle of the block is at the same place in both.

        Args:
            block: The block that the print is expected to equal.
        """
        file, shift = self.file, []
        for axis, side in enumerate(block.size_mm):
            middle = block.origin_uv[axis] + side / 2.0 / block.mm_per_unit[axis]
            in_print = self.model.scale[axis] * (middle - file.origin_uv[axis]) * file.mm_per_unit[axis]
            shift.append(in_print + self.corner_mm[axis] - side / 2.0)
        return (shift[0], shift[1])

    @property
    def datum_mm(self) -> float:
        """The height of the formula's zero in the print."""
        return self.model.scale[2] * self.file.datum_mm

    @property
    def height_mm(self) -> float:
        """The height of the highest point of the print."""
        return self.datum_mm + self.extremes.high

    @property
    def relief_mm(self) -> float:
        """The difference between the highest and the lowest point of the relief."""
        return self.extremes.high - self.extremes.low

    @cached_property
    def surface(self) -> WaveSum:
        """The printed relief around the height :attr:`datum_mm`.

        Raises:
            InputError: The texture is not a sum of waves.
        """
        flat = self.file.surface
        if not isinstance(flat, WaveSum):
            allowed = "is not a sum of waves, so its print cannot be predicted"
            raise InputError("texture", self.file.texture.name, allowed)
        (x, y, _), corner = self.model.scale, self.corner_mm
        placed = flat.mapped((x, y), 1.0, (-corner[0] / x, -corner[1] / y))
        return _multiplied(placed, transfers(placed, self.model))

    def heights(self, x: Floats, y: Floats) -> Floats:
        """Return the heights of the print on a grid, shape (nx, ny). A spline is only scaled.

        Args:
            x: The coordinates along x in the frame of the print, shape (nx,).
            y: The coordinates along y, shape (ny,).
        """
        if isinstance(self.file.surface, WaveSum):
            return self.datum_mm + self.surface.grid(x, y)
        (scale_x, scale_y, scale_z), corner = self.model.scale, self.corner_mm
        places = ((x - corner[0]) / scale_x, (y - corner[1]) / scale_y)
        u, v = (np.clip(at, 0.0, side) for at, side in zip(places, self.file.size_mm, strict=True))
        return np.asarray(scale_z * (self.file.datum_mm + self.file.surface.grid(u, v)))

    @cached_property
    def extremes(self) -> Extremes:
        """The lowest and the highest value of the printed relief, without the key."""
        if not isinstance(self.file.surface, WaveSum):
            own, by = self.file.extremes, self.model.scale[2]
            return replace(own, low=own.low * by, high=own.high * by)
        return extremes_on(self.surface, self.size_mm, (self.file.design or self.file).key_mm, self.outline)

    def deviation_mm(self, block: Block, *, printable: bool = False) -> Floats:
        """Return the height of the print above the formula on a grid of points, after the best fit of a plane.

        The middle of the texture is at the same place in both, as after an alignment of a scan.

        Args:
            block: The block that the print is expected to equal.
            printable: Whether only the waves of the formula that the nozzle can print are compared with their prints.

        Returns:
            The deviations, shape (nx, ny); NaN outside of the outline and beyond the key.
        """
        printed, design = self.surface, block.surface
        if printable:
            assert isinstance(design, WaveSum)
            wide = is_printable(design, self.model).astype(np.float64)
            printed, design = _multiplied(printed, wide), _multiplied(design, wide)
        x, y = (np.linspace(0.0, side, _POINTS) for side in block.size_mm)
        shift_x, shift_y = self.shift_mm(block)
        z = printed.grid(x + shift_x, y + shift_y) - design.grid(x, y)
        across, down = np.meshgrid(x, y, indexing="ij")
        inside = np.ones(z.shape, bool) if block.region is None else block.region.excess(across, down) <= 0.0
        plane = np.stack([np.ones_like(z), across, down], axis=-1)
        fitted = np.linalg.lstsq(plane[inside], z[inside], rcond=None)[0]
        return np.where(inside, z - plane @ fitted, np.nan)

    def errors(self, block: Block) -> Errors:
        """Return the errors of the print of a texture that is a sum of waves.

        Args:
            block: The block that the print is expected to equal.
        """
        z, printable = self.deviation_mm(block), self.deviation_mm(block, printable=True)
        x, y = (np.linspace(0.0, side, _POINTS)[::_EVERY] for side in block.size_mm)
        heights = block.surface.grid(x, y) + z[::_EVERY, ::_EVERY]
        points = np.column_stack([np.repeat(x, len(y)), np.tile(y, len(x)), heights.ravel()])
        points = points[np.isfinite(points[:, 2])]
        normal = distance_along_normal(points, lambda u, v: (block.surface(u, v), *block.surface.gradient(u, v)))
        vertical, wide, nearest = (float(np.sqrt(np.nanmean(error**2))) for error in (z, printable, normal))
        return Errors(rms_mm=vertical, printable_rms_mm=wide, normal_rms_mm=nearest)


def _multiplied(surface: WaveSum, factors: Floats) -> WaveSum:
    """Return the surface with each wave multiplied by its factor."""
    waves = zip(surface.waves, factors.tolist(), strict=True)
    return replace(surface, waves=tuple(replace(wave, amplitude=wave.amplitude * by) for wave, by in waves))


def transfers(surface: WaveSum, model: PrinterModel) -> Floats:
    """Return the factor by which a print multiplied the amplitude of each wave, shape (n,).

    Args:
        surface: The surface in mm, with the wavelengths of the print.
        model: The printer.
    """
    factors = [
        model.transfer(2.0 * math.pi / math.hypot(f, g), math.degrees(math.atan2(g, f))) if (f or g) else 1.0
        for _, f, g, _ in surface.table
    ]
    return np.array(factors, dtype=np.float64)


def is_printable(surface: WaveSum, model: PrinterModel) -> Bools:
    """Return for each wave of a printed surface in mm whether its ridges are as wide as the nozzle, shape (n,)."""
    return np.asarray(np.hypot(surface.table[:, 1], surface.table[:, 2]) <= math.pi / model.nozzle_mm)


def is_correctable(surface: WaveSum, model: PrinterModel) -> Bools:
    """Return for each wave of a printed surface in mm whether its amplitude can be corrected, shape (n,).

    It cannot if the ridges of the wave are narrower than the nozzle, or if the printer loses the wave.
    """
    constant = ~np.any(surface.table[:, 1:3], axis=1)
    return np.asarray(is_printable(surface, model) & ~constant & (transfers(surface, model) >= MIN_TRANSFER))


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
        extremes = extremes_on(_multiplied(design, factors * transfer), block.size_mm, block.key_mm, block.outline)
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


@dataclass(frozen=True, kw_only=True)
class PredictedWave:
    """A wave of a formula, as it is printed from a plain and from a corrected file.

    Args:
        wavelength_mm: The wavelength.
        direction_deg: The angle between the x axis and the direction in which the height changes.
        amplitude_mm: The amplitude in the formula.
        plain_mm: The amplitude in the print of a plain file.
        file_mm: The amplitude in the corrected file.
        corrected_mm: The amplitude in the print of the corrected file.
        note: Why the wave is not completely corrected; empty if it is.
    """

    wavelength_mm: float
    direction_deg: float
    amplitude_mm: float
    plain_mm: float
    file_mm: float
    corrected_mm: float
    note: str


@dataclass(frozen=True, kw_only=True)
class Errors:
    """The predicted errors of a print: root mean squares over the top after the best alignment with the formula.

    Args:
        rms_mm: The vertical error.
        printable_rms_mm: The vertical error of the waves that the nozzle can print.
        normal_rms_mm: The distance from the formula along its normal, as scans measure it. It is small on steep flanks.
    """

    rms_mm: float
    printable_rms_mm: float
    normal_rms_mm: float

    def is_below(self, other: Errors) -> bool:
        """Return whether the vertical error and the error along the normal are smaller than those of another print."""
        return self.rms_mm < other.rms_mm and self.normal_rms_mm < other.normal_rms_mm


@dataclass(frozen=True, kw_only=True)
class Effect:
    """The expected effect of a correction.

    Args:
        block: The name of the corrected block.
        texture: The name of the texture.
        model: The name of the printer model.
        relief_rule: Its rule for the relief of corrected prints.
        size_mm: The sides and the height of the formula's block.
        plain_size_mm: The sides and the height of a print of the plain file.
        corrected_size_mm: The sides and the height of a print of the corrected file.
        file_size_mm: The sides and the height of the corrected file.
        relief_mm: The relief of the formula.
        plain_relief_mm: The relief of a print of the plain file.
        corrected_relief_mm: The relief of a print of the corrected file.
        plain: The predicted errors of a print of the plain file; None if the texture is not a sum of waves.
        corrected: The same for the corrected file.
        free: The same for a file that is corrected with a free relief.
        waves: The waves, by decreasing amplitude; empty if the texture is not a sum of waves.
    """

    block: str
    texture: str
    model: str
    relief_rule: ReliefRule
    size_mm: tuple[float, float, float]
    plain_size_mm: tuple[float, float, float]
    corrected_size_mm: tuple[float, float, float]
    file_size_mm: tuple[float, float, float]
    relief_mm: float
    plain_relief_mm: float
    corrected_relief_mm: float
    plain: Errors | None
    corrected: Errors | None
    free: Errors | None
    waves: tuple[PredictedWave, ...]

    @property
    def helps(self) -> bool:
        """Whether the correction is expected to reduce the vertical error and the error along the normal."""
        return self.plain is None or self.corrected is None or self.corrected.is_below(self.plain)


def effect_of(block: Block) -> Effect:
    """Return the expected effect of a block's correction.

    Raises:
        InputError: The block is not corrected.
    """
    model = block.correction
    if model is None:
        raise InputError("block", block.name, "is not corrected for a printer")
    plain = Print(file=replace(block, correction=None), model=model)
    corrected = Print(file=in_file(block), model=model)
    waves: tuple[PredictedWave, ...] = ()
    errors: list[Errors | None] = [None] * 3
    design, file = block.surface, corrected.file.surface
    if isinstance(design, WaveSum) and isinstance(file, WaveSum):
        free = Print(file=in_file(replace(block, correction=replace(model, relief_rule="free"))), model=model)
        errors = [each.errors(block) for each in (plain, corrected, free)]
        can = is_correctable(design, model).tolist()
        rows = zip(design.waves, file.waves, plain.surface.waves, corrected.surface.waves, can, strict=True)
        waves = tuple(
            PredictedWave(
                wavelength_mm=2.0 * math.pi / math.hypot(wave.f, wave.g),
                direction_deg=math.degrees(math.atan2(wave.g, wave.f)),
                amplitude_mm=abs(wave.amplitude),
                plain_mm=abs(before.amplitude),
                file_mm=abs(changed.amplitude),
                corrected_mm=abs(after.amplitude),
                note=_note(abs(changed.amplitude / wave.amplitude), wave.f, wave.g, model, correctable),
            )
            for wave, changed, before, after, correctable in rows
            if wave.amplitude and (wave.f or wave.g)
        )
    return Effect(
        block=block.name,
        texture=block.texture.name,
        model=model.name,
        relief_rule=model.relief_rule,
        size_mm=(*block.size_mm, block.height_mm),
        plain_size_mm=(*plain.size_mm, plain.height_mm),
        corrected_size_mm=(*corrected.size_mm, corrected.height_mm),
        file_size_mm=(*corrected.file.size_mm, corrected.file.height_mm),
        relief_mm=block.relief_mm,
        plain_relief_mm=plain.relief_mm,
        corrected_relief_mm=corrected.relief_mm,
        plain=errors[0],
        corrected=errors[1],
        free=errors[2],
        waves=tuple(sorted(waves, key=lambda wave: -wave.amplitude_mm)),
    )


def _note(factor: float, f: float, g: float, model: PrinterModel, correctable: bool) -> str:
    if not correctable:
        narrow = math.hypot(f, g) > math.pi / model.nozzle_mm
        return "narrower than the nozzle" if narrow else "lost by the printer"
    return f"limit {MAX_FACTOR:g}" if not 1.001 / MAX_FACTOR < factor < 0.999 * MAX_FACTOR else ""
