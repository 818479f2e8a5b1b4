"""The flat or cylindrical region of a mesh around a point, and its outline in local coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from tacbench_cad.geometry import Frame, Mesh, axes_of, cross, manifold_of, open_edges
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats, Indices, Ints

#: The largest distance of a vertex of a region from its plane or cylinder, in mm.
FLAT_MM = 0.005
#: The largest angle between the normal of a triangle and that of its plane or cylinder (without the facet's own half).
FLAT_DEG = 0.5
#: The largest angle between neighbouring facets of a cylinder: 18 facets for each turn.
FACET_DEG = 20.0
#: The smallest number of facets of a cylindrical region.
MIN_FACETS = 4
#: The largest distance of the point from the mesh, in mm.
NEAR_MM = 1.0
#: The sizes of a mesh in mm outside of which its unit is probably not the millimetre.
MIN_SIZE_MM, MAX_SIZE_MM = 2.0, 2000.0
#: Flat facets whose neighbours are this many times smaller are a plane next to a rounded edge.
_PLANE_AREA = 4.0
_SMALL = 1e-12
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class MeshRegion:
    """A connected region of a mesh whose triangles lie on one plane or on one cylinder.

    Args:
        frame: The local coordinates of the plane or cylinder.
        outline: The outline in (s, t). On a cylinder, this is a rectangle.
        is_closed: Whether the region goes all the way around a cylinder.
        facets_mm: The lowest and the highest position of the triangles along the normal of the ideal face.
    """

    frame: Frame
    outline: shapely.Polygon
    is_closed: bool
    facets_mm: tuple[float, float]


class Surroundings:
    """The triangles of a mesh, their normals and neighbours.

    Args:
        mesh: A closed mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self.points = mesh.triangle_points
        doubled = mesh.doubled_normals
        lengths = np.linalg.norm(doubled, axis=1)
        self.area = lengths / 2.0
        self.normal = doubled / np.maximum(lengths, _SMALL)[:, None]

    @cached_property
    def neighbours(self) -> Indices:
        """The triangle on the other side of each edge, shape (n, 3). Edge k runs from corner k to corner k + 1."""
        faces = self.mesh.faces.astype(np.int64)
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        count = len(self.mesh.vertices)
        forward, backward = start * count + end, end * count + start
        order = np.argsort(forward)
        place = np.searchsorted(forward[order], backward)
        return np.asarray(order[np.minimum(place, len(order) - 1)] // 3, dtype=np.int32).reshape(-1, 3)

    def grown(self, seed: int, belongs: Bools) -> Bools:
        """Return the triangles that are connected with a triangle through triangles that belong to a region."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        rows = np.repeat(np.arange(len(self.area)), 3)
        columns = self.neighbours.ravel()
        joined = belongs[rows] & belongs[columns]
        links = coo_array(
            (np.ones(joined.sum(), dtype=np.int8), (rows[joined], columns[joined])), shape=(len(belongs),) * 2
        )
        _, label = connected_components(links, directed=False)
        return np.asarray(belongs & (label == label[seed]))

    def nearest(self, at: Floats) -> tuple[int, float]:
        """Return the triangle that is nearest to a point, and its distance."""
        a, b, c = np.moveaxis(self.points, 1, 0)
        normal = self.normal
        height = np.einsum("ij,ij->i", at - a, normal)
        foot = at - height[:, None] * normal
        inside = self.area > _SMALL
        edges = np.full(len(a), np.inf)
        for p, q in ((a, b), (b, c), (c, a)):
            inside &= np.einsum("ij,ij->i", cross(q - p, foot - p), normal) >= -_SMALL
            way = q - p
            along = np.einsum("ij,ij->i", at - p, way) / np.maximum(np.einsum("ij,ij->i", way, way), _SMALL)
            edges = np.minimum(edges, np.linalg.norm(at - p - np.clip(along, 0.0, 1.0)[:, None] * way, axis=1))
        distance = np.where(inside, np.abs(height), edges)
        # At an edge, several triangles are equally near: the one whose plane contains the point is chosen.
        near = np.flatnonzero(distance <= distance.min() + 1e-9)
        best = near[int(np.argmax(self.area[near]))]
        return int(best), float(distance[best])


def closed_body(mesh: Mesh, name: str) -> Any:
    """Return a mesh as a closed body of manifold3d with double precision.

    Raises:
        InputError: The mesh is empty, not closed, or inside out.
    """
    if wrong := open_edges(mesh):
        reason = f"the mesh is not closed: {wrong} edges do not have exactly two triangles; repair the mesh first"
        raise InputError(name, None, reason)
    body = manifold_of(mesh.vertices, mesh.faces)
    if body.status().name != "NoError":
        raise InputError(name, None, f"manifold3d refuses the mesh ({body.status().name}); repair the mesh first")
    if mesh.volume_mm3 <= 0.0:
        raise InputError(name, None, "the triangles of the mesh face inwards; turn them around first")
    return body


def require_unit(mesh: Mesh, name: str) -> None:
    """Check that a mesh has a size that a printed part in millimetres can have.

    Raises:
        InputError: The size suggests another unit.
    """
    low, high = mesh.bounds_mm
    longest = float((high - low).max())
    if MIN_SIZE_MM <= longest <= MAX_SIZE_MM:
        return
    raise InputError(
        name,
        None,
        f"the longest side is {longest:.4g} mm, so the unit is probably not the millimetre; give the millimetres per "
        "unit as scale: 10 for centimetres, 25.4 for inches, 1000 for metres",
    )


def region_at(
    mesh: Mesh,
    at: Sequence[float],
    up: str | tuple[float, float, float] | None,
) -> MeshRegion:
    """Find the flat or cylindrical region of a mesh around a point.

    Args:
        mesh: A closed mesh.
        at: The point, at most :data:`NEAR_MM` from the mesh.
        up: The direction of s on a plane, or of s = 0 on a cylinder.

    Raises:
        InputError: The point is too far from the mesh, or the region is neither flat nor cylindrical.
    """
    around = Surroundings(mesh)
    point = np.array(at, dtype=np.float64)
    if point.shape != (3,) or not np.all(np.isfinite(point)):
        raise InputError("at", tuple(at), "must be three finite coordinates in mm")
    seed, distance = around.nearest(point)
    if distance > NEAR_MM:
        place = ", ".join(f"{x:.4g}" for x in around.points[seed].mean(axis=0))
        raise InputError("at", tuple(at), f"is {distance:.4g} mm from the mesh; the nearest triangle is at {place}")
    flat = _flat(around, seed)
    round_ = _round(around, seed, flat)
    if _is_curved(around, flat, flat if round_ is None else round_[0]):
        raise InputError(
            "at", tuple(at), "lies on a region that is curved; only planes and cylinders can get a texture"
        )
    if round_ is not None:
        return _cylindrical(around, *round_, up)
    normal = _mean_normal(around, flat)
    frame = Frame(around.points[seed].mean(axis=0), axes_of(normal, up, "the normal of the region"))
    heights = (around.points[flat] - frame.origin) @ frame.axes[2]
    frame = Frame(frame.origin + (heights.max() + heights.min()) / 2.0 * frame.axes[2], frame.axes)
    half = float(np.ptp(heights)) / 2.0
    sides = frame.local(mesh.vertices[_border_edges(around, flat)])
    return MeshRegion(frame, shapely.build_area(shapely.multilinestrings(sides)), False, (-half, half))


def _mean_normal(around: Surroundings, chosen: Bools) -> Floats:
    total = (around.normal[chosen] * around.area[chosen, None]).sum(axis=0)
    return np.asarray(total / np.linalg.norm(total))


def _flat(around: Surroundings, seed: int) -> Bools:
    """Return the triangles of the plane through a triangle."""
    normal, origin = around.normal[seed], around.points[seed].mean(axis=0)
    chosen = np.zeros(len(around.area), dtype=np.bool_)
    for _ in range(_ROUNDS):
        off = np.abs((around.points - origin) @ normal).max(axis=1)
        straight = around.normal @ normal > math.cos(math.radians(FLAT_DEG))
        # The normal of a sliver is not reliable, but it lies in the plane with all its corners.
        sliver = _thin(around)
        grown = around.grown(seed, (off <= FLAT_MM) & (straight | sliver))
        if np.array_equal(grown, chosen):
            break
        chosen = grown
        normal = _mean_normal(around, chosen)
        heights = (around.points[chosen] - origin) @ normal
        origin = origin + (heights.max() + heights.min()) / 2.0 * normal
    return chosen


def _thin(around: Surroundings) -> Bools:
    """Return the triangles that are too thin for a reliable normal."""
    a, b, c = np.moveaxis(around.points, 1, 0)
    longest = np.max([np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)], axis=0)
    return np.asarray(2.0 * around.area < 2e-3 * longest)


def _border(around: Surroundings, chosen: Bools) -> tuple[Ints, Ints, Floats]:
    """Return the triangles inside and outside of each edge of the border, and the lengths of these edges."""
    rows: Ints = np.flatnonzero(chosen).astype(np.int64)
    other = around.neighbours[rows]
    row, edge = np.nonzero(~chosen[other])
    inner, outer = rows[row], other[row, edge].astype(np.int64)
    points = around.points[inner]
    span = np.arange(len(inner))
    return inner, outer, np.linalg.norm(points[span, (edge + 1) % 3] - points[span, edge], axis=1)


def _smooth(around: Surroundings, inner: Ints, outer: Ints) -> Bools:
    cosine = np.einsum("ij,ij->i", around.normal[inner], around.normal[outer])
    return np.asarray((cosine > math.cos(math.radians(FACET_DEG + FLAT_DEG))) & (around.area[outer] > _SMALL))


def _round(around: Surroundings, seed: int, flat: Bools) -> tuple[Bools, Frame] | None:
    """Return the triangles of the cylinder through a facet, with its axis and radius; None if there is none."""
    inner, outer, length = _border(around, flat)
    smooth = _smooth(around, inner, outer)
    own = _mean_normal(around, flat)
    tried = 0
    for k in np.argsort(-length * smooth):
        if not smooth[k] or tried == _ROUNDS:
            return None
        tried += 1
        axis = np.cross(own, around.normal[outer[k]])
        if np.linalg.norm(axis) < 1e-3:
            continue
        fit = _grown_cylinder(around, seed, flat, int(outer[k]), axis / np.linalg.norm(axis))
        if fit is not None:
            return fit
    return None


def _grown_cylinder(
    around: Surroundings, seed: int, flat: Bools, beside: int, axis: Floats
) -> tuple[Bools, Frame] | None:
    chosen = flat | _flat(around, beside)
    allowed = FLAT_MM
    for _ in range(4 * _ROUNDS):
        centre, radius = _circle(around.points[chosen].reshape(-1, 3), axis)
        if not FLAT_MM < radius < 1e5:
            return None
        away = around.points - centre
        away = away - (away @ axis)[..., None] * axis
        off = np.abs(np.linalg.norm(away, axis=2) - radius).max(axis=1)
        middle = away.mean(axis=1)
        middle /= np.maximum(np.linalg.norm(middle, axis=1), _SMALL)[:, None]
        side = math.copysign(1.0, float(np.einsum("ij,ij->", middle[chosen], around.normal[chosen])))
        tilt = math.sin(math.radians(FLAT_DEG))
        fits = (off <= allowed) & (np.abs(around.normal @ axis) < max(tilt, 4.0 * allowed / radius))
        fits &= side * np.einsum("ij,ij->i", middle, around.normal) > math.cos(math.radians(FACET_DEG))
        if not fits[seed]:
            return None
        grown = around.grown(seed, fits)
        if np.array_equal(grown, chosen):
            break
        chosen = grown
        normals = around.normal[chosen] * np.sqrt(around.area[chosen])[:, None]
        sizes, axes = np.linalg.eigh(normals.T @ normals)
        if sizes[1] > 1e-6 * sizes[2]:
            axis = axes[:, 0]
    else:
        return None
    angles = np.sort(np.arctan2(*(around.normal[chosen & ~_thin(around)] @ axes_of(axis, None, "the axis")[:2].T).T))
    if 1 + np.count_nonzero(np.diff(angles) > math.radians(FLAT_DEG)) < MIN_FACETS:
        return None
    return chosen, Frame(centre, np.vstack([axes_of(axis, None, "the axis")[:2], axis]), radius, side)


def _circle(points: Floats, axis: Floats) -> tuple[Floats, float]:
    """Return a point on the axis and the radius of the cylinder with the smallest squared errors of the radius."""
    across = axes_of(axis, None, "the axis")[:2]
    flat = points @ across.T
    middle = flat.mean(axis=0)
    x, y = (flat - middle).T
    solution = np.linalg.lstsq(np.stack([2.0 * x, 2.0 * y, np.ones_like(x)], axis=1), x * x + y * y, rcond=None)[0]
    radius = math.sqrt(max(float(solution[2] + solution[0] ** 2 + solution[1] ** 2), 0.0))
    centre = (middle + solution[:2]) @ across + axis * float((points @ axis).mean())
    return centre, radius


def _is_curved(around: Surroundings, flat: Bools, region: Bools) -> bool:
    """Return whether a region is only one facet, or one ring of facets, of a curved surface.

    The neighbours of such a region meet it at small angles and have facets of a similar size. A plane or a cylinder
    with rounded edges has much smaller neighbours.

    Args:
        around: The mesh.
        flat: A facet of the region, or the whole region if it is flat.
        region: The region.
    """
    inner, outer, length = _border(around, region)
    smooth = _smooth(around, inner, outer)
    if length[smooth].sum() < 0.5 * length.sum():
        return False
    largest = max(float(around.area[_flat(around, int(k))].sum()) for k in np.unique(outer[smooth])[:8])
    return bool(around.area[flat].sum() <= _PLANE_AREA * largest)


def _border_edges(around: Surroundings, chosen: Bools) -> Indices:
    """Return the vertices at both ends of each edge of the border of a region, shape (n, 2)."""
    faces = around.mesh.faces[chosen]
    row, edge = np.nonzero(~chosen[around.neighbours[chosen]])
    return np.stack([faces[row, edge], faces[row, (edge + 1) % 3]], axis=1)


def _cylindrical(
    around: Surroundings, chosen: Bools, fit: Frame, up: str | tuple[float, float, float] | None
) -> MeshRegion:
    """Describe a cylindrical region. Its outline must be circles around the axis and lines along it."""
    frame = Frame(fit.origin, axes_of(fit.axes[2], up, "the axis of the cylinder"), fit.radius_mm, fit.side)
    radius, around_mm = fit.radius_mm, frame.around_mm
    assert radius is not None and around_mm is not None
    away = (around.points[chosen] - frame.origin) @ frame.axes.T
    planes = np.abs(np.einsum("ij,ij->i", away[:, 0, :2], (around.normal[chosen] @ frame.axes.T)[:, :2]))
    nearest = float(planes[~_thin(around)[chosen]].min()) - radius
    farthest = float(np.hypot(away[..., 0], away[..., 1]).max()) - radius
    low, high = float(away[..., 2].min()), float(away[..., 2].max())
    s, t = np.moveaxis(frame.local(around.mesh.vertices[_border_edges(around, chosen)]), -1, 0)
    on_side = (np.abs(t - low) < FLAT_MM) | (np.abs(t - high) < FLAT_MM)
    closed, start, width = bool(on_side.all() and np.ptp(t, axis=1).max() < FLAT_MM), 0.0, around_mm
    if not closed:  # it begins behind the largest gap between the vertices of its border
        places = np.sort(s, axis=None)
        gaps = np.diff(places, append=places[0] + around_mm)
        start, width = float(places[(int(np.argmax(gaps)) + 1) % len(places)]), around_mm - float(gaps.max())
        place = np.mod(s - start + FLAT_MM, around_mm) - FLAT_MM
        on_side |= (np.abs(place) < FLAT_MM) | (np.abs(place - width) < FLAT_MM)
    if not on_side.all():
        raise InputError(
            "at",
            None,
            "lies on a cylinder with a hole or a slanted rim; only cylinders between circles around the axis and lines "
            "along the axis can get a texture",
        )
    facets = (nearest, farthest) if frame.side > 0.0 else (-farthest, -nearest)
    return MeshRegion(frame.moved(start, 0.0), shapely.box(0.0, low, width, high), closed, facets)
