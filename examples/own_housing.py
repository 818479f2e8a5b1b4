"""Parts for a sensor that has a flat pad of 16 x 12 mm instead of the TacTip's dome.

Such a sensor needs a larger block, other press positions, and a guide that keeps the pad over them. The holder and the
jig are calculated from the block and the press grid. The guide is drawn here: a plate that is screwed onto the holder's
rim. Its window is large enough for the pad at all press positions.
"""

from build123d import Align, Box, Cylinder, Pos

from housing import Holder, Jig, clearance_mm
from tacbench_cad import Block, PressGrid

PAD_MM = (16.0, 12.0)
GUIDE_MM = 4.0

block = Block.of(4, size_mm=(44.0, 40.0), key_mm=3.0)
grid = PressGrid(x_mm=(15.0, 18.5, 22.0, 25.5, 29.0), y_mm=(13.0, 16.5, 20.0, 23.5, 27.0))
holder = Holder(block=block, rim_mm=2.0)
jig = Jig(holder=holder, press_grid=grid)

(place,) = holder.block_placements()
(x0, y0), (x1, y1) = place.to_holder([(grid.x_mm[0], grid.y_mm[0]), (grid.x_mm[-1], grid.y_mm[-1])])
width, depth, rim = holder.size_mm
room = 2 * clearance_mm("loose")
low = (Align.MIN, Align.MIN, Align.MIN)
middle = (Align.CENTER, Align.CENTER, Align.MIN)

window = Pos((x0 + x1) / 2, (y0 + y1) / 2, rim) * Box(
    x1 - x0 + PAD_MM[0] + room, y1 - y0 + PAD_MM[1] + room, GUIDE_MM + holder.rim_height_mm, align=middle
)
pocket = holder.pockets[0]
above_block = Pos(*pocket.low, rim) * Box(
    pocket.high[0] - pocket.low[0], pocket.high[1] - pocket.low[1], holder.rim_height_mm + 0.3, align=low
)
guide = Pos(0, 0, rim) * Box(width, depth, GUIDE_MM + holder.rim_height_mm, align=low) - above_block - window
guide -= [Pos(*bore.at_mm, rim) * Cylinder(bore.diameter_mm / 2, 20, align=middle) for bore in holder.screws]
guide.label = "guide"

result = guide
print(block, holder, jig, sep="\n\n")
