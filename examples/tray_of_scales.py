"""A tray of nine scales: texture 2 at 0.6 to 1.4 of the paper's size, on one plate, for one print.

Scale multiplies everything: sides, height, mm per unit and the press grid. The blocks stand 3 by 3, the smallest at
low x and low y, rows along x; each is sunk into the plate by half of its thickness.
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
