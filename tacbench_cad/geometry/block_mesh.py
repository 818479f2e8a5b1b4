"""The mesh of a block: its textured top, closed by walls and an underside, and cut along its outline.

The mesh of the rectangle is cut by manifold3d: a key by a wedge, another outline by an upright prism with chords
instead of circles, and a label by its pockets. A cut changes neither the vertices nor the planes of the triangles
inside, so the proof of the top holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.adaptive import NetTop
from tacbench_cad.geometry.meshing.certify_triangles import prove
from tacbench_cad.geometry.meshing.closing import close
from tacbench_cad.geometry.meshing.heights import Heights
from tacbench_cad.geometry.meshing.top import Top, single, textured_top
from tacbench_cad.geometry.meshing.top_volume import deviation_mm3, profiles_mm3
from tacbench_cad.geometry.relief import upward
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.spec.outlines import Corners, Polygons, key_wedge, without_key
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats, Indices

#: The fractions of the tolerance that are tried for the top, if the height limit moves vertices too far.
_FRACTIONS = (1.0, 0.6, 0.35, 0.2)
#: How far the tools of the cuts extend beyond the block, in mm.
_BEYOND_MM = 1.0


@dataclass(frozen=True, eq=False)
class BlockMesh:
    """The mesh of a block.

    Args:
        mesh: The closed mesh.
        certificate: The proved bounds, including the distance of the chords from the circles of the outline.
        volume_mm3: The volume, computed without the walls and the cut triangles of a separable top.
        volume_slack_mm3: How far the volume of the mesh can be off because of rounding.
    """

    mesh: Mesh
    certificate: Certificate
    volume_mm3: float
    volume_slack_mm3: float


def mesh_block(block: Block) -> tuple[Mesh, Certificate]:
    """Make a closed mesh of a block, and prove how far its top lies from the formula.

    Args:
        block: The block. Its ``sampling`` decides how the top follows the formula.

    Returns:
        The mesh and the proved bounds. The z of the highest vertex is exactly the block's height, rounded to float32.

    Raises:
        InputError: The mesh would have more triangles than :data:`~tacbench_cad.geometry.mesh.MAX_TRIANGLES`, or the
            tolerance is too fine for single precision.
    """
    made = full_mesh(block)
    return made.mesh, made.certificate


def full_mesh(block: Block) -> BlockMesh:
    """Make the mesh of a block, with its volume in closed form.

    Raises:
        InputError: See :func:`mesh_block`.
        CheckFailedError: The distance of a triangle could not be proved.
    """
    if block.region is None or not isinstance(block.sampling, Tolerance):
        return _cut(block, textured_top(block))
    spare = 3.0 * 2.0**-23 * max(*block.size_mm, block.height_mm)  # for the rounding of manifold3d
    for fraction in _FRACTIONS:
        tolerance = max(fraction * block.sampling.mm - spare, 0.5 * fraction * block.sampling.mm)
        result = _cut(block, textured_top(replace(block, sampling=Tolerance(mm=tolerance))))
        if result.certificate.distance_mm <= block.sampling.mm:
            return result
    raise CheckFailedError("the distance of the top from the formula could not be proved")


def chords_of(block: Block) -> Polygons:
    """Return the polygons for the outline of a block. The distance of the chords is within the mesh's tolerance."""
    if block.outline is None:
        x, y = single(np.array(block.size_mm)).tolist()
        if block.key_mm is not None:
            return without_key((x, y), block.key_mm)
        return Polygons((Corners(((0.0, 0.0), (x, 0.0), (x, y), (0.0, y))),))
    assert isinstance(block.sampling, Tolerance)
    # One of the chords ends at the highest point of the block, if that lies on a circle.
    x, y = block.extremes.at_high
    return block.outline.chords(block.sampling.mm, (x, y))


def _cut(block: Block, top: Top | NetTop) -> BlockMesh:
    """Close a top with walls and an underside, and cut it along the outline of a block."""
    chords, mesh = chords_of(block), close(top.sheet)
    bounds = np.array([top.certificate.distance_mm, top.certificate.vertical_mm])
    if block.region is not None or block.engraving is not None:
        body = _tools_applied(block, chords, mesh.as_manifold(), float(mesh.vertices[:, 2].max()))
        result = body.to_mesh()
        vertices = np.asarray(result.vert_properties, dtype=np.float64)[:, :3] + 0.0
        mesh = Mesh(vertices, np.asarray(result.tri_verts).astype(np.int32))
    upper = mesh.faces[upward(mesh, mesh.doubled_normals)]
    if block.region is not None:
        rounding = 2.0 * float(body.get_tolerance())
        mesh.vertices[np.abs(mesh.vertices) < rounding] = 0.0
        moved = _crowned(mesh.vertices, float(np.float32(block.height_mm)), block.extremes.at_high)
        changed = upper[np.isin(upper, moved).any(axis=1)]
        if len(changed):
            bounds = np.maximum(bounds, _proved(block, mesh.vertices, changed))
        steepest = block.surface.bound(1, 0) + block.surface.bound(0, 1)
        bounds = bounds + rounding * np.array([1.0, 1.0 + steepest])
    certificate = Certificate(distance_mm=float(bounds[0]), vertical_mm=float(bounds[1]), outline_mm=chords.distance_mm)
    own = certificate.plus(block.surface.error, block.surface.evidence)
    return BlockMesh(mesh, own, *_volume(block, top, chords, mesh.vertices, upper))


def _tools_applied(block: Block, chords: Polygons, body: Any, high_mm: float) -> Any:
    """Cut the outline and the label of a block out of the body of its rectangle."""
    from manifold3d import CrossSection, FillRule, Manifold

    def prism(outline: Any, up_mm: float) -> Any:
        return Manifold.extrude(outline, up_mm + _BEYOND_MM).translate((0.0, 0.0, -_BEYOND_MM))

    if block.outline is not None:
        # All polygons are counter-clockwise, so every second one around a point is a hole.
        outline = CrossSection([single(loop.array) for loop in chords.loops], FillRule.EvenOdd)
        body ^= prism(outline, high_mm + _BEYOND_MM)
    elif block.key_mm is not None:
        wedge = key_wedge(float(single(np.array(block.size_mm[0]))), block.key_mm, _BEYOND_MM)
        body -= prism(CrossSection([wedge.array]), high_mm + _BEYOND_MM)
    if block.engraving is not None:
        pockets = CrossSection(list(block.engraving.contours), FillRule.NonZero)
        body -= prism(pockets, float(np.float32(LABEL_DEPTH_MM)))
    return body


def _crowned(vertices: Floats, height: float, at: tuple[float, ...]) -> Indices:
    """Limit the vertices to a height, and set the highest one to it. Return the vertices that this moves.

    Of several vertices at the height, none has to move.
    """
    z = vertices[:, 2]
    moved = np.flatnonzero(z > height)
    z[moved] = height
    if z.max() < height:
        near = z >= z.max() - 1e-4 * height
        away = np.where(near, np.hypot(vertices[:, 0] - at[0], vertices[:, 1] - at[1]), np.inf)
        highest = int(np.argmin(away))
        z[highest] = height
        moved = np.append(moved, highest)
    return moved.astype(np.int32)


def _proved(block: Block, vertices: Floats, faces: Indices) -> Floats:
    """Return the largest proved bounds of some triangles: the distance from the formula, and the vertical distance."""
    limit = block.sampling.mm if isinstance(block.sampling, Tolerance) else np.inf
    sides = (float(np.float32(block.size_mm[0])), float(np.float32(block.size_mm[1])))
    bounds = Heights(block.surface, sides, min(limit, 1.0)).bounds
    points = vertices[faces]
    points[:, :, 2] -= block.datum_mm
    return np.asarray(prove(block.surface, bounds, points, limit).max(axis=1))


def _volume(block: Block, top: Top | NetTop, chords: Polygons, vertices: Floats, upper: Indices) -> tuple[float, float]:
    """Return the volume, and how much rounding to float32 can change it."""
    heights, places = (float(np.spacing(np.float32(side))) for side in (block.height_mm, max(block.size_mm)))
    around = sum(float(np.linalg.norm(np.diff(loop.array, axis=0), axis=1).sum()) for loop in chords.loops)
    slack = heights * chords.area_mm2 + 1e-12 * chords.area_mm2 * block.height_mm
    if block.region is not None:
        slack += places * around * block.height_mm
    if isinstance(top, Top) and top.profiles is not None:
        volume = profiles_mm3(block.datum_mm, top, top.profiles, chords)
    else:
        deviation, error = deviation_mm3(block, vertices, upper)
        volume = block.datum_mm * chords.area_mm2 + chords.integral(block.surface) + deviation
        slack += error
    if block.engraving is not None:
        volume, slack = volume - block.engraving.volume_mm3, slack + 1e-7 * block.engraving.area_mm2
    return volume, slack
