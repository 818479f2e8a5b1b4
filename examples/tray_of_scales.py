"""Texture 2 at nine scales, from 0.6 to 1.4, on one plate for one print.

The scale multiplies the sides, the height, the mm per unit and the press grid. The blocks stand in three rows along x,
and the smallest is at low x and low y. Each block is sunk into the plate by half of the plate's thickness.
"""

from build123d import Align, Box, Pos

from tacbench_cad import Block
from tacbench_cad.bd import TextureBlock

PLATE_MM = 2.0
GAP_MM = 4.0

blocks = [Block.of(2, scale=scale / 10) for scale in range(6, 15)]
pitch_x, pitch_y = (side + GAP_MM for side in blocks[-1].size_mm)

plate = Box(3 * pitch_x, 3 * pitch_y, PLATE_MM, align=Align.MIN)
middles = [((i % 3 + 0.5) * pitch_x, (i // 3 + 0.5) * pitch_y) for i in range(9)]
result = plate + [Pos(x, y, PLATE_MM / 2) * TextureBlock(block) for block, (x, y) in zip(blocks, middles, strict=True)]
