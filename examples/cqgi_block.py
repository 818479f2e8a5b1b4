"""A keyed texture block for CQ-editor and every other CQGI host: the constants below are its parameters.

A host lists as parameters the bare constants at the top of the module, so they have no annotations. It gives back any
number for a whole one; whatever must be whole is checked here.
"""

import cadquery as cq

from tacbench_cad import Block, InputError
from tacbench_cad.cq import solid

texture = 2
scale = 1.0
height_mm = 7.0
key_mm = 3.0  # 0 for no key
label = False

if texture != int(texture):
    raise InputError("texture", texture, "must be a whole number from 1 to 6")

block = Block.of(int(texture), scale=scale, height_mm=height_mm, key_mm=key_mm or None, label=bool(label))
result = cq.Workplane(solid(block))

if "show_object" in globals():  # a host gives this function; plain Python does not
    show_object(result, name=block.name)  # noqa: F821
