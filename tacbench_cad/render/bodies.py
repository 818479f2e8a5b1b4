"""What the renderer needs to know of parts: their meshes, and the surfaces of textured tops.

The top of a block that follows its formula within a tolerance is shown with the heights and slopes of the formula, so
that the picture has the surface in it and not the edges of long triangles. Two kinds of tops are shown triangle by
triangle, because there the triangles are the shape that is printed:

- a top that joins the samples of a grid (preset ``released``, option ``--grid``);
- a top with a tolerance so coarse that its facets can be seen.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.block_part import as_part
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.render.raster import MATERIAL, Body, Colour, Relief
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.sines import Sines
from tacbench_cad.util.types import Floats

#: Facets are shown above this tolerance, as a fraction of the block's longer side: about a pixel of a large picture.
VISIBLE_TOLERANCE = 1.0 / 500.0
#: Tolerance of a mesh that is made for a picture alone, as a fraction of the block's longer side.
_FINE = 5e-5
#: The same for a texture that is not separable. Its mesh takes longer, and the picture shows the slopes of the formula.
_FINE_OTHER = 3e-4
#: Points along each axis at which the slopes of a separable texture are calculated.
_TABLE = 8193


def body_of(thing: Any) -> Body:
    """A part as a body in its own frame.

    Args:
        thing: A mesh, a block, a part, or anything else with a method ``part()``.

    Raises:
        InputError: It is none of these, or its mesh cannot be made.
        MissingToolError: Its mesh needs the CAD kernel, which is not installed.
    """
    if isinstance(thing, Mesh):
        return Body(mesh=thing)
    part: PrintPart = as_part(thing)
    return Body(mesh=part.mesh[0], relief=None if part.block is None else relief_of(part.block))


def fine_body(part: PrintPart, colour: Colour = MATERIAL) -> Body:
    """A part as a body with a mesh for large pictures: no facet of a block with a tolerance can be seen.

    Args:
        part: The part.
        colour: Its linear colour under full light.

    Raises:
        InputError: Its mesh cannot be made.
        MissingToolError: Its mesh needs the CAD kernel, which is not installed.
    """
    block = part.block
    if block is None:
        return Body(mesh=part.mesh[0], colour=colour)
    if isinstance(block.sampling, Tolerance):
        # a mesh cannot be nearer to a texture than the texture is to its own source
        fraction = _FINE if block.surface.is_separable else _FINE_OTHER
        finest = max(fraction * max(block.size_mm), 3.0 * block.surface.error)
        block = replace(block, sampling=Tolerance(mm=min(block.sampling.mm, finest)))
    return Body(mesh=mesh_block(block)[0], colour=colour, relief=relief_of(block))


def relief_of(block: Block) -> Relief | None:
    """The surface by which a block's top is shown; None where its triangles are the shape that is printed."""
    if not isinstance(block.sampling, Tolerance) or block.sampling.mm > VISIBLE_TOLERANCE * max(block.size_mm):
        return None
    surface, datum = block.surface, block.datum_mm
    if not surface.is_separable:
        return lambda x, y: (datum + surface(x, y), *surface.gradient(x, y))
    along_x, along_y = (
        _Profile(wave, side) for wave, side in zip((surface.along_u, surface.along_v), block.size_mm, strict=True)
    )

    def relief(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        (p, slope_x), (q, slope_y) = along_x(x), along_y(y)
        return datum + p + q, slope_x, slope_y

    return relief


class _Profile:
    """Heights and slopes of a texture along one axis, from a table with equal steps.

    Args:
        wave: The texture's part along the axis, in mm.
        side: Length of the block along it, in mm.
    """

    def __init__(self, wave: Sines, side: float) -> None:
        points = np.linspace(0.0, side, _TABLE)
        self._steps_per_mm = (_TABLE - 1) / side
        self._tables = tuple((values, np.diff(values)) for values in (wave(points), wave(points, 1)))

    def __call__(self, at: Floats) -> tuple[Floats, Floats]:
        """Heights and slopes at some points."""
        steps = np.clip(at * self._steps_per_mm, 0.0, _TABLE - 1.001)
        i = steps.astype(np.int64)
        steps -= i
        heights, slopes = (start[i] + steps * rise[i] for start, rise in self._tables)
        return heights, slopes
