"""A picture of any part without a window: CadQuery, build123d and kernel objects, ours or your own.

A block as PNG::

    from tacbench_cad.bd import TextureBlock
    from tacbench_cad.render.snapshot import snapshot

    snapshot(TextureBlock(4), "block.png")

The objects keep their colours: those of a build123d compound's children, and those of the parts of a CadQuery assembly.
It needs matplotlib (extra ``plot``) and the CAD kernel. For blocks, holder and jig alone
:mod:`tacbench_cad.render.pictures` is better, because it draws our own meshes; :mod:`tacbench_cad.render.viewing` shows
them from all sides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.triangulation import triangulate
from tacbench_cad.render.raster import ABOVE, Body, Camera, Colour, linear, render
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.plotting import fill_figure, new_figure, save_figure, styled

if TYPE_CHECKING:
    from OCP.TopLoc import TopLoc_Location
    from OCP.TopoDS import TopoDS_Shape

#: Largest angle between neighbouring triangles, in radians for each mm of the tolerance.
ANGLE_RAD_PER_MM = 10.0
#: Colour of objects that have none: the renderer's usual material, as sRGB from 0 to 1.
GREY: Colour = (0.775, 0.816, 0.856)
_DPI = 100


def snapshot(
    shape: Any,
    path: Path | str,
    camera: Camera = ABOVE,
    size_px: tuple[int, int] = (1080, 620),
    tolerance_mm: float = 0.02,
) -> None:
    """Draw a shaded picture of a part, or of several together.

    Args:
        shape: A Workplane, Shape or Assembly of CadQuery; a Shape or BuildPart of build123d; a ``TopoDS_Shape`` of the
            kernel; several of these in a list; or a :class:`~tacbench_cad.Mesh`.
        path: The file; its name ends in ``.png``, ``.svg`` or ``.pdf``.
        camera: The direction of view.
        size_px: Width and height of the picture in pixels.
        tolerance_mm: Largest distance of the triangles that are drawn from the faces, in mm. The kernel makes these
            triangles: for textures 4 and 6 it needs minutes at 0.02 mm, and a second or two at 0.2 mm.

    Raises:
        InputError: There is nothing to draw, the file's name has another ending, or the file cannot be written.
        MissingToolError: matplotlib is not installed.
    """
    if not tolerance_mm > 0.0:
        raise InputError("tolerance", tolerance_mm, "must be above 0 mm")
    bodies = [Body(mesh=shape, colour=GREY)] if isinstance(shape, Mesh) else []
    for piece, colour in [] if bodies else _pieces(shape):
        mesh = Mesh(*triangulate(piece, tolerance_mm, ANGLE_RAD_PER_MM * tolerance_mm))
        if len(mesh.faces):
            bodies.append(Body(mesh=mesh, colour=linear(colour)))
    if not bodies:
        raise InputError("shape", type(shape).__name__, "has no face to draw")
    width, height = size_px
    image = render(bodies, width, height, camera)
    with styled():
        figure = new_figure((width / _DPI, height / _DPI), _DPI)
        fill_figure(figure, image)
        save_figure(figure, Path(path))


def _pieces(shape: Any) -> Iterator[tuple[TopoDS_Shape, Colour]]:
    """Kernel shapes in their places with their colours. The attributes of an object show which package made it."""
    if hasattr(shape, "traverse") and hasattr(shape, "toCompound"):  # cq.Assembly
        for piece, _, place, colour in shape:
            yield piece.moved(place).wrapped, GREY if colour is None else _rgb(colour.toTuple())
    elif hasattr(shape, "vals"):  # cq.Workplane
        yield from _each(shape.vals())
    elif hasattr(shape, "part") and not hasattr(shape, "wrapped"):  # bd.BuildPart
        yield from _pieces(shape.part)
    elif getattr(shape, "children", ()):  # an assembly of build123d
        yield from _children(shape, None)
    elif hasattr(shape, "wrapped"):
        colour = getattr(shape, "color", None)
        if shape.wrapped is not None and hasattr(shape.wrapped, "ShapeType"):
            yield shape.wrapped, GREY if colour is None else _rgb(colour)
    elif hasattr(shape, "ShapeType"):
        yield shape, GREY
    elif isinstance(shape, list | tuple):
        yield from _each(shape)
    else:
        allowed = "must be a CadQuery, build123d or kernel shape, or a list of them"
        raise InputError("shape", type(shape).__name__, allowed)


def _each(shapes: Iterable[Any]) -> Iterator[tuple[TopoDS_Shape, Colour]]:
    for shape in shapes:
        yield from _pieces(shape)


def _children(parent: Any, place: TopLoc_Location | None) -> Iterator[tuple[TopoDS_Shape, Colour]]:
    """The leaves of a build123d tree. The place of each child is relative to its parent."""
    own = parent.location.wrapped
    place = own if place is None else place.Multiplied(own)
    for child in parent.children:
        if child.children:
            yield from _children(child, place)
        else:
            for piece, colour in _pieces(child):
                yield piece.Moved(place), colour


def _rgb(colour: Iterable[float]) -> Colour:
    red, green, blue, *_ = colour
    return (red, green, blue)
