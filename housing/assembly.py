"""Assemblies: a holder with blocks in its slots and a jig on top, each in its place of use."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.part import PrintPart
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted
from tacbench_cad.util.types import Floats

#: The file formats of assemblies that ``tacbench make`` can write.
ASSEMBLY_FORMATS = ("3mf", "step")


@dataclass(frozen=True, kw_only=True)
class Assembly:
    """A holder with blocks in its slots and, if given, a jig on top, in the holder frame.

    Args:
        holder: The holder.
        blocks: The blocks, one for each slot, beginning with the first slot.
        jig: The jig, or None for an assembly without a jig.

    Raises:
        InputError: There are more blocks than slots, a block does not fit the holder, or the jig is for another holder.
    """

    holder: Holder
    blocks: tuple[Block, ...]
    jig: Jig | None = None

    def __post_init__(self) -> None:
        if len(self.blocks) > self.holder.slots:
            raise InputError("blocks", len(self.blocks), f"the holder has only {counted(self.holder.slots, 'slot')}")
        for block in self.blocks:
            if block.silhouette != self.holder.block.silhouette:
                raise InputError("blocks", block.name, f"does not fit into {self.holder.name}")
        if self.jig is not None and self.jig.holder.name != self.holder.name:
            raise InputError("jig", self.jig.name, f"does not fit onto {self.holder.name}")

    @classmethod
    def filled(cls, holder: Holder, blocks: Sequence[Block] | None, jig: Jig | None) -> Assembly:
        """Make an assembly with the given blocks. Without blocks, every slot contains the block of the holder."""
        chosen = [holder.block] * holder.slots if blocks is None else blocks
        return cls(holder=holder, blocks=tuple(chosen), jig=jig)

    @property
    def name(self) -> str:
        """The stem of the file names and the name in the 3MF file: ``assembly_paper_x1_slots6``."""
        return f"assembly_{self.holder.stem}"

    @property
    def title(self) -> str:
        """A description in one line."""
        inside = ", ".join(block.texture.name for block in self.blocks)
        return f"Holder with {inside}" + (" and jig" if self.jig is not None else "")

    def part(self) -> PrintPart:
        """Return the assembly as one part, which can be exported as 3MF and STEP."""
        placed: list[tuple[PrintPart, Floats]] = [(self.holder.part(), np.eye(4))]
        for block, place in zip(self.blocks, self.holder.block_placements(), strict=False):
            placed.append((block_part(block), place.matrix))
        if self.jig is not None:
            placed.append((self.jig.part(), self.jig.from_print))
        parts = [{"name": part.name, "kind": part.kind, "to_holder": matrix.tolist()} for part, matrix in placed]
        return PrintPart.assembled(self.name, self.title, tuple(placed), {"frame": "holder", "parts": parts})


def assemblies_of(things: Iterable[Any]) -> tuple[list[Assembly], list[tuple[str, str]]]:
    """Make an assembly for each holder from some blocks and fixtures.

    The blocks fill the slots in their order, beginning with the first slot. The first copies of all blocks come before
    any second copy.

    Args:
        things: Blocks, holders and jigs. Other objects are ignored.

    Returns:
        The assemblies that contain a block, and a description of the blocks without a slot, with the reason.
    """
    things = list(things)
    assemblies, over = [], []
    for holder in (thing for thing in things if isinstance(thing, Holder)):
        fitting = [
            thing for thing in things if isinstance(thing, Block) and thing.silhouette == holder.block.silhouette
        ]
        fitting.sort(key=lambda block: block.copy or 1)
        jigs = (thing for thing in things if isinstance(thing, Jig) and thing.holder == holder)
        if not fitting:
            continue
        assembly = Assembly(holder=holder, blocks=tuple(fitting[: holder.slots]), jig=next(jigs, None))
        assemblies.append(assembly)
        if len(fitting) > holder.slots:
            what = f"{len(fitting) - holder.slots} of {len(fitting)} blocks in {assembly.name}"
            inside = ", ".join(block.texture.name for block in assembly.blocks)
            reason = f"the holder has only {counted(holder.slots, 'slot')}, used by {inside}; use --slots for more"
            over.append((what, reason))
    return assemblies, over
