"""Named fits, and the least walls that a printer can be trusted with."""

from __future__ import annotations

from collections.abc import Mapping

from tacbench_cad.spec import fits
from tacbench_cad.spec.fits import clearance_mm as clearance_mm
from tacbench_cad.util.errors import InputError, require_between

#: Clearances of the named fits, in mm per side.
FITS = fits.FITS

#: Least thickness below a pocket, in mm.
MIN_FLOOR_MM = 1.2
#: Least thickness of a wall that bears something, in mm; also at least two nozzle widths.
MIN_WALL_MM = 1.6
#: Width of the nozzle that the fixtures are laid out for, in mm.
NOZZLE_MM = 0.4
#: Nozzles outside of this range are taken for mistakes, in mm; resin printers count as their pixel.
NOZZLE_RANGE_MM = (0.02, 1.2)
#: Lengths that differ by less than this are equal: below any rounding that matters, in mm.
ROUNDING_MM = 1e-9


def require_nozzle(nozzle_mm: float) -> None:
    """Refuse a nozzle that no printer has.

    Raises:
        InputError: The width is not a number in the range.
    """
    require_between("nozzle", nozzle_mm, *NOZZLE_RANGE_MM, " mm")


def min_bearing_wall_mm(nozzle_mm: float) -> float:
    """Least thickness of a wall that bears something: 1.6 mm, or two nozzle widths where that is more."""
    return max(MIN_WALL_MM, 2.0 * nozzle_mm)


def require_walls(field: str, value: object, walls: Mapping[str, float], min_mm: float) -> None:
    """Refuse walls that are thinner than a least thickness.

    Args:
        field: The field to name in the error.
        value: Its value.
        walls: What each wall is, and its thickness in mm.
        min_mm: The least thickness in mm.

    Raises:
        InputError: A wall is too thin; the message has the thinnest one, its thickness and the least.
    """
    name, thickness = min(walls.items(), key=lambda item: item[1])
    if thickness < min_mm - ROUNDING_MM:
        raise InputError(field, value, f"the {name} would be {thickness:.4g} mm, at least {min_mm:.4g} mm is needed")
