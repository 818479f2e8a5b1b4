"""Printable tactile texture blocks from formulas, with their fixtures, press protocol and checks.

A texture is a formula, and everything else is derived from it with a stated error: the printed surface, the STEP
file, the press positions, the simulated sensor and the labels of the classifier. Lengths are in millimetres and forces
in newtons.

From a texture to a part, which builds its mesh and its solid when they are asked for:

>>> from tacbench_cad.spec.block import Block
>>> from tacbench_cad.geometry.block_part import block_part
>>> block = Block.of(2, scale=1.5, key_mm=3.0)
>>> print(block.name, block.size_mm, f"relief {block.relief_mm:.3f} mm")
texture-2_paper_x1.5_key3 (34.95, 45.0) relief 6.000 mm
>>> mesh, body = block_part(block).mesh
>>> body.certificate.distance_mm < 0.01  # proved for every point of the surface
True

``print(block)`` is its dimension report; a holder and a jig print theirs. A texture of your own is a name and a sum of
waves ``A sin(f u + g v + phase)``:

>>> from tacbench_cad.spec.textures import Texture, plane_waves
>>> weave = Texture(name="weave", waves=plane_waves((0.7, 1.0, 0.5), (0.7, 1.0, -0.5)))
>>> weave.equation
'0.7 sin(u + 0.5v) + 0.7 sin(u - 0.5v)'
>>> Block.of(weave, scale=2.0).size_mm
(46.6, 60.0)

From there to files that can be printed, each read back and checked against the formula::

    from tacbench_cad.making.printset import Request, build

    print(build(Request(textures=(weave,), parts=("blocks",))))

What the commands do, in Python:

* ``tacbench make``: :func:`tacbench_cad.making.printset.build` with a :class:`tacbench_cad.making.printset.Request`
* ``tacbench check``: :mod:`tacbench_cad.checks.verify` (our parts), :mod:`tacbench_cad.checks.identify` (any file)
* ``tacbench export``: :mod:`tacbench_cad.formats.simulators`, one module a simulator
* ``tacbench show`` and ``view``: :mod:`tacbench_cad.render.pictures`, :mod:`tacbench_cad.render.viewing.page`
* ``tacbench plate`` and ``slice-check``: :mod:`tacbench_cad.slicing`
* ``tacbench acquire``, ``simulate``, ``variance``, ``classify`` ...: :mod:`tacbench_cad.lab`, without CAD packages

Where to look:

* :mod:`tacbench_cad.spec.waves`, :mod:`tacbench_cad.spec.textures`: values, derivatives, bounds, extremes; the
  catalogue of six and textures from TOML files
* :mod:`tacbench_cad.spec.block`: a texture at a size in mm: the one mapping from the formula to the part
* :mod:`tacbench_cad.spec.protocol`: where and how hard the sensor presses
* :mod:`tacbench_cad.geometry.part`, :mod:`tacbench_cad.geometry.block_part`: everything printable
* :mod:`tacbench_cad.cq`, :mod:`tacbench_cad.bd`: blocks in CadQuery and build123d
* :mod:`tacbench_cad.render.snapshot`: a picture of any of their objects, without a window
* :mod:`housing.holder`, :mod:`housing.jig`, :mod:`housing.coupon`: the printed fixtures; :mod:`housing.bd`: holder and
  jig as build123d parts with joints, and the whole set put together
* :mod:`tacbench_cad.formats`: the file formats
* :mod:`tacbench_cad.util.errors`: what can be raised; every message says field, value and what is allowed

Importing this package imports nothing else. Whole scripts are in the folder ``examples`` of the source.
"""

__version__ = "0.1.0"
