"""Outlines of a mesh as drawings need them: level cuts seen from above, sections seen from the front and the right.

They are cut out of the part's own mesh by manifold3d, so a drawing cannot show another part.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.render.drawing.sheet import Outlines
from tacbench_cad.util.types import Floats

# Rows give the view's a and b and what points to the eye, in the part's x, y, z.
_FRONT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_RIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


class Cuts:
    """A mesh to be cut.

    Args:
        mesh: A closed mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._body = mesh.as_manifold()

    def level(self, z_mm: float) -> Outlines:
        """The cut at a height, seen from above: a is x, b is y."""
        return _loops(self._body.slice(z_mm))

    def front(self, y_mm: float, beyond: bool = True) -> dict[str, Outlines]:
        """The section at a y, seen from low y: a is x, b is z.

        Args:
            y_mm: Where it is taken.
            beyond: Give what lies behind it too, as ``seen``; only for parts of few triangles.
        """
        return self._section(_FRONT, -y_mm, beyond)

    def right(self, x_mm: float, beyond: bool = True) -> dict[str, Outlines]:
        """The section at an x, seen from high x, its top to the left: a is -z, b is y."""
        return self._section(_RIGHT, x_mm, beyond)

    def _section(self, axes: Floats, at_mm: float, beyond: bool) -> dict[str, Outlines]:
        body = self._body.transform(np.column_stack([axes, np.zeros(3)]))
        cut = _loops(body.slice(at_mm))
        return {"cut": cut, "seen": _loops(body.trim_by_plane((0.0, 0.0, -1.0), -at_mm).project()) if beyond else ()}


def _loops(section: Any) -> Outlines:
    return tuple(np.asarray(loop, dtype=np.float64) for loop in section.to_polygons())
