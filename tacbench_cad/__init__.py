"""Printable tactile texture blocks from formulas, with their fixtures, press protocol and checks.

A texture is a formula. The printed surface, the STEP file, the press positions, the simulated sensor and the labels of
the classifier are computed from it, with a stated error. Lengths are in millimetres and forces in newtons.

This example writes the file of a texture block, reads it back and checks it:

>>> from tacbench_cad import Block, export
>>> block = Block.of(2, scale=1.5, key_mm=3.0)
>>> print(block.name, block.size_mm, f"relief {block.relief_mm:.3f} mm")
texture-2_paper_x1.5_key3 (34.95, 45.0) relief 6.000 mm
>>> report = export(block, "block.stl")  # or "block.3mf", "block.step"
>>> report.ok, report.deviation_mm < 0.01
(True, True)

``print(block)`` prints the dimension report, and ``print(report)`` lists the checks. A texture of your own has a name
and a sum of waves ``A sin(f u + g v + phase)``:

>>> from tacbench_cad import Texture
>>> weave = Texture.plane_waves((0.7, 1.0, 0.5), (0.7, 1.0, -0.5), name="weave")
>>> weave.equation
'0.7 sin(u + 0.5v) + 0.7 sin(u - 0.5v)'
>>> Block.of(weave, scale=2.0).size_mm
(46.6, 60.0)

This makes a complete print set with holder and jig, like ``tacbench make``::

    from tacbench_cad import Request, build

    print(build(Request(textures=(weave,))))

Every name of this package is loaded when it is first used: ``import tacbench_cad`` alone imports neither NumPy nor a
CAD package. The other public modules are :mod:`tacbench_cad.cq` (CadQuery), :mod:`tacbench_cad.bd` (build123d),
:mod:`tacbench_cad.lab` (rig, runs and analysis, without CAD packages), :mod:`housing` (holder, jig and coupon) and
:mod:`tacbench_cad.extensions` (everything else, for example scans of prints).
"""

from lazy_loader import attach_stub

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
