"""What holder, jig and coupon have in common: how a Part is made of one, and how ``tacbench make`` asks for it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

from housing.shapes import Bore
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.part import Part
from tacbench_cad.geometry.solids import KERNEL_FRACTION, rounding_mm3, tessellate
from tacbench_cad.spec.block import Block
from tacbench_cad.util.text import mm, report

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid

#: Distance by which the chords of a fixture's mesh may miss its circles, in mm.
CHORD_MM = 0.005
#: Decimals of a mm that a manifest gets; what follows is rounding.
DECIMALS = 9


class Fixture(ABC):
    """Something printed that holds, marks or gauges. Subclasses are frozen dataclasses.

    Attributes:
        kind: What it is, which is also its word in ``--parts``.
        options: Options of ``make`` that it takes, as fields of a :class:`~tacbench_cad.Request`.
        asked_by: Options with which it is refused, and not left out, where the blocks cannot have it.
        by_default: Whether it is made without ``--parts``.
        for_each_outline: Whether there is one for each outline among the blocks, or one for all.
    """

    kind: ClassVar[str]
    options: ClassVar[tuple[str, ...]] = ()
    asked_by: ClassVar[tuple[str, ...]] = ()
    by_default: ClassVar[bool] = True
    for_each_outline: ClassVar[bool] = True

    @classmethod
    @abstractmethod
    def requested(cls, block: Block, options: Mapping[str, Any]) -> Self:
        """The one that belongs to a block.

        Args:
            block: The block; a fixture that fits all passes it over.
            options: What was asked for; options of other fixtures are among them.

        Raises:
            InputError: This block cannot have it.
        """

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
    def size_mm(self) -> tuple[float, float, float]:
        """Bounding box x, y, z in mm, as printed."""

    @property
    @abstractmethod
    def walls_mm(self) -> Mapping[str, float]:
        """What each wall is, and its thickness in mm."""

    @property
    @abstractmethod
    def volume_mm3(self) -> float:
        """Volume in closed form, in mm^3."""

    @property
    def drilled(self) -> tuple[tuple[Bore, float], ...]:
        """The through holes, each with the thickness in mm of what it goes through."""
        return ()

    @property
    def genus(self) -> int:
        """Number of through holes."""
        return len(self.drilled)

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Everything that went into it, and what a user must know, as plain JSON values."""

    @abstractmethod
    def facts(self) -> dict[str, str]:
        """The lines of the dimension report, without the name."""

    def __str__(self) -> str:
        return report(self.title, {"name": self.name, **self.facts()})

    @property
    @abstractmethod
    def shape(self) -> Any:
        """The build123d solid where it is used, in the holder frame; without one, as printed."""

    def solid_in_use(self) -> TopoDS_Solid:
        """The Open CASCADE solid where it is used, in the holder frame; without one, as printed."""
        return self.shape.wrapped

    def solid(self) -> TopoDS_Solid:
        """The Open CASCADE solid as printed: lower corner of its box at the origin, bed at z = 0."""
        return self.solid_in_use()

    @property
    def min_wall_mm(self) -> float:
        """Thickness of the thinnest wall, in mm."""
        return min(self.walls_mm.values())

    @property
    def _thinnest(self) -> str:
        """The thinnest wall and which it is."""
        name, thickness = min(self.walls_mm.items(), key=lambda wall: wall[1])
        return f"{mm(thickness)} ({name})"

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
            min_wall_mm=self.min_wall_mm,
            mesh_needs_cad=True,
        )

    def _mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        # Chords cut circles short, so that the mesh's volume may exceed the true one.
        slack = sum(bore.chord_slack_mm3(depth, CHORD_MM) for bore, depth in self.drilled) + rounding_mm3(self.size_mm)
        return tessellate(self.solid(), CHORD_MM), ExpectedGeometry(volume_mm3=self.volume_mm3, volume_slack_mm3=slack)

    def _solid(self) -> tuple[TopoDS_Solid, ExpectedGeometry]:
        expected = ExpectedGeometry(volume_mm3=self.volume_mm3, volume_slack_mm3=KERNEL_FRACTION * self.volume_mm3)
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
