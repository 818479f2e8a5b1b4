"""A texture on a mesh: the region around a point, the closed result, its volume and its distance from the formula."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import manifold3d
import numpy as np
import pytest
from helpers.cases import mostly_long

from tacbench_cad.extensions.foreign_meshes.mesh_region import MeshRegion, region_at
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.relief import distance
from tacbench_cad.geometry.textured.result import Textured
from tacbench_cad.making.texturing import textured as textured_part
from tacbench_cad.spec.presets import VALUES
from tacbench_cad.spec.texture_files import find_texture as texture_named
from tacbench_cad.util.errors import InputError

Solid = manifold3d.Manifold


def mesh_of(body: Any) -> Mesh:
    raw = body.to_mesh64()
    return Mesh(np.array(raw.vert_properties)[:, :3], np.array(raw.tri_verts, dtype=np.int32))


def drum(radius: float = 15.0, length: float = 20.0, facets: int = 128) -> Any:
    return Solid.cylinder(length, radius, radius, facets)


@cache
def shape(name: str) -> Mesh:
    """Return a mesh that manifold3d makes."""
    plate = Solid.cube((30, 20, 5))
    bodies = {
        "plate": plate,
        "holes": plate - drum(3, 9, 48).translate((8, 8, -1)) - drum(2, 9, 48).translate((20, 12, -1)),
        "turned": plate.rotate((20, 35, 50)).translate((7, -3, 2)),
        "rounded": Solid.cube((30, 20, 5)).minkowski_sum(Solid.sphere(2, 32)),
        "drum": drum(),
        "fine facets": drum().refine(2),
        "half": drum().trim_by_plane((1, 0, 0), 3),
        "tube": drum(facets=64) - drum(10, 40, 64).translate((0, 0, -5)),
        "capsule": drum().translate((0, 0, 15)) + Solid.sphere(15, 128).translate((0, 0, 35)),
        "sphere": Solid.sphere(15, 64),
        "cone": Solid.cylinder(20, 15, 5, 64),
        "ring": Solid.revolve(manifold3d.CrossSection.circle(4, 32).translate((15, 0)), 64),
        "pierced": drum() - drum(2, 40, 32).rotate((0, 90, 0)).translate((0, 0, 10)),
        "hexagon": drum(facets=6),
        "thin": Solid.cube((30, 20, 1)),
        "corner": Solid.cube((30, 20, 5)) + Solid.cube((12, 20, 20)).translate((0, 0, 5.5)) + Solid.cube((1, 20, 7)),
        "small": Solid.cube((0.03, 0.02, 0.005)),
    }
    return mesh_of(bodies[name])


def region(name: str, at: tuple[float, float, float]) -> MeshRegion:
    return region_at(shape(name), at, None)


def textured(
    name: str, at: tuple[float, float, float], number: int = 2, tolerance_mm: float = 0.02, **settings: Any
) -> Textured:
    return textured_part(shape(name), at, number, mesh_tolerance_mm=tolerance_mm, **settings)


@pytest.mark.parametrize(
    ("name", "at", "radius", "side", "extent"),
    [
        ("plate", (15, 10, 5), None, 1.0, (30, 20)),
        ("holes", (15, 10, 5), None, 1.0, (30, 20)),
        ("rounded", (15, 10, 7), None, 1.0, (30, 20)),
        ("hexagon", (0, 0, 20), None, 1.0, (30, 15 * math.sqrt(3))),
        ("drum", (15, 0, 10), 15, 1.0, (30 * math.pi, 20)),
        ("fine facets", (15, 0, 10), 15, 1.0, (30 * math.pi, 20)),
        ("capsule", (0, -15, 20), 15, 1.0, (30 * math.pi, 20)),
        ("half", (15, 0, 10), 15, 1.0, (30 * math.acos(0.2), 20)),
        ("tube", (-10, 0, 10), 10, -1.0, (20 * math.pi, 20)),
        ("rounded", (15, -1.9, 6), 2, 1.0, (math.pi, 30)),
    ],
)
def test_the_region_around_a_point(
    name: str, at: tuple[float, float, float], radius: float | None, side: float, extent: tuple[float, float]
) -> None:
    result = region(name, at)
    assert result.frame.side == side
    assert result.frame.radius_mm == (radius if radius is None else pytest.approx(radius, abs=0.004))
    s0, t0, s1, t1 = result.outline.bounds
    size = (s1 - s0, t1 - t0)
    assert sorted(size) == pytest.approx(sorted(extent), rel=2e-3)


@pytest.mark.parametrize(
    ("name", "at", "number", "settings"),
    mostly_long(
        [
            ("plate", (15, 10, 5), 4, {"tolerance_mm": 0.1}),
            ("plate", (15, 10, 5), 2, {"fade_mm": 3.0, "sunk": True}),
            ("holes", (15, 10, 5), 2, {}),
            ("holes", (15, 10, 5), 2, {"fade_mm": 3.0, "tolerance_mm": 0.1}),
            ("turned", None, 2, {"up": "+Z"}),
            ("rounded", (15, 10, 7), 2, {"sunk": True}),
            ("drum", (15, 0, 10), 2, {"up": "+Y"}),
            ("drum", (15, 0, 10), 3, {"fade_mm": 4.0, "tolerance_mm": 0.05}),
            ("fine facets", (15, 0, 10), 2, {"sunk": True}),
            ("half", (15, 0, 10), 2, {"fade_mm": 2.0}),
            ("tube", (-10, 0, 10), 2, {"depth_mm": 0.5}),
            ("tube", (-10, 0, 10), 2, {"depth_mm": 0.5, "sunk": True}),
        ],
        ("holes", (15, 10, 5), 2, {}),
        ("turned", None, 2, {"up": "+Z"}),
        ("drum", (15, 0, 10), 2, {"up": "+Y"}),
        ("tube", (-10, 0, 10), 2, {"depth_mm": 0.5, "sunk": True}),
    ),
)
def test_the_result_is_one_closed_body_with_the_volume_of_the_integral(
    name: str, at: tuple[float, float, float] | None, number: int, settings: dict[str, Any]
) -> None:
    before = shape(name)
    top = before.triangle_points.mean(axis=1)[np.argmax(before.doubled_normals[:, 2])]
    result = textured(name, at or tuple(top.tolist()), number, **settings)
    body = result.mesh.as_manifold()
    assert body.status() == manifold3d.Error.NoError
    assert len(body.decompose()) == result.bodies == 1
    assert result.certificate.distance_mm <= settings.get("tolerance_mm", 0.02) + 1e-4
    added = result.volume_mm3 - before.volume_mm3
    assert (added < 0.0) == bool(settings.get("sunk"))
    # The triangles of a convex part are inside of it, so the error of the volume is a part of error x area.
    assert abs(result.mesh.volume_mm3 - result.volume_mm3) < 0.4 * result.certificate.distance_mm * math.prod(
        result.as_dict()["size_mm"]
    )
    uneven = "fade_mm" in settings and name == "holes"
    assert result.certificate.evidence == ("measured" if uneven else "proved")


def test_every_point_is_within_the_stated_distance_of_the_formula() -> None:
    result = textured("plate", (15, 10, 5), 2, depth_mm=0.8, margin_mm=2.0, tolerance_mm=0.01)
    corners = result.mesh.triangle_points
    top = corners[(result.mesh.doubled_normals[:, 2] > 1e-6) & (corners[..., 2].min(axis=1) > 5.1)]
    weights = np.random.default_rng(2).dirichlet(np.ones(3), 7)
    points = np.einsum("wk,nkj->nwj", weights, top).reshape(-1, 3)
    unit = VALUES["paper"].mm_per_unit[:2]
    extremes = texture_named(2).surface.mapped(unit, 1.0).extremes((0.0, 26.0), (0.0, 16.0))
    factor = 0.8 / (extremes.high - extremes.low)
    surface = texture_named(2).surface.mapped(unit, factor)
    assert len(points) > 5000
    off = distance(points - [2.0, 2.0, 0.0], surface, 5.2 - factor * extremes.low)
    assert off.largest_mm <= result.certificate.distance_mm <= 0.0101
    assert result.mesh.bounds_mm[1][2] == pytest.approx(6.0, abs=0.01)


def test_a_texture_closes_around_a_drum_and_is_within_the_stated_distance() -> None:
    result = textured("drum", (15, 0, 10), 2, depth_mm=0.6)
    (height,) = result.heights
    assert (height.periods, height.area.frame.radius_mm) == (12, pytest.approx(15.0))
    x, y, z = result.mesh.triangle_points.mean(axis=1).T
    own = (np.hypot(x, y) > 15.1) & (z > 1.01) & (z < 18.99)
    surface = texture_named(2).surface.mapped(height.mm_per_unit, 1.0)
    extremes = surface.extremes((0.0, 30 * math.pi), (0.0, 18.0))
    walls = np.abs(result.mesh.doubled_normals[:, 2]) > 0.999 * np.linalg.norm(result.mesh.doubled_normals, axis=1)
    own &= ~walls
    heights = surface(15 * np.mod(np.arctan2(y, x), 2 * math.pi)[own], z[own] - 1.0)
    expected = 15.2 + 0.6 * (heights - extremes.low) / (extremes.high - extremes.low)
    assert np.abs(np.hypot(x, y)[own] - expected).max() <= result.certificate.distance_mm


@pytest.mark.parametrize(
    ("name", "at", "settings", "message"),
    [
        ("sphere", (15, 0, 0), {}, "lies on a region that is curved"),
        ("cone", (10, 0, 10), {}, "lies on a region that is curved"),
        ("ring", (19, 0, 0), {}, "lies on a region that is curved"),
        ("pierced", (0, 15, 10), {}, "lies on a cylinder with a hole or a slanted rim"),
        ("plate", (15, 10, 9), {}, "is 4 mm from the mesh"),
        ("plate", (15, 10, math.nan), {}, "must be three finite coordinates"),
        ("plate", (15, 10, 5), {"margin_mm": 10.0}, "leaves nothing of the region"),
        ("drum", (15, 0, 10), {"margin_mm": 10.0}, "leaves nothing of the region"),
        ("plate", (15, 10, 5), {"fade_mm": 9.5}, "must be at most 9 mm, half of the textured region"),
        ("plate", (15, 10, 5), {"up": "+Z"}, "is parallel to the normal of the region"),
        ("thin", (15, 10, 1), {"sunk": True}, "leaves less than 0.4 mm of material"),
        ("corner", (25, 10, 5), {"margin_mm": 0.1}, "makes the texture touch another face"),
        ("drum", (15, 0, 10), {"sunk": True, "depth_mm": 15.0}, "is too much for a cylinder of radius 15 mm"),
        ("tube", (10, 0, 10), {"base_mm": 0.01}, "must be more than 0.012 mm"),
        ("small", (0.01, 0.01, 0.005), {}, "1000 for metres"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    name: str, at: tuple[float, float, float], settings: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        textured(name, at, **settings)
    assert "\n" not in str(error.value)


def test_an_open_mesh_and_a_mesh_that_faces_inwards_are_refused() -> None:
    plate = shape("plate")
    with pytest.raises(InputError, match="not closed: 3 edges"):
        textured_part(Mesh(plate.vertices, plate.faces[1:]), (15, 10, 5), 2)
    with pytest.raises(InputError, match="face inwards"):
        textured_part(Mesh(plate.vertices, plate.faces[:, ::-1]), (15, 10, 5), 2)
