"""A plate with eight strips of finer and finer waves, in CadQuery: what is the smallest sine that a sensor can feel?

Each strip has the surface ``sin u``. From each strip to the next, wavelength and amplitude are divided by sqrt(2); the
wavelengths go from 8 mm to 0.7 mm. So all strips have the same slope and differ only in size. The crests of all strips
have the same height.
"""

from math import pi, sqrt

import cadquery as cq

from tacbench_cad import Block
from tacbench_cad.cq import solid

STRIP_MM = (40.0, 8.0)
HEIGHT_MM = 4.0
GAP_MM = 1.0
PLATE_MM = 1.6
WAVELENGTHS_MM = [8.0 / sqrt(2.0) ** step for step in range(8)]
AMPLITUDE_RATIO = 0.06  # amplitude for each mm of wavelength

strips = [
    Block.of(1, size_mm=STRIP_MM, height_mm=HEIGHT_MM, mm_per_unit=(length / (2 * pi), 1.0, AMPLITUDE_RATIO * length))
    for length in WAVELENGTHS_MM
]
pitch = STRIP_MM[1] + GAP_MM

result = cq.Workplane().box(STRIP_MM[0] + 2 * GAP_MM, len(strips) * pitch + GAP_MM, PLATE_MM, centered=False)
for step, strip in enumerate(strips):
    at = cq.Vector(GAP_MM, GAP_MM + step * pitch, PLATE_MM / 2)
    result = result.union(cq.Workplane(solid(strip).moved(cq.Location(at))))
