"""A texture on a flat or cylindrical region of a mesh, joined by manifold3d."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from tacbench_cad.extensions.foreign_meshes.mesh_region import MeshRegion, region_at, require_closed, require_unit
from tacbench_cad.geometry import (
    FLOOR_MM,
    Area,
    Fade,
    Frame,
    Mesh,
    Texturing,
    added_volume_mm3,
    around,
    body_between,
    height_over,
    require_fade,
    texture_body,
)
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.text import at_most
from tacbench_cad.util.types import Bools, Floats

#: How far the body of a texture reaches into the part, or a sunk texture's body out of it, in mm.
OVERLAP_MM = 0.01
#: How far rounding moves a vertex at most, in steps of float32.
_ROUNDING_STEPS = 6.0
#: The largest distance between the inset of an outline and its polygon, in mm.
OUTLINE_MM = 0.001
#: Parts of a region inside of the margin that are smaller than this get no texture, in mm^2.
MIN_AREA_MM2 = 0.01
#: The angle between the lines of a body that only tests for room.
_ROOM_DEG = 0.5
#: The sine of the smallest angle of a convex corner of an outline.
_CORNER = 0.2
#: The step of the points along an outline from which distances are searched, as a fraction of the fade.
_STEP = 0.01


@dataclass(frozen=True, eq=False)
class _Segment:
    """A straight edge of an outline, with a parameter from 0 to 1."""

    start: Floats
    end: Floats
    kind = "line"
    first, last, forward = 0.0, 1.0, True

    @property
    def samples(self) -> Floats:
        return np.stack([self.start, self.end])

    def at(self, parameters: Floats, /) -> Floats:
        return np.asarray(self.start + np.multiply.outer(parameters, self.end - self.start))


@dataclass(frozen=True, eq=False)
class _Field(Area):
    """An area of a mesh: a connected part of a region inside of its margin."""

    @property
    def area_mm2(self) -> float:
        """The area, in mm^2."""
        following = [np.roll(points, -1, axis=0) for points in self.polygons]
        return sum(
            float(np.sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])) / 2.0
            for p, q in zip(self.polygons, following, strict=True)
        )

    @property
    def loops(self) -> list[list[_Segment]]:
        return [
            [_Segment(a, b) for a, b in zip(points, np.roll(points, -1, axis=0), strict=True)]
            for points in self.polygons
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
class TexturedMesh:
    """A mesh with a texture on one of its regions.

    Args:
        mesh: The mesh, in the coordinates of the part. It is closed.
        texturing: The settings.
        radius_mm: The radius of a cylindrical region; None for a flat one.
        size_mm: The extents of the textured region along s and t.
        depth_mm: The peak-to-peak height of the texture.
        volume_mm3: The expected volume: that of the part, plus the integral of the formula.
        error_mm: The largest distance of the texture's triangles from the formula.
        evidence: Whether this distance is proved or measured. It is measured with a fade along an outline that is not a
            rectangle, and for a texture whose own error is measured.
        mm_per_unit: The millimetres per unit of u and v. Around a cylinder, u is changed so that the texture closes.
        periods: The number of periods around a closed cylinder; None for other regions.
        bodies: The number of separate surfaces of the mesh, as before.
    """

    mesh: Mesh
    texturing: Texturing
    radius_mm: float | None
    size_mm: tuple[float, float]
    depth_mm: float
    volume_mm3: float
    error_mm: float
    evidence: Literal["proved", "measured"]
    mm_per_unit: tuple[float, float]
    periods: int | None
    bodies: int

    def as_dict(self) -> dict[str, Any]:
        """Return the values without the mesh, as plain JSON values."""
        return {
            "region": "plane" if self.radius_mm is None else "cylinder",
            "radius_mm": self.radius_mm,
            "size_mm": list(self.size_mm),
            "depth_mm": self.depth_mm,
            "texture": self.texturing.texture.name,
            "triangles": len(self.mesh.faces),
            "bodies": self.bodies,
            "volume_mm3": self.mesh.volume_mm3,
            "expected_volume_mm3": self.volume_mm3,
            "error_mm": self.error_mm,
            "evidence": self.evidence,
            "mm_per_unit": list(self.mm_per_unit),
            "periods": self.periods,
        }

    def lines(self) -> list[str]:
        """Return a short description for people."""
        region = "plane" if self.radius_mm is None else f"cylinder of radius {self.radius_mm:.5g} mm"
        volumes = f"volume {self.mesh.volume_mm3:.7g} mm^3, expected {self.volume_mm3:.7g} mm^3"
        return [
            f"{self.texturing.texture.name} on a {region}, {self.size_mm[0]:.4g} x {self.size_mm[1]:.4g} mm, "
            f"{self.depth_mm:.4g} mm high{around(self.texturing, self.mm_per_unit, self.periods)}",
            f"{len(self.mesh.faces):,} triangles, at most {at_most(self.error_mm, 2)} mm from the formula "
            f"({self.evidence})",
            f"closed, {'1 body' if self.bodies == 1 else f'{self.bodies} bodies'}; {volumes}",
        ]


def texture_on_mesh(mesh: Mesh, at: Sequence[float], texturing: Texturing, name: str = "mesh") -> TexturedMesh:
    """Put a texture on the flat or cylindrical region of a mesh around a point.

    Args:
        mesh: A closed mesh in mm.
        at: A point on the region.
        texturing: The settings.
        name: The name of the mesh in error messages.

    Raises:
        InputError: The mesh is not closed or probably not in mm, the region is neither flat nor cylindrical, or a
            setting is not allowed for it.
        CheckFailedError: The result is not closed, or its volume differs from the integral of the formula.
    """
    require_unit(mesh, name)
    part = require_closed(mesh, name)
    region = region_at(mesh, at, texturing.up)
    _require_base(region, texturing)
    result, expected, slack = part, mesh.volume_mm3, 0.0
    rounding = _ROUNDING_STEPS * float(np.spacing(np.float32(np.abs(mesh.vertices).max())))
    tolerance_mm = max(texturing.tolerance_mm - rounding, texturing.tolerance_mm / 2.0)
    errors, proofs, sizes, depths = [], [], [], []
    for field in _fields(region, texturing.margin_mm):
        require_fade(texturing.fade_mm, field.size_mm, field.is_closed)
        height, unit, periods = height_over(field.size_mm, field.is_closed, texturing, _fade(field, texturing.fade_mm))
        _require_room(part, field, texturing, height.depth_mm)
        other_mm = region.facets_mm[1] + OVERLAP_MM if texturing.sunk else region.facets_mm[0] - OVERLAP_MM
        texture = texture_body(field, height, texturing, unit, other_mm, tolerance_mm)
        result = result - texture.body if texturing.sunk else result + texture.body
        expected += added_volume_mm3(field, height) + _below_ideal_mm3(region, field)
        slack += field.area_mm2 * (texture.error_mm + (region.facets_mm[1] if region.frame.radius_mm is None else 0.0))
        errors.append(texture.error_mm + height.own_error_mm)
        proofs += [texture.evidence, height.surface.evidence]
        sizes.append(field.size_mm)
        depths.append(height.depth_mm)
    textured, rounding = _rounded(result)
    bodies = len(part.decompose())
    _require_sound(textured, bodies, expected, slack + rounding * float(result.surface_area()), texturing.sunk)
    return TexturedMesh(
        mesh=textured,
        texturing=texturing,
        radius_mm=region.frame.radius_mm,
        size_mm=max(sizes),
        depth_mm=max(depths),
        volume_mm3=expected,
        error_mm=max(errors) + rounding,
        evidence="proved" if set(proofs) == {"proved"} else "measured",
        mm_per_unit=unit,
        periods=periods,
        bodies=bodies,
    )


def _require_base(region: MeshRegion, texturing: Texturing) -> None:
    """Check that the texture is beyond the facets of a cylinder, which lie inside of the circle."""
    deepest = -region.facets_mm[0] if texturing.sunk else region.facets_mm[1]
    if texturing.base_mm <= deepest:
        raise InputError(
            "base_mm",
            texturing.base_mm,
            f"must be more than {deepest:.3g} mm, the distance of the facets of the mesh from the cylinder; choose a "
            "larger base_mm, or a mesh with finer facets",
        )


def _fields(region: MeshRegion, margin_mm: float) -> list[_Field]:
    """Return the parts of a region inside of its margin."""
    if region.frame.radius_mm is None:
        fields = list(_flat_fields(region, margin_mm))
    else:
        (s0, t0), (s1, t1) = region.loops[0].min(axis=0).tolist(), region.loops[0].max(axis=0).tolist()
        if not region.is_closed:
            s0, s1 = s0 + margin_mm, s1 - margin_mm
        size = (s1 - s0, t1 - t0 - 2.0 * margin_mm)
        frame = region.frame.moved(s0, t0 + margin_mm)
        fields = [_Field(frame, (_rectangle(size),), size, True, region.is_closed)] if min(size) > OUTLINE_MM else []
    if not fields:
        raise InputError("margin_mm", margin_mm, "leaves nothing of the region; choose a smaller margin")
    return fields


def _flat_fields(region: MeshRegion, margin_mm: float) -> Iterator[_Field]:
    import manifold3d

    segments = 4 * math.ceil(math.pi / math.sqrt(8.0 * OUTLINE_MM / margin_mm))
    outline = manifold3d.CrossSection([np.ascontiguousarray(loop) for loop in region.loops])
    inset = outline.offset(-margin_mm, manifold3d.JoinType.Round, 2.0, segments).simplify(OUTLINE_MM / 4.0)
    for part in [] if inset.is_empty() else inset.decompose():
        polygons = [np.array(points, dtype=np.float64) for points in part.to_polygons()]
        low, high = np.concatenate(polygons).min(axis=0), np.concatenate(polygons).max(axis=0)
        size = (float(high[0] - low[0]), float(high[1] - low[1]))
        if part.area() < MIN_AREA_MM2 or min(size) < OUTLINE_MM:
            continue
        frame = region.frame.moved(*low.tolist())
        is_rectangle = len(polygons) == 1 and size[0] * size[1] - part.area() < OUTLINE_MM * sum(size)
        moved = (_rectangle(size),) if is_rectangle else tuple(points - low for points in polygons)
        yield _Field(frame, moved, size, is_rectangle, False)


def _rectangle(size: tuple[float, float]) -> Floats:
    return np.array([[0.0, 0.0], [size[0], 0.0], [size[0], size[1]], [0.0, size[1]]])


def _fade(field: _Field, length_mm: float) -> Fade:
    if not length_mm:
        return Fade(length_mm=0.0)
    if field.is_rectangle:
        return Fade(length_mm=length_mm, sides=(not field.is_closed, True))
    chains = _chains(field, length_mm)
    return Fade(
        length_mm=length_mm,
        distances=lambda points: [chain(points) for chain in chains],
        inside=partial(_inside, field),
    )


def _chains(field: _Field, length_mm: float) -> list[Callable[[Floats], Floats]]:
    """Return functions for the distances from each part of the outline between two convex corners.

    A distance is exact up to ``length_mm``. Larger distances are infinite.
    """
    result: list[Callable[[Floats], Floats]] = []
    for polygon in field.polygons:
        ways = np.roll(polygon, -1, axis=0) - polygon
        before = np.roll(ways, 1, axis=0)
        turn = before[:, 0] * ways[:, 1] - before[:, 1] * ways[:, 0]
        corners = np.flatnonzero(turn > _CORNER * np.hypot(*before.T) * np.hypot(*ways.T)).tolist() or [0]
        closed = np.concatenate([polygon, polygon, polygon[:1]])
        for first, last in zip(corners, [*corners[1:], corners[0] + len(polygon)], strict=True):
            result.append(partial(_distance, *_dense(closed[first : last + 1], length_mm), length_mm))
    return result


def _dense(line: Floats, length_mm: float) -> tuple[Any, Floats, Floats]:
    """Return a search tree of points along a line, and the start and the direction of the piece behind each point."""
    from scipy.spatial import cKDTree

    step = length_mm * _STEP
    ways = np.diff(line, axis=0)
    counts = np.maximum(1, np.ceil(np.hypot(*ways.T) / step)).astype(int)
    which = np.repeat(np.arange(len(counts)), counts)
    fraction = np.concatenate([(np.arange(count) + 0.5) / count for count in counts.tolist()])
    pieces = ways[which] / counts[which, None]
    middles = line[which] + fraction[:, None] * ways[which]
    return cKDTree(middles), middles, pieces


def _distance(tree: Any, middles: Floats, pieces: Floats, far_mm: float, points: Floats) -> Floats:
    """Return the distances of points, shape (n, 2), from a line."""
    _, near = tree.query(points, distance_upper_bound=far_mm * (1.0 + _STEP))
    result = np.full(len(points), np.inf)
    for offset in (-1, 0, 1):
        k = np.clip(near + offset, 0, len(middles) - 1)
        known = near < len(middles)
        k, away = k[known], points[known] - middles[k[known]]
        along = np.einsum("ij,ij->i", away, pieces[k]) / np.einsum("ij,ij->i", pieces[k], pieces[k])
        rest = away - np.clip(along, -0.5, 0.5)[:, None] * pieces[k]
        result[known] = np.minimum(result[known], np.hypot(*rest.T))
    return result


def _inside(field: _Field, s: Floats, t: Floats) -> Bools:
    """Return which points of a grid are inside of the outline, shape (n, m)."""
    result = np.zeros((len(s), len(t)), dtype=np.bool_)
    for polygon in field.polygons:
        for (s0, t0), (s1, t1) in zip(polygon.tolist(), np.roll(polygon, -1, axis=0).tolist(), strict=True):
            first, last = np.searchsorted(t, (min(t0, t1), max(t0, t1))).tolist()
            if last > first:
                crossing = s0 + (t[first:last] - t0) / (t1 - t0) * (s1 - s0)
                result[:, first:last] ^= s[:, None] > crossing
    return result


def _space(field: _Field, low_mm: float, high_mm: float) -> Any:
    """Return the space above a field between two heights."""
    frame = field.frame
    if frame.radius_mm is None:
        return field.placed(field.prism(low_mm, high_mm))
    count = math.ceil(math.degrees(field.size_mm[0] / frame.radius_mm) / _ROOM_DEG)
    s, t = np.linspace(0.0, field.size_mm[0], max(3, count) + 1), np.array([0.0, field.size_mm[1]])
    return body_between(frame, s, t, np.full((1, 1), low_mm), np.full((1, 1), high_mm), field.is_closed)


def _require_room(part: Any, field: _Field, texturing: Texturing, depth_mm: float) -> None:
    """Check that a raised texture does not touch other faces of the part, or that a sunk texture lies in material."""
    reach, radius = texturing.base_mm + depth_mm, field.frame.radius_mm
    inwards = reach + FLOOR_MM if texturing.sunk else -reach
    if radius is not None and field.frame.side * inwards >= radius:
        raise InputError("depth_mm", depth_mm, f"is too much for a cylinder of radius {radius:.4g} mm")
    base = texturing.base_mm
    space = _space(field, -reach - FLOOR_MM, -base) if texturing.sunk else _space(field, base, reach)
    common, whole = float((space ^ part).volume()), float(space.volume())
    if texturing.sunk and common < (1.0 - 1e-4) * whole:
        raise InputError(
            "depth_mm",
            depth_mm,
            f"leaves less than {FLOOR_MM:g} mm of material below the texture; choose a smaller depth_mm or a larger "
            "margin_mm",
        )
    if not texturing.sunk and common > 1e-6 * whole:
        raise InputError(
            "depth_mm",
            depth_mm,
            "makes the texture touch another face of the part; choose a larger margin_mm",
        )


def _below_ideal_mm3(region: MeshRegion, field: _Field) -> float:
    """Return the volume between the facets of the mesh and the cylinder; 0 for a plane.

    The volume from the axis to a triangle is the integral of ``x n / 2`` over the triangle, where x is the distance
    vector from the axis. The integrand is linear, so it is exact at the centroid.
    """
    frame = field.frame
    if frame.radius_mm is None:
        return 0.0
    width, length = field.size_mm
    total = 0.0
    for polygon in (region.points - frame.origin) @ frame.axes.T:
        total += _from_axis(_within(polygon, frame, width, length, field.is_closed), frame.side)
    return frame.side * (frame.radius_mm / 2.0 * width * length - total)


def _within(polygon: Floats, frame: Frame, width: float, length: float, is_closed: bool) -> Floats:
    """Return the part of a polygon on a cylinder with s from 0 to a width and t from 0 to a length."""
    polygon = _kept(polygon, polygon[:, 2])
    polygon = _kept(polygon, length - polygon[:, 2])
    if is_closed:
        return polygon
    for s, sign in ((0.0, 1.0), (width, -1.0)):
        angle = frame.side * s / (frame.radius_mm or 1.0)
        along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
        if len(polygon) and float(polygon[:, :2].mean(axis=0) @ along) > 0.0:
            polygon = _kept(polygon, sign * frame.side * (polygon[:, :2] @ across))
    return polygon


def _kept(polygon: Floats, values: Floats) -> Floats:
    """Return the part of a convex polygon where a linear function, given at its corners, is not negative."""
    if len(polygon) == 0 or values.min() >= 0.0:
        return polygon
    corners = []
    for a, b, p, q in zip(values, np.roll(values, -1), polygon, np.roll(polygon, -1, axis=0), strict=True):
        if a >= 0.0:
            corners.append(p)
        if (a < 0.0) != (b < 0.0):
            corners.append(p + a / (a - b) * (q - p))
    return np.array(corners).reshape(-1, 3)


def _from_axis(polygon: Floats, side: float) -> float:
    total = 0.0
    for k in range(1, len(polygon) - 1):
        a, b, c = polygon[0], polygon[k], polygon[k + 1]
        total += float(np.cross(b - a, c - a)[:2] @ (a + b + c)[:2]) / 12.0
    return side * total


def _rounded(body: Any) -> tuple[Mesh, float]:
    """Return a body as a mesh of float32 values, and the largest distance by which a vertex was moved."""
    from tacbench_cad.geometry import single

    raw = body.to_mesh64()
    exact = np.asarray(raw.vert_properties)[:, :3]
    step = float(np.spacing(np.float32(np.abs(exact).max())))
    raw = body.simplify(4.0 * step).to_mesh64()
    exact = np.asarray(raw.vert_properties)[:, :3]
    vertices, index = np.unique(single(exact) + 0.0, axis=0, return_inverse=True)
    faces = np.asarray(index).ravel()[np.asarray(raw.tri_verts, dtype=np.int64)].astype(np.int32)
    a, b, c = faces.T
    return Mesh(vertices, faces[(a != b) & (b != c) & (c != a)]), _ROUNDING_STEPS * step


def _require_sound(mesh: Mesh, bodies: int, volume_mm3: float, slack_mm3: float, sunk: bool) -> None:
    """Check that a textured mesh is closed, has as many bodies as before, and has the expected volume."""
    try:
        result = require_closed(mesh, "textured mesh")
    except InputError as error:
        raise CheckFailedError(f"{error}; choose another margin_mm or point") from None
    if (count := len(result.decompose())) != bodies:
        raise CheckFailedError(f"the textured mesh has {count} bodies instead of {bodies}; choose another margin_mm")
    if abs(mesh.volume_mm3 - volume_mm3) > slack_mm3 + 1e-9 * volume_mm3:
        raise CheckFailedError(
            f"the textured mesh has a volume of {mesh.volume_mm3:.6g} mm^3 instead of {volume_mm3:.6g} mm^3, because "
            f"the texture {'leaves the part' if sunk else 'touches another face'}; choose another margin_mm"
        )
