"""How far the sensor goes at a block, and whether the stage can go there: one rule for teaching and for pressing."""

from __future__ import annotations

from collections.abc import Sequence

from tacbench_cad.lab.rig.stage import Limits
from tacbench_cad.lab.study.spec import HolderRim, Protocol, WorkFrame
from tacbench_cad.util.errors import InputError


def travel_height_mm(protocol: Protocol, holder: HolderRim) -> float:
    """Height of travel in the work frame: the clearance above the highest of block and rim."""
    return protocol.clearance_mm + max(0.0, -holder.rim_mm)


def require_reach(protocol: Protocol, holder: HolderRim, frames: Sequence[WorkFrame], limits_mm: Limits) -> None:
    """Refuse a protocol that would send the stage beyond its limits, before anything moves.

    Args:
        protocol: Its grid, clearance and depth limit.
        holder: The rim that is travelled over.
        frames: The work frame of each slot that is used.
        limits_mm: Lowest and highest x, y, z of the stage.

    Raises:
        InputError: A place lies beyond a limit; the message has slot, axis and numbers.
    """
    heights = (-protocol.depth_limit_mm, travel_height_mm(protocol, holder))
    for slot, frame in enumerate(frames, start=1):
        places = [frame.to_stage((float(x), float(y), z)) for x, y in protocol.grid.positions_mm for z in heights]
        for axis, (low, high) in enumerate(limits_mm):
            lowest, highest = min(place[axis] for place in places), max(place[axis] for place in places)
            if not (low <= lowest and highest <= high):
                raise InputError(
                    f"[stage] limits_mm {'xyz'[axis]}",
                    [low, high],
                    f"slot {slot} needs {lowest:.3f} to {highest:.3f} mm (positions, clearance and depth limit)",
                )
