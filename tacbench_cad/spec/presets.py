"""The presets ``paper`` and ``released``: the geometry of the paper's text, and that of the authors' files."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.textures import BlockTable, require_own_unit
from tacbench_cad.util.errors import InputError

Preset = Literal["paper", "released"]
#: The names of the presets.
PRESETS: tuple[str, ...] = ("paper", "released")


@dataclass(frozen=True, kw_only=True)
class PresetValues:
    """The values of a preset.

    Args:
        size_mm: The sides x, y, in mm.
        height_mm: The height of the highest point, in mm.
        mm_per_unit: The millimetres per unit of u, v and height.
        grid: The sample grid that ``--grid`` selects.
        sampling: How meshes approximate the formula.
    """

    size_mm: tuple[float, float]
    height_mm: float
    mm_per_unit: tuple[float, float, float]
    grid: SampleGrid
    sampling: Tolerance | SampleGrid


_PAPER_GRID = SampleGrid(nx=189, ny=201)
_RELEASED_GRID = SampleGrid(nx=294, ny=301)
#: The values of each preset.
VALUES = {
    "paper": PresetValues(
        size_mm=(23.3, 30.0),
        height_mm=7.0,
        mm_per_unit=(23.3 / (6 * math.pi + 0.5), 30.0 / (6 * math.pi + 1.2), 1.0),
        grid=_PAPER_GRID,
        sampling=Tolerance(),
    ),
    "released": PresetValues(
        size_mm=(29.3, 30.0),
        height_mm=7.0,
        mm_per_unit=(1.0, 1.0, 1.0),
        grid=_RELEASED_GRID,
        sampling=_RELEASED_GRID,
    ),
}


def with_table(
    values: PresetValues, table: BlockTable, surface: Surface
) -> tuple[tuple[float, float], tuple[float, float, float], tuple[float, float], bool]:
    """Return sides, mm per unit and origin of a preset with a texture file's settings, and whether any is changed.

    A unit of a surface in mm is 1 mm in every preset. A height map in mm that does not repeat sets the sides.

    Raises:
        InputError: The settings contradict each other or the unit of the surface.
    """
    require_own_unit("[block] mm_per_unit", table.mm_per_unit, surface)
    in_mm = surface.unit == "mm"
    if in_mm:
        table = replace(table, mm_per_unit=None, domain=table.domain or _own_domain(surface, table.size_mm))
    changed = any(value is not None for value in (table.size_mm, table.mm_per_unit, table.domain, table.height_mm))
    size = table.size_mm or values.size_mm
    unit = (1.0, 1.0, 1.0) if in_mm else table.mm_per_unit or values.mm_per_unit
    if table.domain is None:
        return size, unit, (0.0, 0.0), changed
    (u0, u1), (v0, v1) = table.domain
    if not (u1 > u0 and v1 > v0):
        raise InputError("[block] domain", table.domain, "each lower end must be below its upper end")
    spans = (u1 - u0, v1 - v0)
    if table.mm_per_unit is None and not in_mm:
        unit = (size[0] / spans[0], size[1] / spans[1], values.mm_per_unit[2])
    elif table.size_mm is None:
        size = (spans[0] * unit[0], spans[1] * unit[1])
    elif any(abs(spans[i] * unit[i] - size[i]) > 1e-9 * size[i] for i in (0, 1)):
        product = f"{spans[0] * unit[0]:g} x {spans[1] * unit[1]:g} mm"
        allowed = f"the domain has {product}; leave one of the two out"
        if not in_mm:
            allowed = f"domain times mm_per_unit is {product}; leave one of the three out"
        raise InputError("[block] size_mm", table.size_mm, allowed)
    return size, unit, (u0, v0), changed


def _own_domain(
    surface: Surface, size_mm: tuple[float, float] | None
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Return the domain of a height map in mm, or its lower left part of some size; None for other surfaces."""
    across, down = surface.ends
    if across is None or down is None:
        return None
    (x0, x1), (y0, y1) = across, down
    width, depth = size_mm or (x1 - x0, y1 - y0)
    return ((x0, x0 + width), (y0, y0 + depth))


def grid_of_same_step(values: PresetValues, size: tuple[float, float], unit: tuple[float, float, float]) -> SampleGrid:
    """Return the preset's sample grid, or for another domain the grid with the nearest step in units."""

    def count(axis: int, samples: int) -> int:
        step = values.size_mm[axis] / values.mm_per_unit[axis] / (samples - 1)
        return max(2, round(size[axis] / unit[axis] / step) + 1)

    return SampleGrid(nx=count(0, values.grid.nx), ny=count(1, values.grid.ny))
