"""The mesh of a part with textures on planar faces: the mesh of the part, combined with meshes of the formula."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import manifold_of
from tacbench_cad.geometry.meshing.top import Top, textured_top
from tacbench_cad.geometry.textured.field import Height
from tacbench_cad.geometry.textured.region import OutlineEdge, Region
from tacbench_cad.geometry.texturing import Texturing
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.types import Floats, Indices

if TYPE_CHECKING:
    import manifold3d

#: The depth by which a raised texture reaches into the part before both are joined, in mm.
_OVERLAP_MM = 0.05
#: The height of the part of a block below its texture, in mm. It is cut off.
_BLOCK_BASE_MM = 2.0
#: Vertices that are nearer than this may be merged, in mm.
_SIMPLIFY_MM = 2e-4
#: The fraction of the tolerance for the texture and for the chords of the outline.
_FRACTION = 0.9


def is_simple(region: Region, height: Height) -> bool:
    """Return whether :func:`combined` can mesh a texture: on a plane without a fade, or separable on a rectangle."""
    if region.frame.radius_mm is None and not height.fade.length_mm:
        return True
    return region.is_rectangle and height.surface.is_separable


def combined(
    vertices: Floats,
    faces: Indices,
    textures: list[tuple[Region, Height, Texturing, tuple[float, float]]],
    tolerance_mm: float,
) -> tuple[Floats, Indices]:
    """Put textures on the mesh of a part.

    The top of each texture is the mesh of a block, so its distance from the formula is proved. It is cut along the
    outline of its region, and then joined to the part or removed from it.

    Args:
        vertices: The vertices of the part, shape (n, 3), in mm.
        faces: The triangles of the part, shape (m, 3).
        textures: The regions, heights, settings and millimetres per unit of u and v.
        tolerance_mm: The largest distance from the formula.

    Returns:
        The vertices and the triangles.
    """
    whole = manifold_of(vertices, faces)
    for region, height, texturing, mm_per_unit in textures:
        low, high = height.range_mm
        on_grid = region.frame.radius_mm is not None or height.fade.length_mm > 0.0
        block = Block(
            texture=texturing.texture,
            preset="paper",
            nominal_size_mm=region.size_mm,
            nominal_mm_per_unit=(*mm_per_unit, height.factor),
            nominal_height_mm=_BLOCK_BASE_MM + high - low,
            origin_uv=texturing.origin_uv,
            sampling=Tolerance(mm=(0.4 if on_grid else _FRACTION) * tolerance_mm),
        )
        if on_grid:
            lines = _lines(region, height, block, tolerance_mm)
            if texturing.sunk:
                whole -= _on_grid(region, height, lines, _OVERLAP_MM)
            else:
                whole += _on_grid(region, height, lines, -_OVERLAP_MM)
            continue
        mesh, _ = mesh_block(block)
        s, t, z = mesh.vertices.T
        texture = manifold_of(region.frame.point(s, t, z - block.height_mm + high), mesh.faces)
        if texturing.sunk:
            whole -= _prism(region, low - _BLOCK_BASE_MM / 2.0, _OVERLAP_MM, tolerance_mm) - texture
        else:
            whole += texture ^ _prism(region, -_OVERLAP_MM, high + 1.0, tolerance_mm)
    result = whole.simplify(_SIMPLIFY_MM).to_mesh64()
    points = np.asarray(result.vert_properties, dtype=np.float64)[:, :3]
    return points, np.asarray(result.tri_verts, dtype=np.int32)


def _lines(region: Region, height: Height, block: Block, tolerance_mm: float) -> tuple[Floats, Floats]:
    """Return the lines of a grid along s and t: those of a block, with more for the fade and around a cylinder."""
    top = textured_top(block)
    assert isinstance(top, Top)
    result = []
    for axis, lines in enumerate((top.x, top.y)):
        size, steps = region.size_mm[axis], np.full(len(lines) - 1, math.inf)
        own = lines * (size / lines[-1])
        radius, fade = region.frame.radius_mm, height.fade
        if axis == 0 and radius is not None:
            steps[:] = math.sqrt(2.0 * radius * tolerance_mm)
        if fade.length_mm and fade.sides is not None and fade.sides[axis]:
            own = np.unique(np.concatenate([own, [fade.length_mm, size - fade.length_mm]]))
            middles = (own[:-1] + own[1:]) / 2.0
            low, high = height.range_mm
            fine = fade.length_mm * math.sqrt(0.3 * tolerance_mm / (high - low))
            in_fade = np.minimum(middles, size - middles) < fade.length_mm
            steps = np.minimum(np.where(in_fade, fine, math.inf), steps.min())
        counts = np.maximum(1, np.ceil(np.diff(own) / steps)).astype(int)
        parts = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(own[:-1], own[1:], counts, strict=True)]
        result.append(np.append(np.concatenate(parts), size))
    return result[0], result[1]


def _on_grid(region: Region, height: Height, lines: tuple[Floats, Floats], other_mm: float) -> manifold3d.Manifold:
    """Return the solid between a texture on a grid of lines and a constant height."""
    s, t = lines
    heights = height.grid(s, t)
    if region.is_closed:
        s, heights = s[:-1], heights[:-1]
    n, m = heights.shape
    levels = (heights, np.full((n, m), other_mm))
    points = np.concatenate([region.frame.point(s[:, None], t[None, :], level).reshape(-1, 3) for level in levels])
    ring = np.arange(n if region.is_closed else n - 1)
    a = np.add.outer(ring * m, np.arange(m - 1)).ravel()
    b = (a + m) % (n * m)
    quads = [np.stack([a, b, b + 1, a + 1], axis=1)]
    quads.append(quads[0][:, ::-1] + n * m)
    sides = [(ring * m, (ring + 1) % n * m), ((ring + 1) % n * m + m - 1, ring * m + m - 1)]
    if not region.is_closed:
        row = np.arange(m - 1)
        sides += [(row + 1, row), ((n - 1) * m + row, (n - 1) * m + row + 1)]
    quads += [np.stack([start + n * m, end + n * m, end, start], axis=1) for start, end in sides]
    all_quads = np.concatenate(quads)
    if other_mm > 0.0:  # the texture is the lower side
        all_quads = all_quads[:, ::-1]
    return manifold_of(points, np.concatenate([all_quads[:, [0, 1, 2]], all_quads[:, [0, 2, 3]]]))


def _prism(region: Region, low_mm: float, high_mm: float, tolerance_mm: float) -> manifold3d.Manifold:
    """Return the space above a region between two heights."""
    import manifold3d

    loops = [np.concatenate([_chords(edge, _FRACTION * tolerance_mm)[:-1] for edge in loop]) for loop in region.loops]
    outline = manifold3d.CrossSection(loops, manifold3d.FillRule.EvenOdd)
    frame, place = region.frame, np.zeros((3, 4))
    place[:, :3], place[:, 3] = frame.axes.T, frame.origin + low_mm * frame.axes[2]
    return outline.extrude(high_mm - low_mm).transform(place)


def _chords(edge: OutlineEdge, tolerance_mm: float) -> Floats:
    """Return points along an edge of the outline whose chords are within a tolerance of the edge."""
    count = 1 if edge.kind == "line" else 8
    while True:
        at = np.linspace(edge.first, edge.last, 2 * count + 1)
        points = edge.at(at)
        off = float(np.linalg.norm((points[:-2:2] + points[2::2]) / 2.0 - points[1::2], axis=1).max())
        if edge.kind == "line" or off <= tolerance_mm:
            chosen = points[::2]
            return chosen if edge.forward else chosen[::-1]
        count = math.ceil(count * math.sqrt(off / tolerance_mm)) + 1
