"""The distance between the formula and the surface that a slicer's G-code will print.

Where the surface is flatter than 45 degrees, the height error is used. On steeper walls a height error says little, so
there the sideways error is used: the horizontal distance, along the steepest slope, to the point where the formula has
the printed height. All numbers exclude the edge of the block, where every bead is rounded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from tacbench_cad.extensions.slicing.gcode import Sliced, read_gcode
from tacbench_cad.extensions.slicing.printed_surface import BedPlace, frames_of, printed_heights, staircase
from tacbench_cad.spec import (
    EDGE_MM,
    PITCH_MM,
    Block,
    Extrema,
    Texture,
    catalogue,
    crest_errors,
    points_of,
    without_edge,
)
from tacbench_cad.util.convert import to_plain
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: The slope from which a wall counts as steep.
STEEP = 1.0
#: The position error for which the effect on the height error is computed, in mm.
MISPLACED_MM = 0.1
#: If the height error exceeds this fraction of the relief's standard deviation, the print shows another texture.
UNLIKE = 0.5
#: What to do if a block does not lie at the given position.
_MOVED = "slice the plate without moving its blocks (PrusaSlicer: --dont-arrange), or name the place of this block"
#: The search for a height on a steep wall: largest distance and step, in mm, and the largest number of points.
_REACH_MM, _STEP_MM, _MAX_STEEP = 0.8, 0.02, 20_000
#: The distance of the points with which quarter turns and textures are distinguished, in mm.
_COARSE_MM = 0.2


@dataclass(frozen=True, kw_only=True)
class Sideways:
    """The sideways error on steep walls.

    Args:
        rms_mm: The root mean square of the error, where the formula has the printed height within 0.8 mm.
        ideal_rms_mm: The same number for the ideal staircase.
        missing_fraction: The fraction of the steep walls where the formula does not have the printed height within
            0.8 mm.
    """

    rms_mm: float
    ideal_rms_mm: float
    missing_fraction: float


@dataclass(frozen=True, eq=False, kw_only=True)
class AsSliced:
    """The comparison of a printed surface with the formula.

    Args:
        sliced: The G-code.
        block: The block.
        frame: The position of the block on the bed.
        x_mm: The x coordinates of the grid, shape (n,).
        y_mm: The y coordinates of the grid, shape (m,).
        printed_mm: The heights of the print, shape (n, m).
        formula_mm: The heights of the formula, shape (n, m).
        ideal_mm: The heights of the ideal staircase, shape (n, m).
    """

    sliced: Sliced
    block: Block
    frame: BedPlace
    x_mm: Floats
    y_mm: Floats
    printed_mm: Floats
    formula_mm: Floats
    ideal_mm: Floats

    @cached_property
    def inside(self) -> Bools:
        """Whether a point is compared: it is not near the edge or the cut of the key. Shape (n, m)."""
        return without_edge(self.block, self.x_mm, self.y_mm)

    @cached_property
    def slope(self) -> Floats:
        """The slope of the formula, shape (n, m)."""
        along_x, along_y = self.block.surface.gradient(self.x_mm[:, None], self.y_mm[None, :])
        return np.hypot(along_x, along_y)

    @cached_property
    def flat(self) -> Bools:
        """Whether the height error of a point is used, shape (n, m)."""
        return self.inside & (self.slope < STEEP)

    @property
    def flat_fraction(self) -> float:
        """The fraction of the compared points that are flatter than :data:`STEEP`."""
        return float(self.flat.sum() / self.inside.sum())

    @cached_property
    def rms_mm(self) -> float | None:
        """The root mean square of the height error on the flat part; None if there is no flat part."""
        return _rms((self.printed_mm - self.formula_mm)[self.flat])

    @property
    def mean_mm(self) -> float | None:
        """The mean height error on the flat part; positive if too much is printed."""
        return float((self.printed_mm - self.formula_mm)[self.flat].mean()) if self.flat.any() else None

    @cached_property
    def ideal_rms_mm(self) -> float | None:
        """The value of :attr:`rms_mm` for the ideal staircase."""
        return _rms((self.ideal_mm - self.formula_mm)[self.flat])

    @cached_property
    def misplaced_rms_mm(self) -> float | None:
        """The largest height error (rms) if the position of the block is wrong by 0.1 mm along x or y."""
        errors = []
        for dx, dy in ((MISPLACED_MM, 0.0), (-MISPLACED_MM, 0.0), (0.0, MISPLACED_MM), (0.0, -MISPLACED_MM)):
            shifted = self.block.datum_mm + self.block.surface.grid(self.x_mm + dx, self.y_mm + dy)
            errors.append(_rms((self.printed_mm - shifted)[self.flat]))
        return max((error for error in errors if error is not None), default=None)

    @cached_property
    def sideways(self) -> Sideways | None:
        """The sideways error on steep walls; None if there are no steep walls."""
        i, j = np.nonzero(self.inside & (self.slope >= STEEP))
        if len(i) == 0:
            return None
        every = math.ceil(len(i) / _MAX_STEEP)
        i, j = i[::every], j[::every]
        x, y = self.x_mm[i], self.y_mm[j]
        printed, ideal = (_sideways(self.block, x, y, heights[i, j]) for heights in (self.printed_mm, self.ideal_mm))
        return Sideways(
            rms_mm=_rms(printed[np.isfinite(printed)]) or 0.0,
            ideal_rms_mm=_rms(ideal[np.isfinite(ideal)]) or 0.0,
            missing_fraction=float(np.isnan(printed).mean()),
        )

    @cached_property
    def peaks(self) -> Extrema:
        """The errors at the local maxima of the formula. A ridge counts as one maximum."""
        return crest_errors.peaks(*self._surfaces, self.sliced.layer_mm)

    @cached_property
    def valleys(self) -> Extrema:
        """The errors at the local minima of the formula."""
        return crest_errors.valleys(*self._surfaces, self.sliced.layer_mm)

    @property
    def _surfaces(self) -> tuple[Floats, Floats, Bools, Floats, Floats]:
        return self.formula_mm, self.printed_mm, self.inside, self.x_mm, self.y_mm

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the file, the block or the numbers."""
        sliced, block = self.sliced, self.block
        warnings = []
        first = float(sliced.layer_tops_mm[0] - sliced.floor_mm)
        layers = (block.height_mm - first) / sliced.layer_mm
        if abs(layers - round(layers)) * sliced.layer_mm > 0.002:
            below, above = (first + count * sliced.layer_mm for count in (math.floor(layers), math.ceil(layers)))
            warnings.append(
                f"the block's height of {block.height_mm:.6g} mm is not a whole number of layers: with a first layer "
                f"of {first:.4g} mm and layers of {sliced.layer_mm:.4g} mm it becomes {below:.6g} or {above:.6g} mm"
            )
        steps = np.diff(sliced.layer_tops_mm)
        if len(steps) and float(np.ptp(steps)) > 0.002:
            warnings.append(f"the layer height varies from {steps.min():.4g} to {steps.max():.4g} mm")
        if sliced.filament_assumed:
            warnings.append(
                f"the file does not state the diameter of the filament; with {sliced.filament_mm:g} mm the beads are "
                f"{float(np.median(sliced.beads.width_mm)):.3g} mm wide (use --filament for another diameter)"
            )
        if sliced.unknown:
            warnings.append(
                f"these features are unknown for {sliced.dialect} and were counted as part of the block: "
                f"{', '.join(sliced.unknown)}"
            )
        if self.frame.outline_mm is not None:
            sides = block.size_mm if self.frame.quarters % 2 == 0 else block.size_mm[::-1]
            off = max(abs(length - side) for length, side in zip(self.frame.outline_mm, sides, strict=True))
            if off > 0.1:
                warnings.append(
                    f"the outline differs from the block's sides by {off:.2g} mm; check the scale and the horizontal "
                    "expansion in the slicer"
                )
        if block.grid_aliases:
            warnings.append(
                "the published surface has another shape than its formula; the print is compared with the formula"
            )
        return tuple(warnings)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON: lengths in mm, fractions from 0 to 1."""
        sliced = self.sliced
        return {
            "file": sliced.path.name,
            "block": self.block.name,
            "dialect": sliced.dialect,
            "layers": len(sliced.layer_tops_mm),
            "layer_mm": sliced.layer_mm,
            "bead_width_mm": float(np.median(sliced.beads.width_mm)),
            "filament_mm": sliced.filament_mm,
            "filament_assumed": sliced.filament_assumed,
            "left_out": dict(sliced.left_out),
            "frame": self.frame.as_dict(),
            "edge_mm": EDGE_MM,
            "height": {
                "fraction": self.flat_fraction,
                "rms_mm": self.rms_mm,
                "mean_mm": self.mean_mm,
                "ideal_rms_mm": self.ideal_rms_mm,
                "misplaced_rms_mm": self.misplaced_rms_mm,
                "misplaced_by_mm": MISPLACED_MM,
            },
            "sideways": to_plain(self.sideways),
            "peaks": to_plain(self.peaks),
            "valleys": to_plain(self.valleys),
            "warnings": list(self.warnings),
        }


def slice_check(
    path: Path, block: Block, frame: BedPlace | None = None, *, filament_mm: float | None = None
) -> AsSliced:
    """Compare the surface that a slicer's G-code will print with the formula.

    Args:
        path: The G-code file.
        block: The block that was sliced.
        frame: The position of the block on the bed; None to find it.
        filament_mm: The diameter of the filament; None to read it from the file.

    Raises:
        InputError: The file is not readable G-code, or it prints another part than the block.
    """
    return compare(read_gcode(path, filament_mm), block, frame)


def compare(sliced: Sliced, block: Block, frame: BedPlace | None = None, *, pitch_mm: float = PITCH_MM) -> AsSliced:
    """Compare what a G-code file prints with its block.

    Args:
        sliced: The G-code.
        block: The block that was sliced.
        frame: The position of the block on the bed; None to find it by the outer walls of the low layers.
        pitch_mm: The distance of the points that are compared.

    Raises:
        InputError: The G-code is for another part, prints nothing at the given position, or has the block elsewhere.
    """
    frames = [frame] if frame is not None else frames_of(sliced, block)
    x, y = points_of(block, _COARSE_MM)
    looks = [printed_heights(sliced, block, place, x, y) for place in frames]
    inside = without_edge(block, x, y)
    best = min(range(len(frames)), key=lambda i: _distance(block, block.texture, x, y, looks[i], inside))
    _require_like(sliced, block, x, y, looks[best], inside)
    x, y = points_of(block, pitch_mm)
    formula = block.datum_mm + block.surface.grid(x, y)
    return AsSliced(
        sliced=sliced,
        block=block,
        frame=frames[best],
        x_mm=x,
        y_mm=y,
        printed_mm=printed_heights(sliced, block, frames[best], x, y),
        formula_mm=formula,
        ideal_mm=staircase(sliced, formula),
    )


def _distance(block: Block, texture: Texture, x: Floats, y: Floats, printed: Floats, inside: Bools) -> float:
    """Return the standard deviation of the height error for another texture of the block."""
    along_x, along_y, up = block.mm_per_unit
    formula = texture.surface.mapped((along_x, along_y), up, block.origin_uv).grid(x, y)
    return float(np.std((printed - formula)[inside]))


def _require_like(sliced: Sliced, block: Block, x: Floats, y: Floats, printed: Floats, inside: Bools) -> None:
    """Check that a print resembles the block.

    Raises:
        InputError: It does not.
    """
    if not printed[inside].any():
        raise InputError("frame", None, f"{sliced.path} prints nothing there; {_MOVED}")
    own = _distance(block, block.texture, x, y, printed, inside)
    others = {
        texture.name: _distance(block, texture, x, y, printed, inside)
        for texture in catalogue(block.preset)
        if texture.name != block.texture.name
    }
    name = min(others, key=others.__getitem__)
    nearer = others[name] < 0.5 * own
    relief_sd = float(np.std(block.surface.grid(x, y)[inside]))
    if own <= UNLIKE * relief_sd and not (nearer and own > sliced.layer_mm):
        return
    hint = f", but only {others[name]:.3g} mm from {name}" if nearer else ""
    raise InputError(
        "file",
        str(sliced.path),
        f"is for another part: the rms distance of its top is {own:.3g} mm from {block.texture.name}{hint}; "
        f"give the --texture, --preset and --scale of the sliced block. With --frame, {_MOVED}",
    )


def _rms(values: Floats) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _sideways(block: Block, x: Floats, y: Floats, heights: Floats) -> Floats:
    """Return the distance along the steepest slope to the point where the formula has a given height.

    Args:
        block: The block.
        x: The x coordinates of the points, shape (n,).
        y: The y coordinates of the points, shape (n,).
        heights: The given heights, shape (n,).

    Returns:
        The distances, shape (n,); NaN if the formula does not have the height within 0.8 mm.
    """
    along_x, along_y = block.surface.gradient(x, y)
    slope = np.hypot(along_x, along_y)
    ux, uy = along_x / slope, along_y / slope
    nearest = np.full(len(x), np.nan)
    at_zero = block.height_at(x, y) - heights
    for sign in (1.0, -1.0):
        before = at_zero
        for k in range(1, round(_REACH_MM / _STEP_MM) + 1):
            away = sign * k * _STEP_MM
            here = block.height_at(x + away * ux, y + away * uy) - heights
            crossed = (before * here <= 0.0) & (before != here)
            fraction = np.where(crossed, before / np.where(crossed, before - here, 1.0), 0.0)
            distance = (k - 1 + fraction) * _STEP_MM
            nearest = np.where(crossed, np.fmin(nearest, distance), nearest)
            before = here
    return nearest
