"""Overhangs: the search finds cones, ceilings and bridges, and the parts need no supports."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.extensions.slicing.overhang import overhangs
from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.label import STROKE_MM


def prism(profile: list[tuple[float, float]], depth_mm: float) -> Mesh:
    """Extrude a convex, counter-clockwise profile in x and z along y."""
    n = len(profile)
    vertices = np.array([(x, y, z) for y in (0.0, depth_mm) for x, z in profile])
    ends = [(0, i, i + 1) for i in range(1, n - 1)] + [(n, n + i + 1, n + i) for i in range(1, n - 1)]
    sides = [(i, n + i, (i + 1) % n) for i in range(n)] + [((i + 1) % n, n + i, n + (i + 1) % n) for i in range(n)]
    return Mesh(vertices, np.array(ends + sides, dtype=np.int32))


def test_a_slanted_wall_has_an_overhang_of_its_angle() -> None:
    for angle in (20.0, 45.0, 70.0):
        out = 10.0 * np.tan(np.radians(angle))
        overhang = overhangs(prism([(0.0, 0.0), (5.0, 0.0), (5.0 + out, 10.0), (0.0, 10.0)], 8.0))
        assert overhang.steepest_deg == pytest.approx(angle)
        assert (overhang.ceiling_mm2, overhang.widest_mm) == (0.0, 0.0)


def test_the_width_of_a_ceiling_is_the_diameter_of_the_largest_circle_in_it() -> None:
    """On each side of its foot, the plate has a ceiling of 12 x 30 mm."""
    foot = prism([(12.0, 0.0), (20.0, 0.0), (20.0, 5.0), (12.0, 5.0)], 30.0)
    plates = [prism([(x, 5.0), (x + 12.0, 5.0), (x + 12.0, 9.0), (x, 9.0)], 30.0) for x in (0.0, 20.0)]
    meshes = [foot, *plates]
    count = len(foot.vertices)
    joined = Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.faces + i * count for i, mesh in enumerate(meshes)]),
    )
    overhang = overhangs(joined)
    assert overhang.ceiling_mm2 == pytest.approx(720.0)
    assert overhang.widest_mm == pytest.approx(12.0, abs=2e-3)
    assert str(overhang) == "steepest 0.0 degrees, ceilings 720.0 mm^2, largest circle 12.00 mm"


@pytest.mark.parametrize(("number", "preset"), [(1, "released"), (4, "paper")])
def test_only_the_label_of_a_block_is_an_overhang(number: int, preset: str) -> None:
    plain = overhangs(mesh_block(Block.of(number, preset))[0])
    assert (plain.steepest_deg, plain.ceiling_mm2, plain.widest_mm) == (0.0, 0.0, 0.0)
    block = Block.of(number, preset, label=True, key_mm=3.0)
    assert block.engraving is not None
    overhang = overhangs(mesh_block(block)[0])
    assert overhang.steepest_deg == 0.0
    assert overhang.ceiling_mm2 == pytest.approx(block.engraving.area_mm2, rel=1e-5)
    # Where two strokes meet, the largest circle is wider than one stroke.
    assert STROKE_MM < overhang.widest_mm < 2.0 * STROKE_MM
