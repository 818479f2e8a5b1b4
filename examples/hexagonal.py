"""Hexagonal bumps from three oblique waves at 120 degrees, as a build123d part.

The hexagons are regular because one unit has the same length in mm along x and y. The distance between neighbouring
bumps is ``4 pi / sqrt(3)`` units.
"""

from math import cos, pi, radians, sin

from tacbench_cad import Block, Texture
from tacbench_cad.bd import TextureBlock

MM_PER_UNIT = 0.8

directions = [radians(angle) for angle in (0, 120, 240)]
waves = [(0.3, cos(a), sin(a), pi / 2) for a in directions]
text = "0.3 sum cos(u cos a + v sin a), a = 0, 120, 240 degrees"
bumps = Texture.plane_waves(*waves, name="hexagonal", equation=text)

block = Block.of(bumps, size_mm=(30.0, 30.0), height_mm=5.0, mm_per_unit=(MM_PER_UNIT, MM_PER_UNIT, 1.0))
result = TextureBlock(block)
