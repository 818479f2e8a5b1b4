"""What is asked of Open CASCADE's shapes in several places: their parts, their places, their volume, area and box."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS_Shape


def each(shape: TopoDS_Shape, kind: str, outside_of: str = "SHAPE") -> Iterator[Any]:
    """The sub-shapes of a kind in the order of the shape, each use by itself.

    Args:
        shape: The shape.
        kind: ``SOLID``, ``SHELL``, ``FACE``, ``WIRE``, ``EDGE`` or ``VERTEX``.
        outside_of: Leave out those that belong to a sub-shape of this kind.
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
    """The sub-shapes of a kind, each once however often it is used."""
    from OCP.TopAbs import TopAbs_ShapeEnum
    from OCP.TopExp import TopExp
    from OCP.TopoDS import TopoDS
    from OCP.TopTools import TopTools_IndexedMapOfShape

    table, downcast = TopTools_IndexedMapOfShape(), getattr(TopoDS, f"{kind.title()}_s")
    TopExp.MapShapes_s(shape, getattr(TopAbs_ShapeEnum, f"TopAbs_{kind}"), table)
    return [downcast(table.FindKey(i)) for i in range(1, table.Size() + 1)]


def location(matrix: Floats) -> TopLoc_Location:
    """The kernel's form of a homogeneous matrix (4, 4), in mm."""
    from OCP.gp import gp_Trsf
    from OCP.TopLoc import TopLoc_Location

    place = gp_Trsf()
    place.SetValues(*matrix[:3].ravel().tolist())
    return TopLoc_Location(place)


def volume_mm3(shape: TopoDS_Shape) -> float:
    """The default volume; negative where the solid is inside out."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    properties = GProp_GProps()
    BRepGProp.VolumeProperties_s(shape, properties)
    return float(properties.Mass())


def area_mm2(shapes: Iterable[TopoDS_Shape]) -> float:
    """The default area of some faces together."""
    from OCP.BRepGProp import BRepGProp
    from OCP.GProp import GProp_GProps

    total = 0.0
    for shape in shapes:
        properties = GProp_GProps()  # the kernel begins anew with every call
        BRepGProp.SurfaceProperties_s(shape, properties)
        total += properties.Mass()
    return total


def box_mm(shape: TopoDS_Shape) -> tuple[Floats, Floats]:
    """Lower and upper corner of the bounding box, each (3,); zeros where there is nothing."""
    from OCP.Bnd import Bnd_Box
    from OCP.BRepBndLib import BRepBndLib

    box = Bnd_Box()
    BRepBndLib.AddOptimal_s(shape, box, False, False)
    ends = np.zeros(6) if box.IsVoid() else np.array(box.Get())
    return ends[:3], ends[3:]
