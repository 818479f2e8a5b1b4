"""The presses of a block, in the order in which they are made."""

from __future__ import annotations

import hashlib
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

from tacbench_cad.lab.study.spec import PlannedBlock, Protocol, Study

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Press:
    """One press of a block.

    Args:
        number: The number in the plan, from 1. The frame is stored as ``image_<number>``.
        force_level: The force level, from 1; a higher level has a higher force.
        repeat: The repeat, from 1.
        position: The position, from 1, row by row from the lowest y, and from the lowest x within a row.
        x_mm: The x of the sensor's summit in the block frame.
        y_mm: The y of the sensor's summit in the block frame.
        target_n: The target force; None in depth mode.
        band_n: The half width of the band around the target force; None in depth mode.
        depth_mm: The target depth below the first contact; None in force mode.
    """

    number: int
    force_level: int
    repeat: int
    position: int
    x_mm: float
    y_mm: float
    target_n: float | None
    band_n: float | None
    depth_mm: float | None


def plan_presses(protocol: Protocol, levels: Sequence[int], block_name: str) -> tuple[Press, ...]:
    """Return the presses of a block: all positions, for each repeat of each force.

    Args:
        protocol: The protocol.
        levels: The force levels, in increasing order.
        block_name: The name of the run. A random order is different for each block, force and repeat.

    Returns:
        ``len(levels) * repeats * positions`` presses, numbered from 1.
    """
    places = [
        (number, float(x), float(y)) for number, (x, y) in enumerate(protocol.positions.grid.positions_mm, start=1)
    ]
    presses: list[Press] = []
    for level in levels:
        for repeat in range(1, protocol.repeats + 1):
            order = places
            if protocol.positions.order == "random":
                order = shuffled(places, protocol.positions.seed, f"{block_name} {level} {repeat}")
            for position, x, y in order:
                force = protocol.targets.contact == "force"
                presses.append(
                    Press(
                        number=len(presses) + 1,
                        force_level=level,
                        repeat=repeat,
                        position=position,
                        x_mm=x,
                        y_mm=y,
                        target_n=protocol.targets.forces_n[level - 1] if force else None,
                        band_n=protocol.targets.bands_n[level - 1] if force else None,
                        depth_mm=None if force else protocol.targets.depths_mm[level - 1],
                    )
                )
    return tuple(presses)


def block_order(study: Study) -> tuple[PlannedBlock, ...]:
    """Return the study's blocks in the order in which they are put into the rig."""
    if study.protocol.positions.block_order == "paper":
        return study.blocks
    return tuple(shuffled(study.blocks, study.protocol.positions.seed, "blocks"))


def shuffled(items: Sequence[T], seed: int, what: str) -> list[T]:
    """Return the items in a random order that depends only on ``seed`` and ``what``, not on the machine."""
    digest = hashlib.sha256(f"{seed} {what}".encode()).digest()
    order = list(items)
    random.Random(int.from_bytes(digest, "big")).shuffle(order)
    return order
