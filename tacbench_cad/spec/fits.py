"""The fits between a block and the pocket of its holder. The holder's shape and the press protocol both use them."""

from __future__ import annotations

import math

from tacbench_cad.util.errors import InputError, nearest
from tacbench_cad.util.text import decimal_hint

#: The clearance between a block and its pocket on each side, in mm.
FITS: dict[str, float] = {"press": 0.05, "slip": 0.15, "loose": 0.30}
#: The allowed range of clearances, in mm per side. Values outside of it are probably mistakes.
CLEARANCE_RANGE_MM = (0.0, 1.0)


def clearance_mm(fit: str | float) -> float:
    """Return the clearance per side of a fit, in mm.

    Args:
        fit: ``press``, ``slip``, ``loose``, or a number of mm per side (also as a string).

    Raises:
        InputError: The fit is unknown, or the number is not from 0 to 1 mm.
    """
    if isinstance(fit, str) and fit in FITS:
        return FITS[fit]
    try:
        value = float(fit)
    except (TypeError, ValueError):
        allowed = f"{nearest(str(fit), FITS)}, or a number of mm per side{decimal_hint(str(fit))}"
        raise InputError("fit", fit, allowed) from None
    least, most = CLEARANCE_RANGE_MM
    if isinstance(fit, bool) or not (math.isfinite(value) and least <= value <= most):
        raise InputError("fit", fit, f"must be press, slip, loose, or from {least:g} to {most:g} mm per side")
    return value
