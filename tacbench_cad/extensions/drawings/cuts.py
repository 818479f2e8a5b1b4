"""Outlines of a mesh for drawings: level cuts seen from above, and sections seen from the front and from the right.

manifold3d cuts them from the mesh of the part itself, so a drawing always shows the part that is printed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tacbench_cad.extensions.drawings.sheet import Outlines
from tacbench_cad.geometry import Mesh
from tacbench_cad.util.types import Floats

# Rows: the directions to the right, up and towards the viewer, in the part's x, y, z.
_FRONT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
_RIGHT = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])


class Cuts:
    """Cuts a mesh into outlines.

    Args:
        mesh: A closed mesh.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._body = mesh.as_manifold()

    def level(self, z_mm: float) -> Outlines:
        """The cut at a height, seen from above: x runs to the right, y up."""
        return _loops(self._body.slice(z_mm))

    def front(self, y_mm: float, beyond: bool = True) -> dict[str, Outlines]:
        """The section at a y, seen from low y: x runs to the right, z up.

        Args:
            y_mm: Place of the section.
            beyond: Also return the outline of the part behind the section, as ``seen``; only for parts with few
                triangles.
        """
        return self._section(_FRONT, -y_mm, beyond)

    def right(self, x_mm: float, beyond: bool = True) -> dict[str, Outlines]:
        """The section at an x, seen from high x, with the top to the left: -z runs to the right, y up."""
        return self._section(_RIGHT, x_mm, beyond)

    def _section(self, axes: Floats, at_mm: float, beyond: bool) -> dict[str, Outlines]:
        body = self._body.transform(np.column_stack([axes, np.zeros(3)]))
        cut = _loops(body.slice(at_mm))
        return {"cut": cut, "seen": _loops(body.trim_by_plane((0.0, 0.0, -1.0), -at_mm).project()) if beyond else ()}


def _loops(section: Any) -> Outlines:
    return tuple(np.asarray(loop, dtype=np.float64) for loop in section.to_polygons())
