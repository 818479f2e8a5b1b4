"""The body of a texture above or below an area of a face. It is added to the mesh of a part, or cut from it.

On a plane without a fade, its upper side is the mesh of a block, which has few triangles. On a cylinder and with a
fade, it is a grid of lines on which triangles interpolate the formula.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import manifold_of
from tacbench_cad.geometry.meshing.top import Top, textured_top
from tacbench_cad.geometry.textured.field import Height
from tacbench_cad.geometry.textured.frame import Frame
from tacbench_cad.geometry.textured.height_grid import HeightGrid, body_between, height_grid
from tacbench_cad.geometry.texturing import Texturing
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from tacbench_cad.geometry.textured.region import OutlineEdge, Region

#: The height of a block below its texture, in mm. It is cut off.
_BLOCK_BASE_MM = 2.0
#: The fraction of the tolerance for a texture before it is wound around a cylinder.
_FRACTION = 0.35


@dataclass(frozen=True, eq=False)
class Area:
    """A connected area of a face that gets a texture.

    Args:
        frame: The local coordinates. The lowest s and t are 0.
        polygons: The outline, each of shape (n, 2); the area is on the left.
        size_mm: The extents along s and t.
        is_rectangle: Whether it is a rectangle, or a band around a cylinder.
        is_closed: Whether it goes all the way around a cylinder.
    """

    frame: Frame
    polygons: tuple[Floats, ...]
    size_mm: tuple[float, float]
    is_rectangle: bool
    is_closed: bool

    @classmethod
    def of_region(cls, region: Region, tolerance_mm: float) -> Self:
        """Return the area of a region of a solid's face. Chords within a tolerance replace its curves."""
        polygons = [np.concatenate([_chords(edge, tolerance_mm)[:-1] for edge in loop]) for loop in region.loops]
        return cls(region.frame, tuple(polygons), region.size_mm, region.is_rectangle, region.is_closed)

    def prism(self, low_mm: float, high_mm: float) -> Any:
        """Return the space above the area between two heights, in local coordinates; for planes only."""
        import manifold3d

        polygons = [np.ascontiguousarray(points) for points in self.polygons]
        outline = manifold3d.CrossSection(polygons, manifold3d.FillRule.EvenOdd)
        return outline.extrude(high_mm - low_mm).translate((0.0, 0.0, low_mm))

    def placed(self, body: Any) -> Any:
        """Move a body from the local coordinates of a plane into the part."""
        return body.transform(np.column_stack([self.frame.axes.T, self.frame.origin]))


@dataclass(frozen=True, eq=False)
class TextureBody:
    """The body of a texture.

    Args:
        body: The body as an object of manifold3d, in the coordinates of the part.
        error_mm: The largest distance between its triangles and the formula.
        evidence: Whether this distance is proved, or measured on a grid that is three times finer.
    """

    body: Any
    error_mm: float
    evidence: Literal["proved", "measured"]


def texture_body(
    area: Area,
    height: Height,
    texturing: Texturing,
    mm_per_unit: tuple[float, float],
    other_mm: float,
    tolerance_mm: float,
) -> TextureBody:
    """Return the body between a texture and a constant height.

    Args:
        area: The area.
        height: The height of the texture above it.
        texturing: The settings.
        mm_per_unit: The millimetres per unit of u and v.
        other_mm: The constant height: below a raised texture, and above a sunk one.
        tolerance_mm: The largest distance between the triangles and the formula.

    Raises:
        InputError: The tolerance needs too many triangles.
    """
    low, high = height.range_mm
    if area.frame.radius_mm is None and not height.fade.length_mm:
        block = _block(height, texturing, mm_per_unit, min(low, other_mm), tolerance_mm)
        mesh, certificate = mesh_block(block)
        body = manifold_of(mesh.vertices + np.array([0.0, 0.0, high - block.height_mm]), mesh.faces)
        error = certificate.distance_mm - height.own_error_mm
        if texturing.sunk:
            return TextureBody(area.placed(area.prism(low - 1.0, other_mm) - body), error, "proved")
        return TextureBody(area.placed(body ^ area.prism(other_mm, high + 1.0)), error, "proved")
    if area.frame.radius_mm is not None and not height.fade.length_mm and height.surface.is_separable:
        block = _block(height, texturing, mm_per_unit, min(low, other_mm), _FRACTION * tolerance_mm)
        grid, heights = _wound(area.frame, height, block, area.is_closed, tolerance_mm)
    else:
        grid = height_grid(height, area.frame, tolerance_mm)
        heights = height.grid(grid.s, grid.t)
        if area.is_closed:
            heights[-1] = heights[0]
    other = np.full((1, 1), other_mm)
    lower, upper = (heights, other) if texturing.sunk else (other, heights)
    if area.is_rectangle:
        body = body_between(area.frame, grid.s, grid.t, lower, upper, area.is_closed)
    else:
        own = Frame(np.zeros(3), np.eye(3))
        space = area.prism(float(lower.min()) - 1.0, float(upper.max()) + 1.0)
        body = area.placed(body_between(own, grid.s, grid.t, lower, upper, False) ^ space)
    return TextureBody(body, grid.error_mm, grid.evidence)


def _block(
    height: Height, texturing: Texturing, mm_per_unit: tuple[float, float], bottom_mm: float, tolerance_mm: float
) -> Block:
    """Return a block that reaches from below a height to the texture."""
    own_mm = height.own_error_mm
    return Block(
        texture=texturing.texture,
        preset="paper",
        nominal_size_mm=height.size_mm,
        nominal_mm_per_unit=(*mm_per_unit, height.factor),
        nominal_height_mm=_BLOCK_BASE_MM + height.range_mm[1] - bottom_mm,
        origin_uv=texturing.origin_uv,
        sampling=Tolerance(mm=max(tolerance_mm, own_mm) + own_mm),
    )


def _wound(
    frame: Frame, height: Height, block: Block, is_closed: bool, tolerance_mm: float
) -> tuple[HeightGrid, Floats]:
    """Wind the top of a separable block around a cylinder, with more lines along the axis.

    The top is within its certificate of the formula before it is wound, and winding stretches this distance at most by
    the ratio of the radii. On a facet with the slopes g along s and t, the wound surface P has the second derivatives
    ``|P_ss| = |2 i g_s / R - (R + h) / R**2|``, ``|P_st| = |g_t| / R`` and ``P_tt = 0``. With the sides a and b of a
    cell, its triangles are therefore at most ``(a**2 |P_ss| + 2 a b |P_st|) / 8`` from it.

    Returns:
        The grid and its heights, shape (n, m).
    """
    top, radius = textured_top(block), frame.radius_mm
    assert isinstance(top, Top) and top.profiles is not None and radius is not None
    s, t = (lines * (size / lines[-1]) for lines, size in zip((top.x, top.y), height.size_mm, strict=True))
    along_s, along_t = top.profiles.a, top.profiles.b
    low, high = height.range_mm
    start = block.formula_datum_mm + high - block.height_mm
    jump = abs(float(along_s[-1] - along_s[0])) / 2.0 if is_closed else 0.0
    reach = radius + max(abs(low), abs(high))
    fit_mm = (top.certificate.distance_mm + jump) * reach / radius
    bend = np.hypot(2.0 * np.diff(along_s) / np.diff(s) / radius, reach / radius**2)
    turn = float(np.abs(np.diff(along_t)).max()) / (4.0 * radius)
    step = (np.sqrt(turn**2 + bend * max(tolerance_mm - fit_mm, 0.1 * tolerance_mm) / 2.0) - turn) * 4.0 / bend
    counts = np.maximum(1, np.ceil(np.diff(s) / step)).astype(int)
    chord_mm = float(((np.diff(s) / counts) ** 2 * bend / 8.0 + np.diff(s) / counts * turn).max())
    parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(s[:-1], s[1:], counts, strict=True)]
    lines = np.append(np.concatenate(parts), s[-1])
    if is_closed:
        along_s[[0, -1]] = (along_s[0] + along_s[-1]) / 2.0
    heights = start + np.interp(lines, s, along_s)[:, None] + along_t[None, :]
    return HeightGrid(lines, t, fit_mm + chord_mm, "proved"), heights


def _chords(edge: OutlineEdge, tolerance_mm: float) -> Floats:
    """Return points along an edge of the outline whose chords are within a tolerance of the edge."""
    count = 1 if edge.kind == "line" else 8
    while True:
        points = edge.at(np.linspace(edge.first, edge.last, 2 * count + 1))
        off = float(np.linalg.norm((points[:-2:2] + points[2::2]) / 2.0 - points[1::2], axis=1).max())
        if edge.kind == "line" or off <= tolerance_mm:
            chosen = points[::2]
            return chosen if edge.forward else chosen[::-1]
        count = math.ceil(count * math.sqrt(off / tolerance_mm)) + 1
