"""A drum with the six textures one after another around it, to slide them under a sensor.

The drum is a mesh, as from any CAD program. Six narrow grooves divide its side into six sectors, so that each sector is
a cylindrical region of its own. Each texture is named by a point in the middle of its sector. The bore fits a shaft of
8 mm with a flat.
"""

from math import cos, pi, sin

from manifold3d import CrossSection, Manifold

from tacbench_cad import export, textured

RADIUS_MM, WIDTH_MM, FACETS = 20.0, 24.0, 720
SHAFT_MM, FLAT_MM = 8.2, 3.2
GROOVE_MM = 0.6
DEPTH_MM, MARGIN_MM, FADE_MM, TOLERANCE_MM = 0.8, 0.8, 2.0, 0.03

drum = Manifold.cylinder(WIDTH_MM, RADIUS_MM, RADIUS_MM, FACETS)
flat = CrossSection.square((SHAFT_MM, SHAFT_MM)).translate((FLAT_MM, -SHAFT_MM / 2))
shaft = (CrossSection.circle(SHAFT_MM / 2, 96) - flat).extrude(WIDTH_MM + 2).translate((0, 0, -1))
groove = Manifold.cube((2 * GROOVE_MM, GROOVE_MM, WIDTH_MM + 2), True).translate((RADIUS_MM, 0, WIDTH_MM / 2))
for sector in range(6):
    drum -= groove.rotate((0, 0, 60 * sector))
drum -= shaft

result = drum
for number in range(1, 7):
    angle = (number - 0.5) * pi / 3
    middle = (RADIUS_MM * cos(angle), RADIUS_MM * sin(angle), WIDTH_MM / 2)
    own = textured(
        result,
        middle,
        number,
        depth_mm=DEPTH_MM,
        margin_mm=MARGIN_MM,
        fade_mm=FADE_MM,
        mesh_tolerance_mm=TOLERANCE_MM,
    )
    result = own.mesh

export(own, "drum.stl")
