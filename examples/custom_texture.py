"""A texture from scratch, as checked STL and STEP files in the folder ``waffle``.

The formula is ``sin u sin v + 0.2 sin 4u``. A product of two sines is the sum of two oblique waves:
``sin u sin v = cos(u - v)/2 - cos(u + v)/2``. One unit is 1.2 mm along x and y, and 1 mm in height.
"""

from math import pi
from pathlib import Path

from tacbench_cad import Block, Texture, plane_waves
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.making.writing import make_files

# amplitude, f, g and phase of each wave A sin(f u + g v + phase)
waves = plane_waves((0.5, 1.0, -1.0, pi / 2), (-0.5, 1.0, 1.0, pi / 2), (0.2, 4.0, 0.0))
waffle = Texture(name="waffle", equation="sin u sin v + 0.2 sin 4u", waves=waves)
block = Block.of(waffle, size_mm=(30.0, 30.0), mm_per_unit=(1.2, 1.2, 1.0))
part = block_part(block)

out = Path("waffle")
out.mkdir(exist_ok=True)
made = make_files(part, ("stl", "step"), out, full=False)
result = part.solid[0]

print(block)
