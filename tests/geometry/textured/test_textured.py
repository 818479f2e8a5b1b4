"""A texture on a face of a part: one valid solid, near to the formula, with the volume of the integral."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("cadquery")

import cadquery as cq
from helpers.cases import mostly_long
from helpers.solid_reference import kernel_volume_mm3
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepTools import BRepTools
from OCP.GeomAbs import GeomAbs_SurfaceType

from tacbench_cad.checks.solidcheck import solid_checks
from tacbench_cad.geometry import kernel
from tacbench_cad.geometry.textured.solid import TexturedSolid, textured_solid
from tacbench_cad.geometry.texturing import texturing
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError

PLATE = cq.Workplane().box(40, 30, 5).faces(">Z").workplane().pushPoints([(-10, 5), (10, -5)]).hole(6)
#: A hole so near to the side that both margins meet.
NOTCHED = cq.Workplane().box(30, 20, 5).faces(">Z").workplane().pushPoints([(12, 0), (-5, 0)]).hole(4)
ELL = cq.Workplane().polyline([(0, 0), (30, 0), (30, 8), (8, 8), (8, 20), (0, 20)]).close().extrude(5)
ELLIPSE = cq.Workplane().ellipse(15, 9).extrude(5).faces(">Z").workplane().rect(6, 4).cutThruAll()
DRUM = cq.Workplane().circle(10).extrude(15)
TILTED = DRUM.rotate((0, 0, 0), (1, 1, 0), 50).translate((3, 4, 5))
TUBE = cq.Workplane().circle(12).circle(8).extrude(15)
#: A drum with a hole through its side.
PIERCED = DRUM.cut(cq.Workplane("XZ").center(0, 7).circle(1).extrude(30))
SLOT = cq.Workplane().slot2D(40, 20).extrude(15)
WEAVE = Texture(name="weave", surface=plane_waves((0.6, 1.0, 0.5), (0.6, 1.0, -0.5)))


def face_of(part: cq.Workplane, name: str) -> Any:
    """A face by selector; ``bore`` is the cylinder with the smallest radius."""
    if name != "bore":
        return part.faces(name).val().wrapped
    return min(
        (face.wrapped for face in part.faces("%Cylinder").vals()),
        key=lambda face: BRepAdaptor_Surface(face).Cylinder().Radius(),
    )


def textured(part: cq.Workplane, face: str, texture: Any, **settings: Any) -> TexturedSolid:
    return textured_solid(part.val().wrapped, face_of(part, face), texturing(texture, **settings))


def largest_error_mm(result: TexturedSolid) -> float:
    """The largest distance of points on the spline patches from the formula, along the normal of the face."""
    worst = 0.0
    for height in result.heights:
        area = height.area
        for face in kernel.each(result.solid, "FACE"):
            surface = BRepAdaptor_Surface(face, False)
            if surface.GetType() != GeomAbs_SurfaceType.GeomAbs_BSplineSurface:
                continue
            s0, s1, t0, t1 = BRepTools.UVBounds_s(face)
            lines = np.linspace(s0, s1, 15), np.linspace(t0, t1, 15)
            values = [surface.Value(s, t) for s in lines[0] for t in lines[1]]
            points = np.array([(p.X(), p.Y(), p.Z()) for p in values])
            s, t = area.frame.local(points).T
            own = (points - area.frame.origin) @ area.frame.axes.T
            radius = area.frame.radius_mm
            h = own[:, 2] if radius is None else area.frame.side * (np.hypot(own[:, 0], own[:, 1]) - radius)
            inside = (s >= 0.0) & (s <= area.size_mm[0]) & (t >= 0.0) & (t <= area.size_mm[1])
            inside &= area.inside(s, t)
            worst = max(worst, float(np.abs(h - height(s, t))[inside].max(initial=0.0)))
    return worst


#: The cases of the quick run: holes, oblique waves, a fade, and the outside and the inside of cylinders.
QUICK = ("plate with holes", "oblique waves", "fade on a rectangle", "drum", "tilted drum", "bore", "half a cylinder")
CASES: dict[str, tuple[cq.Workplane, str, Any, dict[str, Any]]] = {
    "plate with holes": (PLATE, ">Z", 2, {}),
    "sunk": (PLATE, "<Z", 2, {"sunk": True}),
    "fade around holes": (NOTCHED, ">Z", 2, {"fade_mm": 2.0, "tolerance_mm": 0.005}),
    "fade on a rectangle": (cq.Workplane().box(30, 20, 5), ">Z", 2, {"fade_mm": 3.0}),
    "hole at the side": (NOTCHED, ">Z", 1, {}),
    "concave": (ELL, ">Z", 2, {"up": (1.0, 0.4, 0.0)}),
    "ellipse": (ELLIPSE, ">Z", 2, {}),
    "coarse fade in an ellipse": (
        ELLIPSE,
        ">Z",
        2,
        {"depth_mm": 1.5, "fade_mm": 1.0, "mm_per_unit": (0.602, 0.748), "tolerance_mm": 0.05},
    ),
    "oblique waves": (PLATE, ">Z", WEAVE, {"depth_mm": 0.5}),
    "side face": (cq.Workplane().box(20, 20, 20), "<X", 2, {"up": "+Z"}),
    "drum": (DRUM, "%Cylinder", 2, {}),
    "drum with many patches": (DRUM, "%Cylinder", 5, {}),
    "tilted drum": (TILTED, "%Cylinder", 2, {"fade_mm": 2.0}),
    "drum, sunk": (DRUM, "%Cylinder", 2, {"sunk": True}),
    "bore": (TUBE, "bore", 2, {}),
    "half a cylinder": (SLOT, ">X", 2, {}),
}


@pytest.mark.parametrize("name", mostly_long(CASES, *QUICK))
def test_one_valid_solid_near_the_formula(name: str) -> None:
    part, face, texture, settings = CASES[name]
    result = textured(part, face, texture, **settings)
    assert max(BRep_Tool.Tolerance_s(vertex) for vertex in kernel.distinct(result.solid, "VERTEX")) < 1e-3
    assert all(check.ok for check in solid_checks(result.solid))
    assert result.error_mm <= settings.get("tolerance_mm", 0.001)
    assert result.is_proved == (name not in ("fade around holes", "coarse fade in an ellipse"))
    assert largest_error_mm(result) <= result.error_mm + 1e-9
    if "ellipse" not in name:  # the kernel's volume of a wall below a free curve is less accurate
        assert kernel_volume_mm3(result.solid) == pytest.approx(result.volume_mm3, rel=1e-5)
    added = result.volume_mm3 - kernel.volume_mm3(part.val().wrapped)
    assert (added < 0.0) == settings.get("sunk", False)


def test_the_face_and_the_depth_are_as_stated() -> None:
    result = textured(cq.Workplane().box(40, 30, 5), ">Z", 2, depth_mm=0.8, margin_mm=2.0)
    low, high = kernel.box_mm(result.solid)
    assert high[2] == pytest.approx(2.5 + 0.2 + 0.8, abs=1e-3)
    assert low.tolist() == pytest.approx([-20, -15, -2.5], abs=1e-6)
    (height,) = result.heights
    assert height.area.size_mm == pytest.approx((36.0, 26.0))
    assert height.area.frame.origin == pytest.approx([-18.0, -13.0, 2.5])
    assert height(np.array(0.0), np.array(0.0)) == pytest.approx(0.2 + 0.8 * 3 / 4)  # sin 0 + cos 0 between -2 and 2


def test_the_texture_closes_around_a_cylinder() -> None:
    result = textured(DRUM, "%Cylinder", 2)
    (height,) = result.heights
    assert height.periods == 8  # 62.8 mm by 7.57 mm
    assert height.mm_per_unit[0] == pytest.approx(10.0 / 8)
    uneven = Texture(name="uneven", surface=plane_waves((1.0, 1.0, 0.0), (1.0, 2**0.5, 0.0)))
    with pytest.raises(InputError, match="no period along x"):
        textured(DRUM, "%Cylinder", uneven)


def test_a_spline_is_interpolated_and_its_own_error_is_added() -> None:
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 40.0, 9), [40.0] * 3])
    axis = SplineAxis(knots, 3)
    poles = np.sin(np.arange(121)).reshape(11, 11)
    bumps = Texture(name="bumps", surface=SplineSurface(u=axis, v=axis, poles=poles, error=0.01, evidence="measured"))
    result = textured(cq.Workplane().box(20, 20, 5), ">Z", bumps, mm_per_unit=(1.0, 1.0), tolerance_mm=0.01)
    assert all(check.ok for check in solid_checks(result.solid))
    assert not result.is_proved and result.error_mm > 0.001
    assert kernel_volume_mm3(result.solid) == pytest.approx(result.volume_mm3, rel=1e-5)


@pytest.mark.parametrize(
    ("part", "face", "settings", "message"),
    [
        (cq.Workplane().sphere(5), ">Z", {}, "face: is spherical; only planes and cylinders"),
        (PLATE, ">Z", {"margin_mm": 20.0}, "leaves nothing of the face"),
        (DRUM, "%Cylinder", {"margin_mm": 8.0}, "leaves nothing of the face"),
        (PLATE, ">Z", {"up": "+Z"}, "is parallel to the normal"),
        (PLATE, ">Z", {"up": "top"}, "must be one of"),
        (PLATE, ">Z", {"up": (0.0, 0.0, 0.0)}, "must be a direction"),
        (PLATE, ">Z", {"sunk": True, "depth_mm": 5.0}, "leaves less than 0.4 mm of material"),
        (TUBE, "bore", {"depth_mm": 9.0}, "too much for a cylinder of radius 8 mm"),
        (PLATE, ">Z", {"fade_mm": 15.0}, "half of the textured region"),
        (PLATE, ">Z", {"depth_mm": float("nan")}, "depth_mm"),
        (PLATE, ">Z", {"tolerance_mm": 0.0}, "tolerance_mm"),
        (PLATE, ">Z", {"dept_mm": 1.0}, "is unknown; the settings are"),
        (PIERCED, "%Cylinder", {}, "is a cylinder with a hole"),
    ],
)
def test_bad_input_is_refused(part: cq.Workplane, face: str, settings: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        textured(part, face, 2, **settings)


def test_a_hole_can_be_cut_through_a_textured_cylinder() -> None:
    drum = cq.Workplane(cq.Solid(textured(DRUM, "%Cylinder", 2, depth_mm=0.5).solid))
    pierced = drum.cut(cq.Workplane("XZ").center(0, 7).circle(1).extrude(30))
    assert all(check.ok for check in solid_checks(pierced.val().wrapped))
    removed = kernel_volume_mm3(drum.val().wrapped) - kernel_volume_mm3(pierced.val().wrapped)
    assert np.pi * 10.2 < removed < np.pi * 10.7


def test_a_face_of_another_part_is_refused() -> None:
    with pytest.raises(InputError, match="not a face of the part"):
        textured_solid(PLATE.val().wrapped, face_of(ELL, ">Z"), texturing(2))


def test_a_texture_that_meets_another_face_is_refused() -> None:
    step = cq.Workplane().box(30, 20, 5).faces(">Z").workplane().center(10, 0).rect(10, 20).extrude(5)
    assert textured(step, ">Z", 2).is_proved
    overhang = cq.Workplane("XZ").polyline([(0, 0), (30, 0), (30, 12), (5, 12), (5, 6), (25, 6), (25, 5), (0, 5)])
    with pytest.raises(InputError, match="touch another face"):
        textured_solid(
            (hook := overhang.close().extrude(10)).val().wrapped,
            hook.faces("<Z[1]").val().wrapped,
            texturing(2, depth_mm=2.0),
        )
