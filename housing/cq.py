"""CadQuery: holder, jig and coupon as solids and in method chains, and assemblies.

A block in its holder, with the jig on it::

    from housing import Holder, Jig
    from housing.cq import assembled
    from tacbench_cad import Block

    holder = Holder(block=Block.of(2, key_mm=3.0))
    whole = assembled(holder, jig=Jig(holder=holder))

After ``housing.cq.register()`` you can also write ``cq.Workplane().fixture(holder)``. The module for build123d is
:mod:`housing.bd`.

Importing this module imports CadQuery.
"""

from __future__ import annotations

from collections.abc import Sequence

import cadquery as cq

from housing.assembly import Assembly
from housing.fixture import Fixture
from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.cq import solid as block_solid
from tacbench_cad.geometry.part import rgb_of
from tacbench_cad.spec.block import Block


def solid(fixture: Fixture, *, as_printed: bool = False) -> cq.Solid:
    """Return a holder, jig or coupon as a CadQuery solid in its place of use. A jig is on its holder.

    Args:
        fixture: The fixture.
        as_printed: Whether a jig has the orientation of its file: upside down, with the lower corner of its bounding
            box at the origin.
    """
    result = cq.Solid(fixture.solid_as_printed if as_printed else fixture.solid_in_use)
    result.label = fixture.name
    return result


def workplane(fixture: Fixture, *, as_printed: bool = False) -> cq.Workplane:
    """Return a fixture as a Workplane, for example for ``workplane(holder).faces(">Z").edges().chamfer(0.3)``.

    The arguments are the same as for :func:`solid`.
    """
    return cq.Workplane(solid(fixture, as_printed=as_printed))


def assembled(holder: Holder, blocks: Sequence[Block] | None = None, jig: Jig | None = None) -> cq.Assembly:
    """Return holder, blocks and jig in their places of use, with names and colours, in the holder frame.

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
    whole = cq.Assembly(name=together.name)
    whole.add(solid(holder), name=holder.name, color=_colour(holder.kind))
    for number, (block, place) in enumerate(zip(together.blocks, holder.block_placements(), strict=False), 1):
        at = cq.Location(place.origin_mm, (0.0, 0.0, 1.0), 90.0 * place.quarter_turns)
        whole.add(block_solid(block), loc=at, name=f"{block.name} in slot {number}", color=_colour("block"))
    if jig is not None:
        whole.add(solid(jig), name=jig.name, color=_colour(jig.kind))
    return whole


def _colour(kind: str) -> cq.Color:
    return cq.Color(*rgb_of(kind))


def register() -> None:
    """Add ``Workplane.fixture(fixture, combine=True, clean=True)`` to CadQuery.

    The method adds a holder, jig or coupon at every point of the stack, aligned with the axes of the workplane, like
    ``Workplane.box``.
    """

    def fixture_method(
        self: cq.Workplane, fixture: Fixture, combine: bool | str = True, clean: bool = True
    ) -> cq.Workplane:
        """Add a fixture at every point of the stack. The origin of its frame is at the point."""
        return self.eachpoint(solid(fixture).moved, True, combine, clean)

    cq.Workplane.fixture = fixture_method
