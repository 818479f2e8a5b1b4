"""Dimension drawings of printable parts: outlines cut out of the part's own mesh, numbers from its specification.

A drawing as PDF::

    from pathlib import Path

    from housing import Holder
    from tacbench_cad import Block
    from tacbench_cad.extensions.drawings import fixture_drawing, save_drawing

    save_drawing(fixture_drawing(Holder(block=Block.of(4))), Path("holder.pdf"))

Needs matplotlib (extra ``plot``) when a file is written.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
