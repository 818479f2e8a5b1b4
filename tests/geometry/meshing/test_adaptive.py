"""Adaptive tops: few triangles, within the tolerance, with edges along creases, for waves and for height maps."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.tops import deviations, faults, top_triangles

from tacbench_cad.geometry.block_mesh import full_mesh
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.geometry.meshing import heights
from tacbench_cad.geometry.meshing.adaptive import NetTop, adaptive_top
from tacbench_cad.geometry.meshing.top import textured_top
from tacbench_cad.geometry.meshing.top_volume import deviation_mm3
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.families import plane_waves
from tacbench_cad.spec.interpolation import height_map, sampled
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.textures import Texture
from tacbench_cad.spec.waves import WaveSum


def block_of(surface: Surface, tolerance: float = 0.02, key: float | None = None) -> Block:
    texture = Texture(name="net", equation="", surface=surface)
    return Block.of(texture, sampling=Tolerance(mm=tolerance), key_mm=key, mm_per_unit=(1.0, 1.0, 1.0))


def weave() -> WaveSum:
    return plane_waves((0.7, 1.0, 0.5), (0.7, 1.0, -0.5))


def stripes() -> WaveSum:
    """Return waves that all run in one oblique direction, so that the surface is straight across it."""
    return WaveSum((Wave(amplitude=0.4, f=1.0, g=0.5), Wave(amplitude=0.1, f=3.0, g=1.5)))


def bumps() -> Surface:
    """Return a height map of smooth bumps at random places."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(0.0, 30.0, 200), np.linspace(0.0, 30.0, 200))
    places = rng.uniform(0.0, 30.0, (60, 2))
    table = sum(np.exp(-((x - a) ** 2 + (y - b) ** 2) / 3.0) for a, b in places)
    return height_map(table, mm_per_pixel=30.0 / 199, height_mm=(0.0, 1.2))


def pyramids() -> Surface:
    """Return pyramids-like ridges with creases every 3 mm in both directions."""

    def zigzag(t: np.ndarray) -> np.ndarray:
        return np.abs(np.mod(t / 6.0, 1.0) * 2.0 - 1.0)

    creases = tuple(np.arange(3.0, 24.0, 3.0)), tuple(np.arange(3.0, 30.0, 3.0))
    return sampled(
        lambda u, v: zigzag(u) * zigzag(v) + 0.05 * np.sin(u + v), u=(0.0, 24.0), v=(0.0, 30.0), creases=creases
    )


@pytest.mark.parametrize("key", mostly_long([None, 4.3], 4.3))
@pytest.mark.parametrize(
    ("surface", "limit"),
    [
        (weave(), 4800),
        (pyramids(), 4500),
        *(pytest.param(*case, marks=pytest.mark.long) for case in [(stripes(), 1500), (bumps(), 4500)]),
    ],
)
def test_few_triangles_within_the_tolerance(surface: Surface, limit: int, key: float | None) -> None:
    block = block_of(surface, key=key)
    mesh, expected = block_part(block).mesh
    assert faults(mesh) == []
    assert len(mesh.faces) < limit
    assert mesh.vertices[:, 2].max() == np.float32(block.height_mm)
    assert expected.certificate is not None
    distance, vertical = deviations(block, mesh, 12)
    own = block.surface.error
    assert 0.8 * 0.02 < distance + own <= expected.certificate.distance_mm <= 0.02
    assert vertical + own <= expected.certificate.vertical_mm
    assert abs(mesh.volume_mm3 - expected.volume_mm3) <= expected.volume_slack_mm3


def test_no_triangle_crosses_a_crease() -> None:
    block = block_of(pyramids())
    mesh, _ = block_part(block).mesh
    top = top_triangles(mesh, block)
    for axis, creases in enumerate(block.surface.creases):
        assert len(creases) > 5
        low, high = top[:, :, axis].min(axis=1), top[:, :, axis].max(axis=1)
        assert np.array_equal(np.searchsorted(creases, low, "right"), np.searchsorted(creases, high, "left"))


@pytest.mark.parametrize("tolerance", [0.3, 1.0])
def test_a_tolerance_as_large_as_the_relief(tolerance: float) -> None:
    block = block_of(plane_waves((0.1, 1.0, 0.5), (0.1, 1.0, -0.5)), tolerance)
    mesh, _ = block_part(block).mesh
    assert faults(mesh) == []
    assert len(mesh.faces) < 120
    assert deviations(block, mesh)[0] <= tolerance


def test_the_peak_is_a_vertex() -> None:
    block = block_of(weave())
    mesh, _ = block_part(block).mesh
    highest = mesh.vertices[mesh.vertices[:, 2] == mesh.vertices[:, 2].max()]
    assert block.height_at(*highest[:, :2].T).max() == pytest.approx(block.height_mm, abs=1e-6)


def test_the_volume_notices_a_missing_triangle() -> None:
    block = block_of(weave())
    top = textured_top(block)
    assert isinstance(top, NetTop)
    formula, slack = block.volume_mm3(block.datum_mm), full_mesh(block).volume_slack_mm3
    faces = np.delete(top.sheet.faces, 17, axis=0)
    volume, with_hole = (formula + deviation_mm3(block, top.sheet.vertices, own)[0] for own in (top.sheet.faces, faces))
    prisms = sum(_prism(top.sheet.vertices[face]) for face in faces)
    assert abs(volume - sum(_prism(top.sheet.vertices[face]) for face in top.sheet.faces)) < slack
    assert abs(with_hole - prisms) > 100.0 * slack


def _prism(corners: np.ndarray) -> float:
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corners
    return float(((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)) / 2.0 * (az + bz + cz) / 3.0)


def test_sharp_letters_are_proved_even_if_the_table_is_too_coarse_for_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heights, "CELLS", (4, 24))
    table = np.zeros((20, 20))
    table[5:10, 5:15] = table[5:15, 6:10] = 1.0
    texture = Texture(name="letters", surface=height_map(table, mm_per_pixel=0.06, height_mm=1.0))
    block = Block.of(texture, mm_per_unit=(1.0, 1.0, 1.0), size_mm=(1.14, 1.14))
    top = adaptive_top(block, 0.01)
    assert top.certificate.distance_mm <= 0.01
