"""The mesh of a block whose outline is not a rectangle.

The mesh of the rectangle around the outline is cut by manifold3d with an upright prism. Chords replace the circles of
the outline. The cut changes neither the vertices nor the planes of the triangles inside, so the proof of the top holds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.meshing.adaptive import NetTop
from tacbench_cad.geometry.meshing.certify_triangles import prove
from tacbench_cad.geometry.meshing.clip import sheet
from tacbench_cad.geometry.meshing.closing import close
from tacbench_cad.geometry.meshing.heights import Heights
from tacbench_cad.geometry.meshing.top import Top, single, textured_top
from tacbench_cad.geometry.meshing.top_volume import deviation_mm3, profiles_mm3
from tacbench_cad.geometry.relief import upward
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.spec.outlines import Polygons
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.errors import CheckFailedError
from tacbench_cad.util.types import Floats, Indices

#: The fractions of the tolerance that are tried for the top, if the height limit moves vertices too far.
_FRACTIONS = (1.0, 0.6, 0.35, 0.2)


@dataclass(frozen=True, eq=False)
class OutlinedMesh:
    """The mesh of a block with an outline.

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


def chords_of(block: Block) -> Polygons:
    """Return the polygons for the outline of a block. The distance of the chords is within the mesh's tolerance."""
    assert block.outline is not None and isinstance(block.sampling, Tolerance)
    # One of the chords ends at the highest point of the block, if that lies on a circle.
    x, y = block.extremes.at_high
    return block.outline.chords(block.sampling.mm, (x, y))


def outlined_mesh(block: Block) -> OutlinedMesh:
    """Make the mesh of a block with an outline within its tolerance.

    Raises:
        InputError: Same as for :func:`tacbench_cad.geometry.block_mesh.mesh_block`.
        CheckFailedError: The distance of a triangle could not be proved.
    """
    assert isinstance(block.sampling, Tolerance)
    chords = chords_of(block)
    spare = 3.0 * 2.0**-23 * max(*block.size_mm, block.height_mm)  # for the rounding of manifold3d
    for fraction in _FRACTIONS:
        tolerance = max(fraction * block.sampling.mm - spare, 0.5 * fraction * block.sampling.mm)
        top = textured_top(replace(block, sampling=Tolerance(mm=tolerance)))
        result = _cut(block, top, chords)
        if result.certificate.distance_mm + block.surface.error <= block.sampling.mm:
            return result
    raise CheckFailedError("the distance of the top from the formula could not be proved")


def _cut(block: Block, top: Top | NetTop, chords: Polygons) -> OutlinedMesh:
    from manifold3d import CrossSection, FillRule, Manifold

    height = float(np.float32(block.height_mm))
    opened = top.sheet if isinstance(top, NetTop) else sheet(top, None, height)
    # All polygons are counter-clockwise, so every second one around a point is a hole.
    outline = CrossSection([single(loop.array) for loop in chords.loops], FillRule.EvenOdd)
    most = float(opened.vertices[:, 2].max()) + 1.0
    body = close(opened, None).as_manifold() ^ Manifold.extrude(outline, most + 1.0).translate((0.0, 0.0, -1.0))
    if block.engraving is not None:
        pockets = CrossSection(list(block.engraving.contours), FillRule.NonZero)
        deep = float(np.float32(LABEL_DEPTH_MM))
        body -= Manifold.extrude(pockets, deep + 1.0).translate((0.0, 0.0, -1.0))
    result = body.to_mesh()
    vertices = np.asarray(result.vert_properties, dtype=np.float64)[:, :3] + 0.0
    faces = np.asarray(result.tri_verts).astype(np.int32)
    rounding = 2.0 * float(body.get_tolerance())
    vertices[np.abs(vertices) < rounding] = 0.0
    moved = _crowned(vertices, height, block.extremes.at_high)
    mesh = Mesh(vertices, faces)
    upper = faces[upward(mesh, mesh.doubled_normals)]
    steepest = block.surface.bound(1, 0) + block.surface.bound(0, 1)
    bounds = np.array([top.certificate.distance_mm, top.certificate.vertical_mm])
    changed = upper[np.isin(upper, moved).any(axis=1)]
    if len(changed):
        bounds = np.maximum(bounds, _proved(block, vertices, changed))
    certificate = Certificate(
        distance_mm=float(bounds[0]) + rounding,
        vertical_mm=float(bounds[1]) + rounding * (1.0 + steepest),
        outline_mm=chords.distance_mm,
    )
    volume, slack = _volume(block, top, chords, vertices, upper)
    return OutlinedMesh(mesh, certificate, volume, slack)


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
    assert isinstance(block.sampling, Tolerance)
    sides = (float(np.float32(block.size_mm[0])), float(np.float32(block.size_mm[1])))
    bounds = Heights(block.surface, sides, block.sampling.mm).bounds
    points = vertices[faces]
    points[:, :, 2] -= block.datum_mm
    return np.asarray(prove(block.surface, bounds, points, block.sampling.mm).max(axis=1))


def _volume(block: Block, top: Top | NetTop, chords: Polygons, vertices: Floats, upper: Indices) -> tuple[float, float]:
    """Return the volume without the label's pockets, and how much rounding can change it."""
    engraving = block.engraving
    spacing = float(np.spacing(np.float32(max(*block.size_mm, block.height_mm))))
    around = sum(float(np.linalg.norm(np.diff(loop.array, axis=0), axis=1).sum()) for loop in chords.loops)
    slack = 2.0 * spacing * (chords.area_mm2 + around * block.height_mm)
    if engraving is not None:
        slack += 1e-7 * engraving.area_mm2
    if isinstance(top, Top):
        assert top.profiles is not None
        volume = profiles_mm3(block.datum_mm, top, top.profiles, chords)
    else:
        deviation, error = deviation_mm3(block, vertices, upper)
        volume = block.datum_mm * chords.area_mm2 + chords.integral(block.surface) + deviation
        slack += error
    return volume - (engraving.volume_mm3 if engraving else 0.0), slack
