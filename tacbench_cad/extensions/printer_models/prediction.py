"""The prediction of prints: sides, height, the amplitude of each wave, and the errors, by the model of a printer."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tacbench_cad.extensions.printer_models.model import PrinterModel
from tacbench_cad.spec import Block, Circle, Extremes, Outline, WaveSum, distance_along_normal, extremes_on, without_key
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: If a printer leaves less than this fraction of a wave, the wave is lost, and it is not corrected.
MIN_TRANSFER = 0.1
#: The number of points along each side at which vertical deviations are predicted. Deviations along the normal take
#: longer, so they are predicted at every n-th of these points.
_POINTS, _EVERY = 401, 4


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
class Print:
    """The predicted print of a file, in its own frame with the lower corner at (0, 0).

    Args:
        file: The block as it is in the file; see :class:`~tacbench_cad.extensions.printer_models.correction.Corrected`.
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
        return multiplied(placed, transfers(placed, self.model))

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
        key_mm = self.file.key_mm
        region = self.outline if key_mm is None else without_key(self.size_mm, key_mm)
        return extremes_on(self.surface, self.size_mm, region)

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
            printed, design = multiplied(printed, wide), multiplied(design, wide)
        x, y = (np.linspace(0.0, side, _POINTS) for side in block.size_mm)
        shift_x, shift_y = self.shift_mm(block)
        z = printed.grid(x + shift_x, y + shift_y) - design.grid(x, y)
        across, down = np.meshgrid(x, y, indexing="ij")
        inside = np.ones(z.shape, bool) if block.region is None else block.region.distance(across, down) <= 0.0
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


def multiplied(surface: WaveSum, factors: Floats) -> WaveSum:
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
