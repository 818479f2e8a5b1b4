"""The base class of holder, jig and coupon: how it becomes a part, and how ``tacbench make`` requests it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

from housing.shapes import Bore
from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.geometry.solids import KERNEL_FRACTION, rounding_mm3, tessellate
from tacbench_cad.spec.block import Block
from tacbench_cad.util.text import mm, report

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid

#: The largest distance between the chords of a fixture's mesh and its circles, in mm.
CHORD_MM = 0.005
#: The number of decimals of a number in the manifest.
DECIMALS = 9


class Fixture(ABC):
    """A printed part that holds or marks blocks, or measures the fit. Subclasses are frozen dataclasses.

    Attributes:
        kind: The kind of the fixture, which is also its name in ``--parts``.
        options: The options of ``make`` that the fixture uses, as fields of a :class:`~tacbench_cad.Request`.
        asked_by: If one of these options is given and the blocks cannot have the fixture, ``make`` ends with an error.
            Otherwise it leaves out the fixture.
        by_default: Whether ``make`` without ``--parts`` makes the fixture.
        for_each_outline: Whether each outline among the blocks needs its own fixture, or all share one.
        reported: The values of :meth:`spec` that the dimension report shows.
    """

    kind: ClassVar[str]
    options: ClassVar[tuple[str, ...]] = ()
    asked_by: ClassVar[tuple[str, ...]] = ()
    by_default: ClassVar[bool] = True
    for_each_outline: ClassVar[bool] = True
    reported: ClassVar[tuple[str, ...]]

    @classmethod
    @abstractmethod
    def requested(cls, block: Block, options: Mapping[str, Any]) -> Self:
        """Return the fixture for a block.

        Args:
            block: The block. A fixture that fits all blocks ignores it.
            options: The options of the request, including options of other fixtures.

        Raises:
            InputError: The fixture cannot be made for this block.
        """

    @property
    @abstractmethod
    def name(self) -> str:
        """The stem of the file names."""

    @property
    @abstractmethod
    def title(self) -> str:
        """A description in one line."""

    @property
    @abstractmethod
    def size_mm(self) -> tuple[float, float, float]:
        """The size x, y, z of the bounding box in the orientation of the file, in mm."""

    @property
    @abstractmethod
    def walls_mm(self) -> Mapping[str, float]:
        """The name and the thickness of each wall, in mm."""

    @property
    @abstractmethod
    def volume_mm3(self) -> float:
        """The volume in closed form, in mm^3."""

    @property
    def drilled(self) -> tuple[tuple[Bore, float], ...]:
        """The through holes, each with the thickness of the drilled plate in mm."""
        return ()

    @property
    def recessed(self) -> tuple[tuple[Bore, float], ...]:
        """The round pockets that are no through holes, each with its depth in mm."""
        return ()

    @property
    def genus(self) -> int:
        """The number of through holes."""
        return len(self.drilled)

    @abstractmethod
    def spec(self) -> dict[str, Any]:
        """Return all values that define the fixture, and notes for the user, as plain JSON values.

        Numbers that belong together, such as the sides of a pocket, are a tuple; a list has any number of values.
        """

    def __str__(self) -> str:
        values = tidied(self.spec())
        rows = {name.removesuffix("_mm").replace("_", " "): _shown(name, values[name]) for name in self.reported}
        name, thickness = min(self.walls_mm.items(), key=lambda wall: wall[1])
        thinnest = f"{mm(thickness)} ({name})"
        return report(self.title, {"name": self.name, "size": mm(*self.size_mm), **rows, "thinnest wall": thinnest})

    @property
    @abstractmethod
    def solid_in_use(self) -> TopoDS_Solid:
        """The Open CASCADE solid in its place of use, in the holder frame. A coupon has the orientation of its file."""

    @property
    def solid_as_printed(self) -> TopoDS_Solid:
        """The Open CASCADE solid in the orientation of the file.

        The lower corner of the bounding box is at the origin, and the bed of the printer is at z = 0.
        """
        return self.solid_in_use

    @property
    def min_wall_mm(self) -> float:
        """The thickness of the thinnest wall, in mm."""
        return min(self.walls_mm.values())

    def part(self) -> PrintPart:
        """Return the fixture as a part of a print set."""
        return PrintPart(
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
        # The chords make the holes of the mesh smaller, so its volume may be larger than the exact volume.
        round_holes = (*self.drilled, *self.recessed)
        slack = sum(bore.chord_slack_mm3(depth, CHORD_MM) for bore, depth in round_holes) + rounding_mm3(self.size_mm)
        return tessellate(self.solid_as_printed, CHORD_MM), ExpectedGeometry(
            volume_mm3=self.volume_mm3, volume_slack_mm3=slack
        )

    def _solid(self) -> tuple[TopoDS_Solid, ExpectedGeometry]:
        expected = ExpectedGeometry(volume_mm3=self.volume_mm3, volume_slack_mm3=KERNEL_FRACTION * self.volume_mm3)
        return self.solid_as_printed, expected


def _shown(name: str, value: Any) -> str:
    """Write a value of :meth:`Fixture.spec` for the dimension report."""
    if isinstance(value, list) and value and isinstance(value[0], dict):  # round holes
        return f"{len(value)} of {mm(value[0]['diameter_mm'])}"
    if isinstance(value, list):
        return ", ".join(f"{item:g}" for item in value) + (" mm" if name.endswith("_mm") else "")
    if name.endswith("_mm") and value is not None:
        return mm(*value) if isinstance(value, tuple) else mm(value)
    return "none" if value is None else str(value)


def tidied(value: Any) -> Any:
    """Round all numbers to 1e-9, also in lists and tables: 7.470000000000001 becomes 7.47."""
    if isinstance(value, float):
        return round(value, DECIMALS)
    if isinstance(value, dict):
        return {key: tidied(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(tidied(item) for item in value)
    return value
