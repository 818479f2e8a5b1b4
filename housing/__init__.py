"""The printed fixtures for the blocks: holder, grid-marker jig and fit coupon.

>>> from housing import Holder, Jig
>>> from tacbench_cad import Block
>>> holder = Holder(block=Block.of(4, key_mm=3.0), slots=2)
>>> print(holder.name, holder.size_mm[:2])
holder_paper_x1_key3_slots2 (77.2, 52.3)
>>> Jig(holder=holder).min_wall_mm
0.45

``print(holder)`` prints the dimension report. ``tacbench_cad.export(holder, "holder.step")`` writes a file. Numbers and
reports need only the base installation. Shapes are built with the Open CASCADE kernel, which is imported when a shape
is needed. For CAD scripts there are :mod:`housing.bd` (build123d parts with joints) and :mod:`housing.cq` (CadQuery).
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
