"""A texture on one face of your own part: a pocket is cut into the face, and a block is fused into it.

The part is a wedge whose upper face slopes by 20 degrees. The highest points of the texture lie flush with that face,
so that the part can lie on it, and 1 mm is left free round the texture.
"""

from build123d import Align, Axis, Box, Plane, Polygon, extrude

from tacbench_cad import Block
from tacbench_cad.bd import TextureBlock

FREE_MM = 1.0

profile = Polygon((0, 0), (60, 0), (60, 30), (0, 8.16), align=None)
wedge = extrude(Plane.XZ * profile, amount=-40)
face = wedge.faces().sort_by(Axis.Z)[-1]
on_face = Plane(face)  # its origin lies in the middle of the face, its z points outwards

block = Block.of(2, size_mm=(36.0, 28.0), height_mm=6.0)
x, y = block.size_mm
depth_mm = block.relief_mm + 0.2

top_at_face = (Align.CENTER, Align.CENTER, Align.MAX)
pocket = Box(x + 2 * FREE_MM, y + 2 * FREE_MM, depth_mm, align=top_at_face)
result = wedge - on_face.location * pocket + on_face.location * TextureBlock(block, align=top_at_face)
