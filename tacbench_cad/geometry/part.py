"""Part: everything printable, with what it must satisfy. Blocks, holder, jig and coupon are Parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from tacbench_cad.geometry.mesh import Certificate, Mesh

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from tacbench_cad.spec.block import Block

Kind = Literal["block", "holder", "jig", "coupon"]

#: Colour of each kind of part where several are shown together, as 0xRRGGBB: told apart with any colour vision.
COLOURS: dict[Kind, int] = {"block": 0xE3B778, "holder": 0x8FA3B5, "jig": 0x7FB3A2, "coupon": 0xB9A7C9}


@dataclass(frozen=True, kw_only=True)
class ExpectedGeometry:
    """One representation of a part (its mesh or its solid) and what a reader of its file must find.

    Args:
        volume_mm3: Volume in closed form.
        volume_slack_mm3: How far the true volume of this representation may lie from it.
        certificate: What is proved of a block's top against its formula; None for a fixture.
        datum_mm: z of the formula's zero in this representation; None for a fixture.
    """

    volume_mm3: float
    volume_slack_mm3: float
    certificate: Certificate | None = None
    datum_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class Part:
    """Something to print.

    Args:
        name: Stem of its file names.
        kind: What it is.
        title: One line for people.
        size_mm: Bounding box x, y, z in mm; the lower corner lies at the origin.
        genus: Through holes (0 for a block).
        spec: Everything that went into it, as plain JSON values: for the manifest and the files' metadata.
        least_wall_mm: Thinnest wall, for a fixture; None for a block.
        block: The block itself where the part is one.
        make_mesh: Builds the mesh, and what is expected of a file that holds it.
        make_solid: The same for the Open CASCADE solid; None where there can be none.
        no_solid: Why there is no solid.
        mesh_needs_cad: Whether the mesh is made by the CAD kernel (fixtures).
    """

    name: str
    kind: Kind
    title: str
    size_mm: tuple[float, float, float]
    genus: int
    make_mesh: Callable[[], tuple[Mesh, ExpectedGeometry]]
    make_solid: Callable[[], tuple[TopoDS_Shape, ExpectedGeometry]] | None
    spec: Mapping[str, Any] = field(default_factory=dict)
    least_wall_mm: float | None = None
    block: Block | None = None
    no_solid: str | None = None
    mesh_needs_cad: bool = False

    @cached_property
    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """The mesh and what it must satisfy, built once."""
        return self.make_mesh()

    @cached_property
    def solid(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """The solid and what it must satisfy, built once.

        Raises:
            InputError: The part has none; the message says why.
        """
        if self.make_solid is None:
            from tacbench_cad.util.errors import InputError

            raise InputError("formats", "step", self.no_solid or "this part has no solid")
        return self.make_solid()
