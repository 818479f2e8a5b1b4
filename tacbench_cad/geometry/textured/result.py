"""A part with textures on its faces: its solid and mesh, and how near they are to the formula."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tacbench_cad.geometry.mesh import Certificate, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.geometry.textured.height import Height

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape


@dataclass(frozen=True, kw_only=True, eq=False)
class Textured:
    """A part with textures on its faces. ``export`` and ``check`` take it as it is.

    Args:
        printed: The part for its files, which keep the coordinates of the part.
        heights: The heights of the texture above the areas of its faces.
        certificate: The bounds of the distance of the solid from the formula, or of the mesh if the part is a mesh.
        volume_mm3: The expected volume: that of the part before, plus the integral of the formula.
        bodies: The number of separate surfaces of a mesh, as before.
    """

    printed: PrintPart
    heights: tuple[Height, ...]
    certificate: Certificate
    volume_mm3: float
    bodies: int = 1

    def part(self) -> PrintPart:
        """Return the part for its files."""
        return self.printed

    @property
    def solid(self) -> TopoDS_Shape:
        """The solid of the CAD kernel.

        Raises:
            InputError: The part is a mesh.
        """
        return self.printed.solid[0]

    @property
    def mesh(self) -> Mesh:
        """The closed mesh."""
        return self.printed.mesh[0]

    def as_dict(self) -> dict[str, Any]:
        """Return the facts about the largest area as plain JSON values."""
        height = max(self.heights, key=lambda height: height.area.size_mm)
        radius = height.area.frame.radius_mm
        return {
            "region": "plane" if radius is None else "cylinder",
            "radius_mm": radius,
            "size_mm": list(height.area.size_mm),
            "depth_mm": self.depth_mm,
            "texture": height.texturing.texture.name,
            "bodies": self.bodies,
            "expected_volume_mm3": self.volume_mm3,
            "error_mm": self.certificate.distance_mm,
            "evidence": self.certificate.evidence,
            "mm_per_unit": list(height.mm_per_unit),
            "periods": height.periods,
        }

    @property
    def depth_mm(self) -> float:
        """The largest peak-to-peak height of the texture."""
        return max(height.depth_mm for height in self.heights)

    def lines(self) -> list[str]:
        """Return a line about each area for people."""
        return [_line(height) for height in self.heights]


def _line(height: Height) -> str:
    radius, (s, t) = height.area.frame.radius_mm, height.area.size_mm
    region = "plane" if radius is None else f"cylinder of radius {radius:.5g} mm"
    closing = ""
    if height.periods is not None:
        stretch = height.mm_per_unit[0] / height.texturing.unit_mm[0] - 1.0
        closing = f", {height.periods} periods around it, stretched by {100.0 * stretch:+.2g} % to close"
    name = height.texturing.texture.name
    return f"{name} on a {region}, {s:.4g} x {t:.4g} mm, {height.depth_mm:.4g} mm high{closing}"
