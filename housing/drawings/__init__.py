"""Dimension drawings of holder, jig and coupon.

The outlines come from the mesh of the part, and the numbers from its specification. This example writes a drawing as
PDF::

    from pathlib import Path
    from housing.drawings import holder_drawing
    from housing.holder import Holder
    from tacbench_cad.spec.block import Block
    from tacbench_cad.render.drawing import save_drawing

    save_drawing(holder_drawing(Holder(block=Block.of(4))), Path("holder.pdf"))
"""

from __future__ import annotations

from housing.coupon import Coupon
from housing.drawings.coupons import coupon_drawing
from housing.drawings.holders import holder_drawing
from housing.drawings.jigs import jig_drawing
from housing.holder import Holder
from housing.jig import Jig
from tacbench_cad.render.drawing.sheet import Drawing

__all__ = ["coupon_drawing", "fixture_drawing", "holder_drawing", "jig_drawing"]


def fixture_drawing(fixture: Holder | Jig | Coupon) -> Drawing:
    """Draw a holder, a jig or a coupon.

    Raises:
        MissingToolError: The CAD kernel is not installed.
    """
    if isinstance(fixture, Holder):
        return holder_drawing(fixture)
    return jig_drawing(fixture) if isinstance(fixture, Jig) else coupon_drawing(fixture)
