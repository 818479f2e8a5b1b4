"""A texture block with a key, for CQ-editor and other CQGI hosts: you change the constants below in the host's panel.

A host takes the constants at the top of the module as parameters, but only if they have no type annotations. It may
return 2.5 for a number that must be whole, so the script checks that.
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

if "show_object" in globals():  # a host defines this function; plain Python does not
    show_object(result, name=block.name)  # noqa: F821
