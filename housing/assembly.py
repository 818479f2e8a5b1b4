"""The set put together: a holder, blocks in its slots and the jig on it, each where it is used."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.part import Part
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted
from tacbench_cad.util.types import Floats

#: Formats that an assembly is written in by ``tacbench make``.
ASSEMBLY_FORMATS = ("3mf", "step")


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """A holder with what belongs in it and on it, in the holder frame.

    Args:
        holder: The holder.
        blocks: A block for each slot, from the first on.
        jig: The jig, or None for none.

    Raises:
        InputError: There are more blocks than slots, a block does not go into the holder, or the jig is for another.
    """

    holder: Holder
    blocks: tuple[Block, ...]
    jig: Jig | None = None

    def __post_init__(self) -> None:
        if len(self.blocks) > self.holder.slots:
            raise InputError("blocks", len(self.blocks), f"the holder has {counted(self.holder.slots, 'slot')}")
        for block in self.blocks:
            if block.outline != self.holder.block.outline:
                raise InputError("blocks", block.name, f"does not go into {self.holder.name}")
        if self.jig is not None and self.jig.holder.name != self.holder.name:
            raise InputError("jig", self.jig.name, f"is not made for {self.holder.name}")

    @classmethod
    def filled(cls, holder: Holder, blocks: Sequence[Block] | None, jig: Jig | None) -> Assembly:
        """An assembly with a block in every slot: the holder's own where no blocks are given."""
        chosen = [holder.block] * holder.slots if blocks is None else blocks
        return cls(holder=holder, blocks=tuple(chosen), jig=jig)

    @property
    def name(self) -> str:
        """What it is called in its 3MF: ``assembly_paper_x1_slots6``."""
        return f"assembly_{self.holder.stem}"

    @property
    def title(self) -> str:
        """One line for people."""
        inside = ", ".join(block.texture.name for block in self.blocks)
        return f"Holder with {inside}" + (" and jig" if self.jig is not None else "")

    def part(self) -> Part:
        """All of it as one part, which can be exported as 3MF and STEP."""
        placed: list[tuple[Part, Floats]] = [(self.holder.part(), np.eye(4))]
        for block, place in zip(self.blocks, self.holder.block_placements(), strict=False):
            placed.append((block_part(block), place.matrix))
        if self.jig is not None:
            placed.append((self.jig.part(), self.jig.from_print))
        parts = [{"name": part.name, "kind": part.kind, "to_holder": matrix.tolist()} for part, matrix in placed]
        return Part.assembled(self.name, self.title, tuple(placed), {"frame": "holder", "parts": parts})


def assemblies_of(things: Iterable[Any]) -> tuple[list[Assembly], list[tuple[str, str]]]:
    """What some blocks and fixtures make together: an assembly for each holder.

    The blocks go in from the first slot on, in their order, the first copy of each before any second.

    Args:
        things: Blocks, holders, jigs, and others, which are passed over.

    Returns:
        The assemblies that have a block, and what did not find room, with the reason.
    """
    things = list(things)
    assemblies, over = [], []
    for holder in (thing for thing in things if isinstance(thing, Holder)):
        fitting = [one for one in things if isinstance(one, Block) and one.outline == holder.block.outline]
        fitting.sort(key=lambda block: block.copy or 1)
        jigs = (thing for thing in things if isinstance(thing, Jig) and thing.holder == holder)
        if not fitting:
            continue
        assembly = Assembly(holder=holder, blocks=tuple(fitting[: holder.slots]), jig=next(jigs, None))
        assemblies.append(assembly)
        if len(fitting) > holder.slots:
            what = f"{len(fitting) - holder.slots} of {len(fitting)} blocks in {assembly.name}"
            inside = ", ".join(block.texture.name for block in assembly.blocks)
            over.append((what, f"the holder has {counted(holder.slots, 'slot')}, for {inside}; --slots asks for more"))
    return assemblies, over
