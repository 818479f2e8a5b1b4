"""The faces of the underside of a block: the plane and the pockets of a label."""

from __future__ import annotations

from collections.abc import Iterator

import shapely
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Wire

from tacbench_cad.geometry.splines.topology import Point, Topology, plane, turned
from tacbench_cad.spec.label import LABEL_DEPTH_MM, Engraving
from tacbench_cad.spec.outlines import area_mm2
from tacbench_cad.util.types import Floats

_DOWN: Point = (0.0, 0.0, -1.0)
_ALONG: Point = (1.0, 0.0, 0.0)


def underside(top: Topology, outline: TopoDS_Wire, engraving: Engraving | None) -> Iterator[TopoDS_Face]:
    """Yield the faces that close a block from below.

    Args:
        top: The builder of the shapes.
        outline: The outline of the block at z = 0, counter-clockwise seen from below.
        engraving: The pockets of the label, or None.
    """
    contours = engraving.contours if engraving else ()
    owners = _owners(contours)
    rims: list[TopoDS_Wire] = []
    ceilings: list[TopoDS_Wire] = []
    for contour in contours:
        rim, ceiling, walls = _pocket_walls(top, contour)
        rims.append(rim)
        ceilings.append(ceiling)
        yield from walls
    ground, deep = plane((0.0, 0.0, 0.0), _DOWN, _ALONG), plane((0.0, 0.0, LABEL_DEPTH_MM), _DOWN, _ALONG)
    yield top.face(ground, [outline, *(rims[k] for k, owner in enumerate(owners) if owner is None)])
    for k, contour in enumerate(contours):
        inner = [n for n, owner in enumerate(owners) if owner == k]
        if area_mm2(contour) > 0.0:
            yield top.face(deep, [ceilings[k], *(ceilings[n] for n in inner)])
        else:
            yield top.face(ground, [rims[k], *(rims[n] for n in inner)])


def _owners(contours: tuple[Floats, ...]) -> list[int | None]:
    """Return for each contour the index of the smallest contour around it."""
    areas = [abs(area_mm2(contour)) for contour in contours]
    owners: list[int | None] = []
    for k, contour in enumerate(contours):
        around = [
            n
            for n, other in enumerate(contours)
            if areas[n] > areas[k] and shapely.contains_xy(shapely.Polygon(other), *contour[0])
        ]
        owners.append(min(around, key=areas.__getitem__) if around else None)
    return owners


def _pocket_walls(top: Topology, contour: Floats) -> tuple[TopoDS_Wire, TopoDS_Wire, list[TopoDS_Face]]:
    """Make the rim of a pocket along its contour at z = 0, the outline of its ceiling, and the walls between them.

    The outline of the ceiling runs in the opposite direction.
    """
    low: list[Point] = [(x, y, 0.0) for x, y in contour.tolist()]
    high: list[Point] = [(x, y, LABEL_DEPTH_MM) for x, y, _ in low]
    low_vertices, high_vertices = [top.vertex(point) for point in low], [top.vertex(point) for point in high]
    posts = [
        top.segment(a, b, start, end) for a, b, start, end in zip(low, high, low_vertices, high_vertices, strict=True)
    ]
    feet: list[TopoDS_Edge] = []
    heads: list[TopoDS_Edge] = []
    walls: list[TopoDS_Face] = []
    for k in range(len(low)):
        after = (k + 1) % len(low)
        feet.append(top.segment(low[k], low[after], low_vertices[k], low_vertices[after]))
        heads.append(top.segment(high[k], high[after], high_vertices[k], high_vertices[after]))
        dx, dy = low[after][0] - low[k][0], low[after][1] - low[k][1]
        wall = plane(
            low[k], (-dy, dx, 0.0), (dx, dy, 0.0)
        )  # the pocket is on the left, and so is the outside of the solid
        wire = top.wire([posts[k], heads[k], turned(posts[after]), turned(feet[k])])
        walls.append(top.face(wall, [wire]))
    return top.wire(feet), top.wire([turned(head) for head in reversed(heads)]), walls
