"""The limits of a holder: the smallest key, the walls, and the blocks that fit into the authors' holder."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

from housing.fits import MIN_FLOOR_MM, ROUNDING_MM, clearance_mm, min_bearing_wall_mm, require_walls
from housing.layout import RELEASED
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import mm

if TYPE_CHECKING:
    from housing.holder import Holder

#: The smallest depth of a pocket that still holds a block, in mm.
MIN_DEPTH_MM = 1.0


def min_key_mm(fit: str | float = "slip") -> float:
    """Return the largest key with which a wrongly turned block still fits into the pocket.

    The pocket is the outline of the block, offset outwards by the clearance c. If the block is turned by 180 degrees, a
    full corner of the block is at the filled corner of the pocket. If the block is also pushed into the opposite corner
    of the pocket, it extends to ``x - y = X - 2 c``, and the pocket ends at ``X - K + sqrt(2) c``. So the block fits if
    the key is at most ``K = (2 + sqrt(2)) c``. A block that is tilted in its clearance does not fit better: to first
    order the tilt needs more room than it gains. If the sides of the block differ by no more than 2 c, it can also be
    turned by 90 degrees, and then the same bound holds.

    Args:
        fit: The name of a fit, or the clearance in mm per side.
    """
    return (2.0 + math.sqrt(2.0)) * clearance_mm(fit)


def require_key(block: Block, fit: str | float) -> None:
    """Check that a block with a key does not fit into its pocket when it is turned by 180 degrees.

    Raises:
        InputError: The key of the block is too small for the fit.
    """
    min_key = min_key_mm(fit)
    if block.key_mm is not None and block.key_mm <= min_key:
        raise InputError(
            "key",
            block.key_mm,
            f"must be above {min_key:.4g} mm and at most {min(block.size_mm) / 3.0:.4g} mm; with a smaller key, a "
            f"block turned by 180 degrees would still fit (clearance {clearance_mm(fit):g} mm per side)",
        )


def require_can_be_made(holder: Holder) -> None:
    """Check that the block, the walls and the key of a fitted holder are possible.

    Raises:
        InputError: One of them is not.
    """
    max_rim = holder.block.height_mm - MIN_DEPTH_MM
    if not 0.0 <= holder.rim_mm <= max_rim:
        height = holder.block.height_mm
        raise InputError(
            "rim",
            holder.rim_mm,
            f"must be from 0 to {max_rim:.4g} mm, so that the block, which is {height:.4g} mm high, has a pocket "
            f"of {MIN_DEPTH_MM:g} mm"
            if max_rim >= 0.0
            else f"the block is only {height:.4g} mm high, but a pocket is at least {MIN_DEPTH_MM:g} mm deep",
        )
    require_walls("floor", holder.floor_mm, {"floor": holder.floor_mm}, MIN_FLOOR_MM)
    min_wall = min_bearing_wall_mm(holder.nozzle_mm)
    walls = dict(holder.walls_mm)
    del walls["floor"]
    if "wall between pockets" in walls:
        require_walls("web", holder.web_mm, {"wall between pockets": walls.pop("wall between pockets")}, min_wall)
    ledge = {"ledge round the push-out hole": walls.pop("ledge round the push-out hole")}
    require_walls("size", mm(*holder.block.size_mm), ledge, min_wall)
    require_walls("margin", holder.margin_mm, walls, min_wall)
    if holder.block.key_mm is not None:
        require_key(holder.block, holder.fit)


def require_fits_released(holder: Holder) -> None:
    """Check that the authors' holder is unchanged, and that the block fits into it.

    Raises:
        InputError: It was changed, or the block does not fit.
    """
    for field in fields(holder):
        if field.name in ("fit", "rim_mm", "slots", "floor_mm", "margin_mm", "web_mm"):
            value = getattr(holder, field.name)
            if value != field.default:
                name = field.name.removesuffix("_mm")
                raise InputError(name, value, "the authors' holder cannot be changed; use the preset fitted")
    if holder.block.key_mm is not None:
        raise InputError("key", holder.block.key_mm, "the authors' holder has no key; use the preset fitted")
    if holder.block.outline is not None:
        allowed = "does not fit the authors' holder; use the preset fitted"
        raise InputError("outline", str(holder.block.outline), allowed)
    room, sides = RELEASED.pocket_mm[:2], holder.footprint_mm
    if any(not -ROUNDING_MM <= room[i] - sides[i] <= 2.0 for i in (0, 1)):
        raise InputError(
            "size",
            mm(*sides),
            f"the pocket of the authors' holder is {mm(*room)}, and the sides of a block may be at most 2 mm "
            "smaller; use the preset fitted for other blocks",
        )
    if not MIN_DEPTH_MM <= RELEASED.pocket_mm[2] <= holder.block.height_mm:
        raise InputError(
            "height", holder.block.height_mm, f"must be at least {RELEASED.pocket_mm[2]:g} mm for the authors' holder"
        )
