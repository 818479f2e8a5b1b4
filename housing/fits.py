"""Named fits, and the thinnest walls that a printer prints reliably."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tacbench_cad.spec import fits
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.fits import clearance_mm as clearance_mm
from tacbench_cad.util.errors import InputError, require_between

#: The clearances of the named fits, in mm per side.
FITS = fits.FITS

#: The smallest thickness of the floor below a pocket, in mm.
MIN_FLOOR_MM = 1.2
#: The smallest thickness of a wall that carries a load, in mm. It must also have at least two nozzle widths.
MIN_WALL_MM = 1.6
#: The default width of the nozzle, in mm.
NOZZLE_MM = 0.4
#: The allowed widths of a nozzle, in mm. For a resin printer the width is that of a pixel.
NOZZLE_RANGE_MM = (0.02, 1.2)
#: The largest difference between lengths that are treated as equal, in mm.
ROUNDING_MM = 1e-9


def require_nozzle(nozzle_mm: float) -> None:
    """Check that a nozzle width is realistic.

    Raises:
        InputError: The width is not in :data:`NOZZLE_RANGE_MM`.
    """
    require_between("nozzle", nozzle_mm, *NOZZLE_RANGE_MM, " mm")


def min_bearing_wall_mm(nozzle_mm: float) -> float:
    """Return the smallest thickness of a wall that carries a load: 1.6 mm, or two nozzle widths if that is more."""
    return max(MIN_WALL_MM, 2.0 * nozzle_mm)


def require_walls(field: str, value: object, walls: Mapping[str, float], min_mm: float) -> None:
    """Check that all walls have a smallest thickness.

    Args:
        field: The field that the error message names.
        value: The value of the field.
        walls: The name and the thickness of each wall, in mm.
        min_mm: The smallest allowed thickness, in mm.

    Raises:
        InputError: A wall is too thin. The message states the thinnest wall, its thickness and the allowed thickness.
    """
    name, thickness = min(walls.items(), key=lambda item: item[1])
    if thickness < min_mm - ROUNDING_MM:
        raise InputError(field, value, f"the {name} would be {thickness:.4g} mm; it must be at least {min_mm:.4g} mm")


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
