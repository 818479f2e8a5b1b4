"""The space that the sensor needs around a block, and a check of the stage's limits, for teaching and for pressing."""

from __future__ import annotations

from collections.abc import Sequence

from tacbench_cad.lab.rig.stage import Limits
from tacbench_cad.lab.study.spec import HolderRim, Protocol, WorkFrame
from tacbench_cad.util.errors import InputError


def travel_height_mm(protocol: Protocol, holder: HolderRim) -> float:
    """Return the height of travel in the work frame: the clearance above the block and the rim, in mm."""
    return protocol.clearance_mm + max(0.0, -holder.rim_mm)


def require_reach(protocol: Protocol, holder: HolderRim, frames: Sequence[WorkFrame], limits_mm: Limits) -> None:
    """Check before any motion that a protocol stays within the stage's limits.

    Args:
        protocol: The protocol with grid, clearance and depth limit.
        holder: The rim of the holder, over which the sensor travels.
        frames: The work frame of each used slot.
        limits_mm: The stage's lowest and highest x, y, z.

    Raises:
        InputError: A position is beyond a limit. The message has slot, axis and numbers.
    """
    heights = (-protocol.depth_limit_mm, travel_height_mm(protocol, holder))
    for slot, frame in enumerate(frames, start=1):
        points = protocol.path_mm().reshape(-1, 2)
        places = [frame.to_stage((float(x), float(y), z)) for x, y in points for z in heights]
        for axis, (low, high) in enumerate(limits_mm):
            lowest, highest = min(place[axis] for place in places), max(place[axis] for place in places)
            if not (low <= lowest and highest <= high):
                raise InputError(
                    f"[stage] limits_mm {'xyz'[axis]}",
                    [low, high],
                    f"slot {slot} needs {lowest:.3f} to {highest:.3f} mm "
                    "(positions, motions, clearance and depth limit)",
                )
