"""The height of a texture above an area of a face. Importing this module does not load the CAD kernel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.textured.area import Area
from tacbench_cad.geometry.texturing import DEPTH_RANGE_MM, Texturing
from tacbench_cad.spec.surface import Surface
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.types import Floats

#: The material that must remain below a sunk texture, in mm.
FLOOR_MM = 0.4
#: The fraction of a side by which a height map may be smaller.
_NEAR = 1e-9


@dataclass(frozen=True, kw_only=True, eq=False)
class Height:
    """The height of a texture above an area.

    Args:
        texturing: The settings.
        area: The area.
        surface: The formula along s and t, in mm.
        mm_per_unit: The millimetres per unit of u and v. Around a cylinder, u is changed so that the texture closes.
        periods: The number of periods around a closed cylinder; None for other areas.
        start_mm: The height to which the texture fades, and its end that is nearer to the face.
        zero_mm: The value of the formula at ``start_mm``.
        far_mm: The value of the formula at the other end.
        factor: The factor of the formula.
    """

    texturing: Texturing
    area: Area
    surface: Surface
    mm_per_unit: tuple[float, float]
    periods: int | None
    start_mm: float
    zero_mm: float
    far_mm: float
    factor: float

    @property
    def fade_mm(self) -> float:
        """The length over which the texture fades out; 0 for none."""
        return self.texturing.fade_mm

    @property
    def fading(self) -> tuple[bool, bool] | None:
        """Whether the texture fades out towards the ends of s and of t; None if it does towards another outline."""
        if not self.fade_mm:
            return False, False
        return (not self.area.is_closed, True) if self.area.is_rectangle else None

    @property
    def range_mm(self) -> tuple[float, float]:
        """The lowest and the highest point of the texture above the face, in mm."""
        far = self.start_mm + self.factor * (self.far_mm - self.zero_mm)
        return min(self.start_mm, far), max(self.start_mm, far)

    @property
    def depth_mm(self) -> float:
        """The difference between the highest and the lowest point of the texture, in mm."""
        return abs(self.factor * (self.far_mm - self.zero_mm))

    @property
    def own_error_mm(self) -> float:
        """The distance of the formula from what it represents, for example from a height map, in mm."""
        return abs(self.factor) * self.surface.error

    def grid(self, s: Floats, t: Floats) -> Floats:
        """Return the heights on a grid, shape (n, m), in mm."""
        return self._faded(self.surface.grid(s, t), s[:, None], t[None, :])

    def __call__(self, s: Floats, t: Floats) -> Floats:
        """Return the heights at points, in mm. The arrays broadcast."""
        return self._faded(self.surface(s, t), s, t)

    def gradient(self, s: Floats, t: Floats) -> tuple[Floats, Floats]:
        """Return the slopes along s and t at points, from differences."""
        h = 1e-4
        return (self(s + h, t) - self(s - h, t)) / (2.0 * h), (self(s, t + h) - self(s, t - h)) / (2.0 * h)

    def breaks(self, axis: int) -> Floats:
        """Return the ends of the area along an axis, and the lines at which the texture begins to fade between them."""
        size, length = self.area.size_mm[axis], self.fade_mm
        fades = self.fading is not None and self.fading[axis]
        return np.unique([0.0, length, size - length, size] if fades else [0.0, size])

    def _faded(self, values: Floats, s: Floats, t: Floats) -> Floats:
        window: Floats | float = 1.0
        if self.fading is None:
            window = self._towards_outline(s, t)
        else:
            for at, size, fades in zip((s, t), self.area.size_mm, self.fading, strict=True):
                if fades:
                    distance = np.minimum(at, size - at)
                    window = window * (1.0 - np.cos(np.pi * np.clip(distance / self.fade_mm, -1.0, 1.0))) / 2.0
        return np.asarray(self.start_mm + self.factor * (values - self.zero_mm) * window, dtype=np.float64)

    def _towards_outline(self, s: Floats, t: Floats) -> Floats:
        """Return the product of a smooth step for each part of the outline between two convex corners."""
        s, t = np.broadcast_arrays(s, t)
        window = np.ones(s.size)
        for rows, distances in self.area.near(s.ravel(), t.ravel(), self.fade_mm):
            part = np.minimum(distances / self.fade_mm, 1.0)
            window[rows] *= part**4 * (35.0 - 84.0 * part + 70.0 * part**2 - 20.0 * part**3)
        return window.reshape(s.shape)


def height_over(area: Area, texturing: Texturing) -> Height:
    """Return the height of a texture above an area.

    Raises:
        InputError: The texture is flat over the area, cannot close around the cylinder or cannot fade out.
    """
    formula, unit, periods = texturing.texture.surface, texturing.unit_mm, None
    if area.is_closed:
        unit, periods = _closing(formula, unit, area.size_mm[0])
    shorter = area.size_mm[1] if area.is_closed else min(area.size_mm)
    if 2.0 * texturing.fade_mm > shorter:
        limit = f"must be at most {shorter / 2.0:.4g} mm, half of the textured region"
        raise InputError("fade_mm", texturing.fade_mm, limit)
    along_s, along_t = ((0.0, size) for size in area.size_mm)
    placed = formula.mapped(unit, 1.0, texturing.origin_uv)
    _require_known(placed, area.size_mm, texturing.texture.name)
    surface = placed.over(along_s, along_t)
    extremes = surface.extremes(along_s, along_t)
    if extremes.high - extremes.low < 1e-9:
        raise InputError(
            "texture", texturing.texture.name, "is flat over this face; choose another texture or direction"
        )
    factor = texturing.factor(extremes.high - extremes.low)
    require_between("depth_mm", factor * (extremes.high - extremes.low), *DEPTH_RANGE_MM, " mm")
    return Height(
        texturing=texturing,
        area=area,
        surface=surface,
        mm_per_unit=unit,
        periods=periods,
        start_mm=-texturing.base_mm if texturing.sunk else texturing.base_mm,
        zero_mm=extremes.high if texturing.sunk else extremes.low,
        far_mm=extremes.low if texturing.sunk else extremes.high,
        factor=factor,
    )


def require_radius(height: Height) -> None:
    """Check that a texture does not reach the axis of a cylinder.

    Raises:
        InputError: It does.
    """
    texturing, frame = height.texturing, height.area.frame
    reach = texturing.base_mm + height.depth_mm
    inwards = reach + FLOOR_MM if texturing.sunk else -reach
    if frame.radius_mm is not None and frame.side * inwards >= frame.radius_mm:
        raise InputError("depth_mm", height.depth_mm, f"is too much for a cylinder of radius {frame.radius_mm:.4g} mm")


def require_room(height: Height, common_mm3: float, whole_mm3: float) -> None:
    """Check that a raised texture does not touch other faces of the part, or that a sunk texture lies in material.

    Args:
        height: The height of the texture.
        common_mm3: The volume of the part in the space of the texture.
        whole_mm3: The volume of this space.

    Raises:
        InputError: It touches another face, or leaves the material.
    """
    if height.texturing.sunk and common_mm3 < (1.0 - 1e-4) * whole_mm3:
        reason = f"leaves less than {FLOOR_MM:g} mm of material below the texture; choose a smaller depth"
        raise InputError("depth_mm", height.depth_mm, reason)
    if not height.texturing.sunk and common_mm3 > 1e-6 * whole_mm3:
        reason = "makes the texture touch another face of the part; choose a larger margin"
        raise InputError("depth_mm", height.depth_mm, reason)


def _require_known(surface: Surface, size_mm: tuple[float, float], name: str) -> None:
    """Check that a height map covers an area.

    Raises:
        InputError: It does not.
    """
    for ends, size, side in zip(surface.ends, size_mm, "xy", strict=True):
        if ends is not None and (ends[0] > _NEAR * size or ends[1] < (1.0 - _NEAR) * size):
            covered = f"covers {ends[0]:.4g} to {ends[1]:.4g} mm along {side}, but the textured region {size:.4g} mm"
            raise InputError("texture", name, f"{covered}; choose a larger margin_mm, or let the texture repeat")


def _closing(surface: Surface, unit: tuple[float, float], around_mm: float) -> tuple[tuple[float, float], int | None]:
    """Return the millimetres per unit with which a texture closes around a cylinder, and its number of periods."""
    period = surface.period_u
    if period is None:
        raise InputError("texture", None, "has no period along x, so it cannot close around a cylinder")
    if math.isinf(period):
        return unit, None
    periods = max(1, round(around_mm / (unit[0] * period)))
    return (around_mm / (period * periods), unit[1]), periods
