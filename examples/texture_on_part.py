"""Put a texture on one face of your own part: cut a pocket into the face, and fuse a block into the pocket.

The part is a wedge with an upper face that slopes by 20 degrees. The highest points of the texture are flush with this
face, so the part can still lie on it. A gap of 1 mm surrounds the texture.
"""

from build123d import Align, Axis, Box, Plane, Polygon, extrude

from tacbench_cad import Block
from tacbench_cad.bd import TextureBlock

FREE_MM = 1.0

profile = Polygon((0, 0), (60, 0), (60, 30), (0, 8.16), align=None)
wedge = extrude(Plane.XZ * profile, amount=-40)
face = wedge.faces().sort_by(Axis.Z)[-1]
on_face = Plane(face)  # origin in the middle of the face, z pointing outwards

block = Block.of(2, size_mm=(36.0, 28.0), height_mm=6.0)
x, y = block.size_mm
depth_mm = block.relief_mm + 0.2

top_at_face = (Align.CENTER, Align.CENTER, Align.MAX)
pocket = Box(x + 2 * FREE_MM, y + 2 * FREE_MM, depth_mm, align=top_at_face)
result = wedge - on_face.location * pocket + on_face.location * TextureBlock(block, align=top_at_face)
