"""build123d: holder and jig as parts with joints, and assemblies.

With a specification ``spec`` of a holder::

    from housing.bd import HolderPart, JigPart
    from tacbench_cad.bd import TextureBlock

    holder, block, jig = HolderPart(spec), TextureBlock(spec.block), JigPart(Jig(holder=spec))
    holder.joints["slot 1"].connect_to(block.joints["underside"])
    holder.joints["jig"].connect_to(jig.joints["holder"])

Importing this module imports build123d.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from build123d import (
    Align,
    BasePartObject,
    BuildPart,
    Color,
    Compound,
    Location,
    Mode,
    RigidJoint,
    Rotation,
    RotationLike,
    Solid,
)

from housing.assembly import Assembly
from housing.fixture import Fixture
from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.bd import TextureBlock
from tacbench_cad.geometry.part import colour_of
from tacbench_cad.spec.block import Block


class _FixturePart(BasePartObject):  # type: ignore[misc]  # build123d is not typed for mypy
    """A fixture with a name, a colour and joints, in the holder frame."""

    _applies_to: ClassVar[list[str]] = [BuildPart._tag]

    def _make(
        self,
        fixture: Fixture,
        solid: Solid,
        joints: dict[str, Location],
        placing: tuple[RotationLike, Align | tuple[Align, Align, Align] | None, Mode],
    ) -> None:
        rotation, align, mode = placing
        # The copy is needed because the alignment changes the solid, and the fixture caches its shape.
        solid = solid.moved(Location())
        solid.label = fixture.name
        super().__init__(part=solid, rotation=rotation, align=align, mode=mode)
        self.color = Color(colour_of(fixture.kind))
        # After the alignment, the location of the solid is the location of the holder frame.
        frame = self.rotation * solid.location
        for label, place in joints.items():
            RigidJoint(label, self, frame * place)


class HolderPart(_FixturePart):
    """Part Object: Holder.

    A holder in its own frame. The attribute ``holder`` is its specification. It has these joints:

    - ``slot 1``, ``slot 2`` and so on, for the joint ``underside`` of a :class:`~tacbench_cad.bd.TextureBlock`. The
      block is then in the middle of its clearance.
    - ``jig``, for the joint ``holder`` of a :class:`JigPart`.

    Args:
        holder: The holder.
        rotation: The rotation about the axes, in degrees.
        align: Align MIN, CENTER or MAX of the bounding box along x, y and z; None keeps the holder frame.
        mode: The combination mode.
    """

    def __init__(
        self,
        holder: Holder,
        rotation: RotationLike = (0, 0, 0),
        align: Align | tuple[Align, Align, Align] | None = None,
        mode: Mode = Mode.ADD,
    ) -> None:
        self.holder = holder
        joints = {
            f"slot {number}": Location(place.origin_mm) * Rotation(0, 0, 90 * place.quarter_turns)
            for number, place in enumerate(holder.block_placements(), 1)
        }
        self._make(holder, Solid(holder.solid_as_printed), {**joints, "jig": Location()}, (rotation, align, mode))


class JigPart(_FixturePart):
    """Part Object: Jig.

    A jig on its holder, in the holder frame. The attribute ``jig`` is its specification. The joint ``holder`` is at the
    origin of the holder frame.

    Args:
        jig: The jig.
        rotation: The rotation about the axes, in degrees.
        align: Align MIN, CENTER or MAX of the bounding box along x, y and z; None keeps the holder frame.
        mode: The combination mode.
    """

    def __init__(
        self,
        jig: Jig,
        rotation: RotationLike = (0, 0, 0),
        align: Align | tuple[Align, Align, Align] | None = None,
        mode: Mode = Mode.ADD,
    ) -> None:
        self.jig = jig
        self._make(jig, Solid(jig.solid_in_use), {"holder": Location()}, (rotation, align, mode))


def assembled(
    holder: Holder,
    blocks: Sequence[Block] | None = None,
    jig: Jig | None = None,
) -> Compound:
    """Connect holder, blocks and jig by their joints, as one labelled compound in the holder frame.

    Args:
        holder: The holder.
        blocks: The blocks, one for each slot, beginning with the first slot; None for the holder's own block in every
            slot.
        jig: A jig made for this holder; None for an assembly without a jig.

    Raises:
        InputError: There are more blocks than slots, the sides, height or key of a block do not fit the holder, or the
            jig is for another holder.
    """
    together = Assembly.filled(holder, blocks, jig)  # raises InputError if the parts do not fit together
    base = HolderPart(holder)
    parts = [base]
    for number, block in enumerate(together.blocks, 1):
        parts.append(TextureBlock(block))
        base.joints[f"slot {number}"].connect_to(parts[-1].joints["underside"])
    if jig is not None:
        parts.append(JigPart(jig))
        base.joints["jig"].connect_to(parts[-1].joints["holder"])
    return Compound(label=together.name, children=parts)
