"""Functions for Open CASCADE shapes: their sub-shapes, locations, volumes, areas and bounding boxes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS_Shape


def shape_of(thing: Any, name: str) -> TopoDS_Shape:
    """Return the kernel's shape of an object of CadQuery or build123d, or the shape itself.

    Args:
        thing: The object.
        name: What the object should be, for the error message.

    Raises:
        InputError: The object has no shape.
    """
    shape = thing.val() if hasattr(thing, "val") else thing
    shape = getattr(shape, "wrapped", shape)
    if shape is None or not hasattr(shape, "ShapeType"):
        raise InputError(name, thing, f"must be a {name} of CadQuery, build123d or Open CASCADE")
    return shape


def is_shape(thing: Any) -> bool:
    """Return whether an object is of CadQuery, build123d or Open CASCADE."""
    return any(hasattr(thing, name) for name in ("val", "wrapped", "ShapeType"))


def each(shape: TopoDS_Shape, kind: str, outside_of: str = "SHAPE") -> Iterator[Any]:
    """Yield the sub-shapes of a kind in the order of the shape. A sub-shape that is used twice is yielded twice.

    Args:
        shape: The shape.
        kind: ``SOLID``, ``SHELL``, ``FACE``, ``WIRE``, ``EDGE`` or ``VERTEX``.
        outside_of: A kind of sub-shape. Everything inside a sub-shape of this kind is left out.
    """
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS

    kinds = (getattr(TopAbs_ShapeEnum, f"TopAbs_{name}") for name in (kind, outside_of))
    explorer, downcast = TopExp_Explorer(shape, *kinds), getattr(TopoDS, f"{kind.title()}_s")
    while explorer.More():
        yield downcast(explorer.Current())
        explorer.Next()


def distinct(shape: TopoDS_Shape, kind: str) -> list[Any]:
    """Return the sub-shapes of a kind. A sub-shape that is used several times is listed once."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    table, downcast = TopTools_IndexedMapOfShape(), getattr(TopoDS, f"{kind.title()}_s")
    TopExp.MapShapes_s(shape, getattr(TopAbs_ShapeEnum, f"TopAbs_{kind}"), table)
    return [downcast(table.FindKey(i)) for i in range(1, table.Size() + 1)]


def location(matrix: Floats) -> TopLoc_Location:
    """Convert a homogeneous matrix, shape (4, 4), in mm, to a location of the kernel."""
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    place = gp_Trsf()
    place.SetValues(*matrix[:3].ravel().tolist())
    return TopLoc_Location(place)


def genus(shape: TopoDS_Shape) -> int:
    """Count the through holes of a closed solid.

    The Euler-Poincare formula gives them: ``V - E + F - (wires - F) = 2 (shells - genus)``. Edges without length (the
    tip of a cone) are not counted, and a seam is counted once.
    """
    from OCP.BRep import BRep_Tool

    edges = sum(not BRep_Tool.Degenerated_s(edge) for edge in distinct(shape, "EDGE"))
    faces = len(distinct(shape, "FACE"))
    euler = len(distinct(shape, "VERTEX")) - edges + 2 * faces - len(distinct(shape, "WIRE"))
    return len(distinct(shape, "SHELL")) - euler // 2


def surface_kind(face: TopoDS_Shape) -> str:
    """Return the kind of a face's surface: ``Plane``, ``Cylinder``, ``BSplineSurface`` and so on."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface

    return str(BRepAdaptor_Surface(face, False).GetType()).rpartition("_")[2]


def volume_mm3(shape: TopoDS_Shape, accuracy: float | None = None) -> float:
    """Return the volume. It is negative if the solid is inside out.

    Args:
        shape: The shape.
        accuracy: The accuracy of the kernel's adaptive method, which is right for spline faces. At 1e-3, the relative
            error of the solids of this package is below 2e-6. None chooses the default method, which is exact for
            planes and cylinders, but can be wrong by 3e-3 on spline faces.
    """
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    if accuracy is None:
        BRepGProp.VolumeProperties_s(shape, properties)
    else:
        BRepGProp.VolumeProperties_s(shape, properties, accuracy, False, True)
    return float(properties.Mass())


def area_mm2(shapes: Iterable[TopoDS_Shape]) -> float:
    """Return the total area of some faces by the kernel's default method."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    total = 0.0
    for shape in shapes:
        properties = GProp_GProps()  # a new object for each face, because the kernel overwrites it
        BRepGProp.SurfaceProperties_s(shape, properties)
        total += properties.Mass()
    return total


def box_mm(shape: TopoDS_Shape) -> tuple[Floats, Floats]:
    """Return the lower and the upper corner of the bounding box, shape (3,) each, or zeros for an empty shape."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib

    box = Bnd_Box()
    BRepBndLib.AddOptimal_s(shape, box, False, False)
    ends = np.zeros(6) if box.IsVoid() else np.array(box.Get())
    return ends[:3], ends[3:]
