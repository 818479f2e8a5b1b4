"""A strip with the six textures one after another, to slide a sensor or a finger over them.

The strip is a mesh, as from any CAD program. Narrow grooves divide its upper side into six fields, so that each field
is a flat region of its own. Each texture is named by a point in the middle of its field. Two holes take screws of 4 mm.
"""

from manifold3d import Manifold

from tacbench_cad import export, textured

FIELD_MM, WIDTH_MM, HEIGHT_MM, END_MM = 24.0, 20.0, 4.0, 10.0
HOLE_MM, GROOVE_MM = 4.4, 0.6
DEPTH_MM, MARGIN_MM, FADE_MM, TOLERANCE_MM = 0.8, 0.6, 2.0, 0.03

length = 6 * FIELD_MM + 2 * END_MM
strip = Manifold.cube((length, WIDTH_MM, HEIGHT_MM))
for field in range(7):
    groove = Manifold.cube((GROOVE_MM, WIDTH_MM + 2, 2 * GROOVE_MM), True)
    strip -= groove.translate((END_MM + field * FIELD_MM, WIDTH_MM / 2, HEIGHT_MM))
for x in (END_MM / 2, length - END_MM / 2):
    strip -= Manifold.cylinder(HEIGHT_MM + 2, HOLE_MM / 2, HOLE_MM / 2, 64).translate((x, WIDTH_MM / 2, -1))

result = strip
for number in range(1, 7):
    middle = (END_MM + (number - 0.5) * FIELD_MM, WIDTH_MM / 2, HEIGHT_MM)
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

export(own, "strip.stl")
