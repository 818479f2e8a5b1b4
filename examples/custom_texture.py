"""Define a texture by its waves, and write its block as STL and STEP files that are checked.

The formula is ``sin u sin v + 0.2 sin 4u``. The product of two sines is the sum of two oblique waves:
``sin u sin v = cos(u - v)/2 - cos(u + v)/2``. One unit is 1.2 mm along x and y, and 1 mm in height.
"""

from math import pi

from tacbench_cad import Block, Texture, as_part, export

# amplitude, f, g and phase of each wave A sin(f u + g v + phase)
waves = ((0.5, 1.0, -1.0, pi / 2), (-0.5, 1.0, 1.0, pi / 2), (0.2, 4.0, 0.0))
waffle = Texture.plane_waves(*waves, name="waffle", equation="sin u sin v + 0.2 sin 4u")
block = Block.of(waffle, size_mm=(30.0, 30.0), mm_per_unit=(1.2, 1.2, 1.0))
part = as_part(block)

reports = [export(part, f"waffle.{ending}") for ending in ("stl", "step")]
result = part.solid[0]

print(block)
