"""What holder, jig and coupon have in common: how a Part is made of one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.part import ExpectedGeometry, Kind, Part

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid

#: Distance by which the chords of a fixture's mesh may miss its circles, in mm.
CHORD_MM = 0.005
#: Share of the volume that the kernel may differ by: rounding.
KERNEL_SHARE = 1e-8
#: Decimals of a mm that a manifest gets; what follows is rounding.
DECIMALS = 9


class Fixture(ABC):
    """Something printed that holds, marks or gauges. Subclasses are frozen dataclasses."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Stem of the file names."""

    @property
    @abstractmethod
    def title(self) -> str:
        """One line for people."""

    @property
    @abstractmethod
    def kind(self) -> Kind:
        """What it is."""

    @property
    @abstractmethod
    def size_mm(self) -> tuple[float, float, float]:
        """Bounding box x, y, z in mm, as printed."""

    @property
    @abstractmethod
    def genus(self) -> int:
        """Number of through holes."""

    @property
    @abstractmethod
    def walls_mm(self) -> Mapping[str, float]:
        """What each wall is, and its thickness in mm."""

    @property
    @abstractmethod
    def volume_mm3(self) -> float:
        """Volume in closed form, in mm^3."""

    @abstractmethod
    def chord_slack_mm3(self, deflection_mm: float) -> float:
        """How much a mesh's volume may exceed the true one because chords cut circles short, in mm^3."""

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Everything that went into it, and what a user must know, as plain JSON values."""

    @abstractmethod
    def solid(self) -> TopoDS_Solid:
        """The Open CASCADE solid as printed: lower corner of its box at the origin, bed at z = 0."""

    @property
    def least_wall_mm(self) -> float:
        """Thickness of the thinnest wall, in mm."""
        return min(self.walls_mm.values())

    def part(self) -> Part:
        """The fixture as a part of a print set."""
        return Part(
            name=self.name,
            kind=self.kind,
            title=self.title,
            size_mm=tidied(self.size_mm),
            genus=self.genus,
            make_mesh=self._mesh,
            make_solid=self._solid,
            spec=tidied(self.spec()),
            least_wall_mm=self.least_wall_mm,
            mesh_needs_cad=True,
        )

    def _mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        from housing.tessellate import tessellate

        x, y, z = self.size_mm
        # Rounding to float32 moves a vertex by 2^-24 of its coordinate at most; faces inside add to the box's own.
        rounding = 6.0 * (x * y + y * z + z * x) * max(x, y, z) * 2.0**-24
        slack = self.chord_slack_mm3(CHORD_MM) + rounding
        return tessellate(self.solid(), CHORD_MM), ExpectedGeometry(volume_mm3=self.volume_mm3, volume_slack_mm3=slack)

    def _solid(self) -> tuple[TopoDS_Solid, ExpectedGeometry]:
        expected = ExpectedGeometry(volume_mm3=self.volume_mm3, volume_slack_mm3=KERNEL_SHARE * self.volume_mm3)
        return self.solid(), expected


def tidied(value: Any) -> Any:
    """The same with every number rounded to 1e-9, inside of lists and tables too: 7.47, not 7.470000000000001."""
    if isinstance(value, float):
        return round(value, DECIMALS)
    if isinstance(value, dict):
        return {key: tidied(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(tidied(one) for one in value)
    return value
