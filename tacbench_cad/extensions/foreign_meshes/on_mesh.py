"""A texture on a flat or cylindrical region of a mesh, joined by manifold3d."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import shapely.affinity

from tacbench_cad.extensions.foreign_meshes.mesh_region import MeshRegion, closed_body, region_at, require_unit
from tacbench_cad.formats import format_of, read_foreign_mesh, read_stl
from tacbench_cad.geometry import (
    FLOOR_MM,
    Area,
    Certificate,
    ExpectedGeometry,
    FaceRelief,
    Mesh,
    PrintPart,
    Textured,
    Texturing,
    added_volume_mm3,
    height_over,
    require_radius,
    require_room,
    segments_of,
    space_between,
    texture_body,
    welded,
)
from tacbench_cad.util.errors import CheckFailedError, InputError, as_input

#: How far the body of a texture reaches into the part, or a sunk texture's body out of it, in mm.
OVERLAP_MM = 0.01
#: How far rounding moves a vertex at most, in steps of float32.
_ROUNDING_STEPS = 6.0
#: The fraction of the tolerance for a body whose distance from the formula is only measured.
_MEASURED_FRACTION = 0.95
#: The largest distance between the inset of an outline and its polygon, in mm.
OUTLINE_MM = 0.001
#: Parts of a region inside of the margin that are smaller than this get no texture, in mm^2.
MIN_AREA_MM2 = 0.01


def texture_on_mesh(
    part: Any,
    at: Sequence[float],
    texturing: Texturing,
    tolerance_mm: float,
    scale: float,
    names: tuple[str, str, str],
    spec: Mapping[str, Any],
) -> Textured:
    """Put a texture on the flat or cylindrical region of a mesh around a point; see :func:`tacbench_cad.textured`.

    Args:
        part: An STL or 3MF file, a :class:`~tacbench_cad.Mesh`, a ``Manifold`` of manifold3d, or an object with
            ``vertices`` and ``faces``.
        at: A point on the region, in mm.
        texturing: The settings.
        tolerance_mm: The largest distance of the mesh from the formula.
        scale: The millimetres for each unit of the mesh.
        names: The name, the kind and the title of the part.
        spec: The input values of the part.

    Raises:
        InputError: The mesh is not closed or probably not in mm, the region is neither flat nor cylindrical, or a
            setting is not allowed for it.
        CheckFailedError: The result is not closed, or its volume differs from the integral of the formula.
    """
    mesh, name = _mesh_of(part, scale), str(part) if isinstance(part, (str, Path)) else "mesh"
    require_unit(mesh, name)
    whole = result = closed_body(mesh, name)
    region = region_at(mesh, at, texturing.up)
    _require_base(region, texturing)
    sunk, expected, slack = texturing.sunk, mesh.volume_mm3, 0.0
    rounding = _ROUNDING_STEPS * float(np.spacing(np.float32(np.abs(mesh.vertices).max())))
    aim = max(tolerance_mm - rounding, tolerance_mm / 2.0)
    heights, certificates = [], []
    for area in _areas(region, texturing.margin_mm):
        height = height_over(area, texturing)
        require_radius(height)
        reach, base = texturing.base_mm + height.depth_mm, texturing.base_mm
        space = space_between(area, -reach - FLOOR_MM, -base) if sunk else space_between(area, base, reach)
        require_room(height, float((space ^ whole).volume()), float(space.volume()))
        other = region.facets_mm[1] + OVERLAP_MM if sunk else region.facets_mm[0] - OVERLAP_MM
        texture = texture_body(height, other, _MEASURED_FRACTION * aim if height.fading is None else aim)
        result = result - texture.body if sunk else result + texture.body
        expected += added_volume_mm3(height) + _below_ideal_mm3(region, area, whole)
        slack += area.polygon.area * (texture.certificate.distance_mm + region.facets_mm[1])
        heights.append(height)
        certificates.append(texture.certificate)
    step = float(np.spacing(np.float32(np.abs(result.bounding_box()).max())))
    rounding, textured = _ROUNDING_STEPS * step, welded(result.simplify(4.0 * step))
    bodies, slack = len(whole.decompose()), slack + rounding * float(result.surface_area())
    genus = _require_sound(textured, bodies, expected, slack, sunk)
    proved = all(certificate.evidence == "proved" for certificate in certificates)
    # the points of the file's check are denser than those between which a body without a proof was measured
    measured = 0.0 if proved else FaceRelief(heights, tolerance_mm).of_mesh(textured)[0]
    certificate = Certificate(
        distance_mm=max(measured, *(certificate.distance_mm for certificate in certificates)) + rounding,
        vertical_mm=max(measured, *(certificate.vertical_mm for certificate in certificates)) + rounding,
        evidence="proved" if proved else "measured",
    )
    relief = FaceRelief(heights, certificate.distance_mm + rounding)
    geometry = ExpectedGeometry(volume_mm3=expected, volume_slack_mm3=slack + 1e-9 * expected, relief=relief)
    low, high = textured.bounds_mm
    (x, y, z), (low_x, low_y, low_z) = (high - low).tolist(), low.tolist()
    printed = PrintPart(
        name=names[0],
        kind=names[1],
        title=names[2],
        size_mm=(x, y, z),
        genus=genus,
        make_mesh=lambda: (textured, geometry),
        make_solid=None,
        spec=spec,
        no_solid="the part is a mesh, so the name of its file must end in .stl or .3mf",
        low_mm=(low_x, low_y, low_z),
    )
    return Textured(
        printed=printed, heights=tuple(heights), certificate=certificate, volume_mm3=expected, bodies=bodies
    )


def _mesh_of(part: Any, scale: float) -> Mesh:
    """Return the mesh of a file or an object. Files of other programs that break a rule of 3MF are read as well."""
    if isinstance(part, (str, Path)):
        with as_input("file"):
            mesh = read_foreign_mesh(Path(part)) if format_of(Path(part)).name == "3mf" else read_stl(Path(part))
    elif hasattr(part, "to_mesh64"):
        raw = part.to_mesh64()
        mesh = Mesh(np.array(raw.vert_properties)[:, :3], np.array(raw.tri_verts, dtype=np.int32))
    elif hasattr(part, "vertices") and hasattr(part, "faces"):
        mesh = Mesh(np.array(part.vertices, dtype=np.float64), np.array(part.faces, dtype=np.int32))
    else:
        raise InputError(
            "part", part, "must be a CAD part, a STEP, STL or 3MF file, or an object with vertices and faces"
        )
    return Mesh(mesh.vertices * scale, mesh.faces) if scale != 1.0 else mesh


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


def _areas(region: MeshRegion, margin_mm: float) -> list[Area]:
    """Return the areas of a region inside of its margin."""
    areas: list[Area] = []
    if region.frame.radius_mm is None:
        segments = math.ceil(math.pi / math.sqrt(8.0 * OUTLINE_MM / margin_mm))
        inset = region.outline.buffer(-margin_mm, quad_segs=segments).simplify(OUTLINE_MM / 4.0)
        for polygon in shapely.get_parts(inset):
            low_s, low_t, high_s, high_t = polygon.bounds
            size, frame = (high_s - low_s, high_t - low_t), region.frame.moved(low_s, low_t)
            if size[0] * size[1] - polygon.area < OUTLINE_MM * sum(size):
                areas.append(Area.rectangle(frame, size))
            else:
                areas.append(Area(frame, shapely.affinity.translate(polygon, -low_s, -low_t), size))
    else:
        low_s, low_t, high_s, high_t = region.outline.bounds
        inset_s = 0.0 if region.is_closed else margin_mm
        size = (high_s - low_s - 2.0 * inset_s, high_t - low_t - 2.0 * margin_mm)
        areas = [Area.rectangle(region.frame.moved(low_s + inset_s, low_t + margin_mm), size, region.is_closed)]
    areas = [area for area in areas if min(area.size_mm) > OUTLINE_MM and area.polygon.area > MIN_AREA_MM2]
    if not areas:
        raise InputError("margin_mm", margin_mm, "leaves nothing of the region; choose a smaller margin")
    return areas


def _below_ideal_mm3(region: MeshRegion, area: Area, whole: Any) -> float:
    """Return the volume between the facets of the mesh and the cylinder; 0 for a plane.

    The material above a depth is compared with the body between this depth and the cylinder. The chords of this body
    cut a segment off the circle between two lines.
    """
    frame, (width, length) = area.frame, area.size_mm
    if frame.radius_mm is None:
        return 0.0
    depth = region.facets_mm[0] - OVERLAP_MM
    ideal, count = space_between(area, depth, 0.0), segments_of(area)
    step = width / frame.radius_mm / count
    cut_off = count * frame.radius_mm**2 / 2.0 * (step - math.sin(step)) * length
    material = space_between(area, depth, region.facets_mm[1] + OVERLAP_MM) ^ whole
    return float(ideal.volume()) + frame.side * cut_off - float(material.volume())


def _require_sound(mesh: Mesh, bodies: int, volume_mm3: float, slack_mm3: float, sunk: bool) -> int:
    """Check that a textured mesh is closed, has as many bodies as before, and has the expected volume.

    Returns:
        The number of its through holes.
    """
    try:
        result = closed_body(mesh, "textured mesh")
    except InputError as error:
        raise CheckFailedError(f"{error}; choose another margin_mm or point") from None
    if (count := len(result.decompose())) != bodies:
        raise CheckFailedError(f"the textured mesh has {count} bodies instead of {bodies}; choose another margin_mm")
    if abs(mesh.volume_mm3 - volume_mm3) > slack_mm3 + 1e-9 * volume_mm3:
        raise CheckFailedError(
            f"the textured mesh has a volume of {mesh.volume_mm3:.6g} mm^3 instead of {volume_mm3:.6g} mm^3, because "
            f"the texture {'leaves the part' if sunk else 'touches another face'}; choose another margin_mm"
        )
    return int(mesh.as_manifold().genus())
