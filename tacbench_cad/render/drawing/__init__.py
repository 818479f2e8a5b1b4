"""Dimension drawings of printable parts: outlines cut out of the part's own mesh, numbers from its specification.

A drawing as PDF::

    from pathlib import Path
    from tacbench_cad.spec.block import Block
    from tacbench_cad.render.drawing import block_drawing, save_drawing

    save_drawing(block_drawing(Block.of(4, key_mm=3.0), press=True), Path("block.pdf"))

Holder, jig and coupon are drawn by :mod:`housing.drawings`. Needs matplotlib (extra ``plot``) when a file is written.
"""

from tacbench_cad.render.drawing.blocks import block_drawing
from tacbench_cad.render.drawing.ink import save_drawing
from tacbench_cad.render.drawing.sheet import Dimension, Drawing

__all__ = ["Dimension", "Drawing", "block_drawing", "save_drawing"]
