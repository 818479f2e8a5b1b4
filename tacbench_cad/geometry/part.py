"""Part: everything printable, with what is expected of its files. Blocks, fixtures and assemblies are Parts."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tacbench_cad.geometry.mesh import ExpectedGeometry, Mesh
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import short_name

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Shape

    from tacbench_cad.spec.block import Block
    from tacbench_cad.util.types import Floats

#: Colours of the kinds where several parts are shown together, as 0xRRGGBB, distinct with any colour vision.
COLOURS = {"block": 0xE3B778, "holder": 0x8FA3B5, "jig": 0x7FB3A2, "coupon": 0xB9A7C9}
#: Colour of every other kind.
OTHER_COLOUR = 0xC9A58F
#: An assembly's mesh is transformed after it was rounded to float32: its volume may differ by this fraction.
_TRANSFORMED = 1e-6
_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]*")


def colour_of(kind: str) -> int:
    """Colour of a kind of part, as 0xRRGGBB."""
    return COLOURS.get(kind, OTHER_COLOUR)


def rgb_of(kind: str) -> tuple[float, float, float]:
    """Colour of a kind of part, as red, green and blue from 0 to 1 (sRGB)."""
    red, green, blue = ((colour_of(kind) >> shift & 0xFF) / 255.0 for shift in (16, 8, 0))
    return red, green, blue


@dataclass(frozen=True, kw_only=True)
class Part:
    """Something to print.

    Args:
        name: What it is called in its files.
        kind: What it is: ``block``, ``holder`` and so on, or a word of your own.
        title: One line for people.
        size_mm: Bounding box x, y, z in mm; the lower corner lies at the origin.
        genus: Through holes (0 for a block).
        make_mesh: Builds the mesh, and what is expected of a file that holds it.
        make_solid: The same for the Open CASCADE solid; None where there can be none.
        solid_name: What it is called in a STEP file; empty where that is the same.
        spec: Everything that went into it, as plain JSON values: for the manifest and the files' metadata.
        min_wall_mm: Thinnest wall, for a fixture; None for a block.
        block: The block itself where the part is one.
        no_solid: Why there is no solid.
        mesh_needs_cad: Whether the mesh is made by the CAD kernel.
        placed: The parts of an assembly, each with the matrix (4, 4) from its own frame to the assembly's, in mm.

    Raises:
        InputError: The name or the kind is not allowed.
    """

    name: str
    kind: str
    title: str
    size_mm: tuple[float, float, float]
    genus: int
    make_mesh: Callable[[], tuple[Mesh, ExpectedGeometry]]
    make_solid: Callable[[], tuple[TopoDS_Shape, ExpectedGeometry]] | None
    solid_name: str = ""
    spec: Mapping[str, Any] = field(default_factory=dict)
    min_wall_mm: float | None = None
    block: Block | None = None
    no_solid: str | None = None
    mesh_needs_cad: bool = False
    placed: tuple[tuple[Part, Floats], ...] = ()

    def __post_init__(self) -> None:
        for name in ("name", "kind"):
            if not _WORD.fullmatch(getattr(self, name)):
                raise InputError(
                    f"part {name}", getattr(self, name), "use letters, digits, and after the first . _ + - and blanks"
                )

    @classmethod
    def of_solid(
        cls,
        solid: Any,
        *,
        name: str,
        kind: str = "part",
        title: str = "",
        genus: int = 0,
        volume_mm3: float | None = None,
        spec: Mapping[str, Any] | None = None,
    ) -> Part:
        """A part of your own, from a solid whose faces are planes, cylinders and cones.

        Its files hold the solid with the lower corner of its box at the origin. Give the volume in closed form: the
        checks then find a solid that came out wrong; without it they compare the files with the solid alone.

        Args:
            solid: A solid of CadQuery, build123d or Open CASCADE, in mm.
            name: What it is called in its files.
            kind: What it is, a word of your own.
            title: One line for people.
            genus: Number of its through holes.
            volume_mm3: Its volume in closed form; None for what the kernel measures.
            spec: What went into it, as plain JSON values.

        Raises:
            InputError: The solid has another kind of face, or an argument is not allowed.
        """
        from tacbench_cad.geometry.solids import SimpleSolid

        simple = SimpleSolid.of(solid, volume_mm3)
        return cls(
            name=name,
            kind=kind,
            title=title or name,
            size_mm=simple.size_mm,
            genus=genus,
            make_mesh=simple.mesh,
            make_solid=simple.solid,
            spec=spec or {},
            mesh_needs_cad=True,
        )

    @classmethod
    def assembled(cls, name: str, title: str, placed: tuple[tuple[Part, Floats], ...], spec: Mapping[str, Any]) -> Part:
        """Parts at their places as one part: a 3MF of several objects, a STEP file of several products.

        Args:
            name: What it is called.
            title: One line for people.
            placed: The parts, each with the matrix (4, 4) from its own frame to the assembly's, in mm.
            spec: What went into it, as plain JSON values.
        """

        def make_mesh() -> tuple[Mesh, ExpectedGeometry]:
            built = [(*part.mesh, matrix) for part, matrix in placed]
            volume = sum(expected.volume_mm3 for _, expected, _ in built)
            slack = _TRANSFORMED * volume + sum(expected.volume_slack_mm3 for _, expected, _ in built)
            mesh = Mesh.joined([mesh.transformed(matrix) for mesh, _, matrix in built])
            return mesh, ExpectedGeometry(volume_mm3=volume, volume_slack_mm3=slack)

        def make_solid() -> tuple[TopoDS_Shape, ExpectedGeometry]:
            from tacbench_cad.geometry.solids import compound

            built = [(*part.solid, matrix) for part, matrix in placed]
            volume = sum(expected.volume_mm3 for _, expected, _ in built)
            slack = sum(expected.volume_slack_mm3 for _, expected, _ in built)
            shape = compound([(solid, matrix) for solid, _, matrix in built])
            return shape, ExpectedGeometry(volume_mm3=volume, volume_slack_mm3=slack)

        low, high = box_of(placed)
        x, y, z = (high - low).tolist()
        refusal = next((part.no_solid for part, _ in placed if part.make_solid is None), None)
        return cls(
            name=name,
            kind="assembly",
            title=title,
            size_mm=(x, y, z),
            genus=sum(part.genus for part, _ in placed),
            make_mesh=make_mesh,
            make_solid=make_solid if refusal is None else None,
            spec=spec,
            no_solid=refusal,
            mesh_needs_cad=any(part.mesh_needs_cad for part, _ in placed),
            placed=placed,
        )

    def name_in(self, shape: str) -> str:
        """What it is called in files that hold its ``mesh`` or its ``solid``."""
        return self.solid_name if shape == "solid" and self.solid_name else self.name

    def stem(self, shape: str) -> str:
        """The same, made short, for the name of the file."""
        return short_name(self.name_in(shape))

    @cached_property
    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """The mesh and what is expected of its file, built once."""
        return self.make_mesh()

    @cached_property
    def solid(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """The solid and what is expected of its file, built once.

        Raises:
            InputError: The part has none; the message says why.
        """
        if self.make_solid is None:
            raise InputError("formats", "step", self.no_solid or "this part has no solid")
        return self.make_solid()


def box_of(placed: tuple[tuple[Part, Floats], ...]) -> tuple[Floats, Floats]:
    """Lower and upper corner of placed parts together, from their sizes; each (3,), in mm."""
    corners = np.array([m[:3, 3] + m[:3, :3] @ (np.array(part.size_mm) * end) for part, m in placed for end in (0, 1)])
    return corners.min(axis=0), corners.max(axis=0)
