"""What of a part hangs in the air while it is printed: whether it needs supports is read off its triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.util.types import Bools

#: Triangles whose normal is this near to straight down are a ceiling; sine of the angle.
_FLAT = 1e-4
#: A ceiling's width is found to this, in mm.
_WIDTH_MM = 1e-3


@dataclass(frozen=True, kw_only=True)
class Overhangs:
    """Faces that look down and do not lie on the bed.

    Attributes:
        steepest_deg: Largest angle from the vertical of those that are not flat ceilings: 0 where all are upright,
            45 for a cone that a printer closes layer by layer.
        ceiling_mm2: Area of flat ceilings.
        widest_mm: Diameter of the largest circle that goes into a ceiling: what a printer bridges at most, held on at
            least two sides.
    """

    steepest_deg: float
    ceiling_mm2: float
    widest_mm: float

    def __str__(self) -> str:
        """One line for people."""
        if self.steepest_deg == 0.0 and self.ceiling_mm2 == 0.0:
            return "no overhangs"
        steepest, ceilings = f"steepest {self.steepest_deg:.1f} degrees", f"ceilings {self.ceiling_mm2:.1f} mm^2"
        return f"{steepest}, {ceilings}, largest circle {self.widest_mm:.2f} mm"


def overhangs(mesh: Mesh) -> Overhangs:
    """Look for overhangs of a part printed as it lies, its lowest point on the bed.

    Args:
        mesh: A closed mesh.
    """
    corners = mesh.triangle_points
    normal = mesh.doubled_normals
    size = np.linalg.norm(normal, axis=1)
    down = -normal[:, 2] / np.maximum(size, 1e-300)
    above_bed = corners[:, :, 2].min(axis=1) > mesh.vertices[:, 2].min() + 1e-6
    # A cone or a slope may begin on the bed: only what lies flat on it is carried by it.
    flat = down > 1.0 - _FLAT
    slanted = (down > _FLAT) & ~flat
    ceiling = flat & above_bed
    steepest = float(np.degrees(np.arcsin(np.clip(down[slanted], 0.0, 1.0))).max(initial=0.0))
    return Overhangs(
        steepest_deg=steepest,
        ceiling_mm2=float(size[ceiling].sum() / 2.0),
        widest_mm=_widest_mm(mesh, ceiling),
    )


def _widest_mm(mesh: Mesh, ceiling: Bools) -> float:
    """Diameter of the largest circle in the ceilings: their outlines are moved inwards until nothing is left."""
    from manifold3d import CrossSection, FillRule, JoinType

    flat = mesh.triangle_points[ceiling][:, ::-1, :2]
    if len(flat) == 0:
        return 0.0
    outline = CrossSection(list(flat), FillRule.NonZero)
    low, high = 0.0, 1.0
    while not outline.offset(-high, JoinType.Miter).is_empty():
        low, high = high, 2.0 * high
    while high - low > _WIDTH_MM / 2.0:
        middle = (low + high) / 2.0
        empty = outline.offset(-middle, JoinType.Miter).is_empty()
        low, high = (low, middle) if empty else (middle, high)
    return 2.0 * low
