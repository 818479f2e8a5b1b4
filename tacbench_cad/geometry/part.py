"""Printable parts and the expected geometry of their files. Blocks, fixtures and assemblies are parts."""

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

#: The colours of kinds of parts as 0xRRGGBB. They can be distinguished with any colour vision.
COLOURS = {"block": 0xE3B778, "holder": 0x8FA3B5, "jig": 0x7FB3A2, "coupon": 0xB9A7C9}
#: The colour of all other kinds.
OTHER_COLOUR = 0xC9A58F
#: The fraction by which the volume of an assembly's mesh may differ, because its parts are rounded to float32 before
#: they are transformed.
_TRANSFORMED = 1e-6
_WORD = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]*")


def colour_of(kind: str) -> int:
    """Return the colour of a kind of part as 0xRRGGBB."""
    return COLOURS.get(kind, OTHER_COLOUR)


def rgb_of(kind: str) -> tuple[float, float, float]:
    """Return the colour of a kind of part as red, green and blue from 0 to 1 (sRGB)."""
    red, green, blue = ((colour_of(kind) >> shift & 0xFF) / 255.0 for shift in (16, 8, 0))
    return red, green, blue


@dataclass(frozen=True, kw_only=True)
class PrintPart:
    """A printable part.

    Args:
        name: The name of the part in its files.
        kind: The kind of part: ``block``, ``holder`` and so on, or a word of your own.
        title: A description for people, in one line.
        size_mm: The size of the bounding box along x, y and z, in mm.
        genus: The number of through holes (0 for a block).
        make_mesh: A function that builds the mesh and the expected geometry of a file that contains it.
        make_solid: The same for the Open CASCADE solid; None if the part has no solid.
        solid_name: The name in a STEP file; empty if it is the same as ``name``.
        spec: All input values of the part as plain JSON values, for the manifest and the metadata of files.
        min_wall_mm: The thickness of the thinnest wall of a fixture; None for a block.
        block: The block, if the part is a block.
        no_solid: The reason why the part has no solid.
        mesh_needs_cad: Whether the CAD kernel is needed to make the mesh.
        placed: The parts of an assembly, each with the matrix from its own frame to the assembly's frame, shape
            (4, 4), in mm.
        low_mm: The lower corner of the bounding box. It is the origin, except for files that keep the coordinates of a
            user's part.

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
    placed: tuple[tuple[PrintPart, Floats], ...] = ()
    low_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("name", "kind"):
            if not _WORD.fullmatch(getattr(self, name)):
                raise InputError(
                    f"part {name}",
                    getattr(self, name),
                    "must begin with a letter or digit; use only letters, digits, spaces and . _ + -",
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
    ) -> PrintPart:
        """Make a part from your own solid. All its faces must be planes, cylinders, cones or splines.

        A textured solid can also be made into a part again, but its files are then compared with the solid and not with
        the formula; :func:`tacbench_cad.textured` does both.

        In the files, the lower corner of the bounding box is at the origin. If you give the volume in closed form, the
        checks can also find an error in the solid. Without it, they only compare the files with the solid.

        Args:
            solid: A solid of CadQuery, build123d or Open CASCADE, in mm.
            name: The name of the part in its files.
            kind: The kind of part, a word of your own.
            title: A description for people, in one line.
            genus: The number of through holes.
            volume_mm3: The volume in closed form; None for the volume that the kernel measures.
            spec: The input values of the part, as plain JSON values.

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
    def assembled(
        cls, name: str, title: str, placed: tuple[tuple[PrintPart, Floats], ...], spec: Mapping[str, Any]
    ) -> PrintPart:
        """Combine parts into an assembly. Its 3MF file has several objects, and its STEP file has several products.

        Args:
            name: The name of the assembly.
            title: A description for people, in one line.
            placed: The parts, each with the matrix from its own frame to the assembly's frame, shape (4, 4), in mm.
            spec: The input values of the assembly, as plain JSON values.
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
        """Return the part's name in files with its ``mesh`` or its ``solid``."""
        return self.solid_name if shape == "solid" and self.solid_name else self.name

    def stem(self, shape: str) -> str:
        """Return a shortened form of this name for the file name."""
        return short_name(self.name_in(shape))

    @cached_property
    def mesh(self) -> tuple[Mesh, ExpectedGeometry]:
        """The mesh and the expected geometry of its file. They are built once."""
        return self.make_mesh()

    @cached_property
    def solid(self) -> tuple[TopoDS_Shape, ExpectedGeometry]:
        """The solid and the expected geometry of its file. They are built once.

        Raises:
            InputError: The part has no solid. The message states the reason.
        """
        if self.make_solid is None:
            raise InputError("formats", "step", self.no_solid or "this part has no solid")
        return self.make_solid()


def box_of(placed: tuple[tuple[PrintPart, Floats], ...]) -> tuple[Floats, Floats]:
    """Return the lower and the upper corner of the bounding box of some parts, shape (3,) each, in mm."""
    corners = np.array([m[:3, 3] + m[:3, :3] @ (np.array(part.size_mm) * end) for part, m in placed for end in (0, 1)])
    return corners.min(axis=0), corners.max(axis=0)
