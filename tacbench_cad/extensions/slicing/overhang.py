"""Overhangs of a part, which show whether it needs supports. They are computed from its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry import Mesh
from tacbench_cad.util.types import Bools

#: The tolerance of the z component of a unit normal, within which a face counts as horizontal or vertical.
_FLAT = 1e-4
#: A triangle that is narrower, in mm, has the direction of its rounding errors, and no printer makes it.
_NARROWEST_MM = 1e-3
#: The accuracy of a ceiling's width, in mm.
_WIDTH_MM = 1e-3


@dataclass(frozen=True, kw_only=True)
class Overhangs:
    """The faces that face down and are not on the bed.

    Attributes:
        steepest_deg: The largest angle between a sloping face and the vertical: 0 if all faces are vertical, 45 for a
            cone with this slope. Horizontal ceilings are not included.
        ceiling_mm2: The area of horizontal ceilings.
        widest_mm: The diameter of the largest circle that fits into a ceiling. A printer has to bridge at most this
            length, with support on at least two sides.
    """

    steepest_deg: float
    ceiling_mm2: float
    widest_mm: float

    def __str__(self) -> str:
        """Describe the overhangs in one line."""
        if self.steepest_deg == 0.0 and self.ceiling_mm2 == 0.0:
            return "no overhangs"
        steepest, ceilings = f"steepest {self.steepest_deg:.1f} degrees", f"ceilings {self.ceiling_mm2:.1f} mm^2"
        return f"{steepest}, {ceilings}, largest circle {self.widest_mm:.2f} mm"


def overhangs(mesh: Mesh) -> Overhangs:
    """Find the overhangs of a part that is printed in its present orientation, with its lowest point on the bed.

    Args:
        mesh: A closed mesh.
    """
    corners = mesh.triangle_points
    normal = mesh.doubled_normals
    size = np.linalg.norm(normal, axis=1)
    down = -normal[:, 2] / np.maximum(size, 1e-300)
    above_bed = corners[:, :, 2].min(axis=1) > mesh.vertices[:, 2].min() + 1e-6
    # A sloping face may begin on the bed, but the bed supports only horizontal faces.
    flat = down > 1.0 - _FLAT
    longest_mm = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    slanted = (down > _FLAT) & ~flat & (size > _NARROWEST_MM * longest_mm)
    ceiling = flat & above_bed
    steepest = float(np.degrees(np.arcsin(np.clip(down[slanted], 0.0, 1.0))).max(initial=0.0))
    return Overhangs(
        steepest_deg=steepest,
        ceiling_mm2=float(size[ceiling].sum() / 2.0),
        widest_mm=_widest_mm(mesh, ceiling),
    )


def _widest_mm(mesh: Mesh, ceiling: Bools) -> float:
    """Return the diameter of the largest circle in the ceilings."""
    import shapely

    ceilings = shapely.union_all(shapely.polygons(mesh.triangle_points[ceiling][:, :, :2]))
    radii = [shapely.maximum_inscribed_circle(part, _WIDTH_MM / 2.0).length for part in shapely.get_parts(ceilings)]
    return 2.0 * max(radii, default=0.0)
