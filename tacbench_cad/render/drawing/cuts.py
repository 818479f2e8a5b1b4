"""Outlines of a mesh as drawings need them: level cuts seen from above, sections seen from the front and the right.

They are cut out of the part's own mesh by manifold3d, so a drawing cannot show another part.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.util.types import Floats

Outlines = tuple[Floats, ...]

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

    def from_front(self, y_mm: float) -> Outlines:
        """The section at a y, seen from low y: a is x, b is z."""
        return _loops(self._turned(_FRONT).slice(-y_mm))

    def from_right(self, x_mm: float) -> Outlines:
        """The section at an x, seen from high x, its top to the left: a is -z, b is y."""
        return _loops(self._turned(_RIGHT).slice(x_mm))

    def beyond_front(self, y_mm: float) -> Outlines:
        """The outline of what lies behind a section seen from the front; for parts of few triangles."""
        return _loops(self._turned(_FRONT).trim_by_plane((0.0, 0.0, -1.0), y_mm).project())

    def beyond_right(self, x_mm: float) -> Outlines:
        """The outline of what lies behind a section seen from the right; for parts of few triangles."""
        return _loops(self._turned(_RIGHT).trim_by_plane((0.0, 0.0, -1.0), -x_mm).project())

    def _turned(self, axes: Floats) -> Any:
        return self._body.transform(np.column_stack([axes, np.zeros(3)]))


def _loops(section: Any) -> Outlines:
    return tuple(np.asarray(loop, dtype=np.float64) for loop in section.to_polygons())
