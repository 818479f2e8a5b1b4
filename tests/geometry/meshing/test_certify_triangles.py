"""Proved bounds of single triangles: never below the deviation at dense points, and not far above it."""

from __future__ import annotations

import numpy as np
import pytest

from tacbench_cad.geometry.meshing import certify_triangles
from tacbench_cad.geometry.meshing.certify_triangles import REST, DerivativeBounds, prove, refuse_long_proof
from tacbench_cad.geometry.meshing.net import lattice
from tacbench_cad.spec.interpolation import sampled, spline_through
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.surface import Surface
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

SIDES = (10.0, 8.0)


def waves() -> WaveSum:
    terms = ((0.4, 1.0, 0.7, 0.1), (0.1, -2.0, 1.5, 0.9), (0.05, 0.3, 4.0, 2.0))
    return WaveSum(tuple(Wave(amplitude=a, f=f, g=g, phase=p) for a, f, g, p in terms))


def rough() -> Surface:
    u, v = np.linspace(0.0, SIDES[0], 41), np.linspace(0.0, SIDES[1], 33)
    return spline_through(u, v, np.random.default_rng(1).uniform(0.0, 0.2, (41, 33)))


def creased() -> Surface:
    return sampled(lambda u, v: abs(u - 4.0) + 0.1 * np.sin(v), u=(0.0, 10.0), v=(0.0, 8.0), creases=((4.0,), ()))


def triangles(surface: Surface, number: int, size: float, seed: int) -> Floats:
    """Return triangles whose corners are near the surface, shape (number, 3, 3)."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0.0, 1.0, (number, 1, 2)) * (np.array(SIDES) - 2.0 * size) + size
    place = middle + rng.uniform(-size, size, (number, 3, 2))
    z = surface(place[..., 0], place[..., 1]) + rng.uniform(-0.01, 0.01, (number, 3))
    return np.concatenate([place, z[..., None]], axis=2)


def bounds_of(surface: Surface) -> DerivativeBounds:
    x, y = (np.linspace(0.0, side, 51) for side in SIDES)
    return DerivativeBounds(surface, np.unique(np.append(x, surface.creases[0])), y)


def dense(surface: Surface, points: Floats) -> tuple[Floats, Floats]:
    """Return the largest distance and vertical deviation of each triangle at dense points."""
    x, y, z = np.einsum("kw,nwc->cnk", lattice(24, corners=True), points)
    vertical = np.abs(z - surface(x, y))
    slope = np.hypot(*surface.gradient(x, y))
    return (vertical / np.sqrt(1.0 + slope**2)).max(axis=1), vertical.max(axis=1)


@pytest.mark.parametrize("surface", [waves(), rough(), creased()])
@pytest.mark.parametrize("size", [0.05, 0.4, 1.5])
@pytest.mark.parametrize("limit", [0.004, 0.03, 10.0])
def test_never_below_dense_points(surface: Surface, size: float, limit: float) -> None:
    points = triangles(surface, 150, size, 7)
    distance, vertical = prove(surface, bounds_of(surface), points, limit)
    true_distance, true_vertical = dense(surface, points)
    assert np.all(distance >= true_distance * (1.0 - 1e-9))
    assert np.all((vertical >= true_vertical * (1.0 - 1e-9)) | np.isinf(distance))
    assert np.all((distance <= limit) | np.isinf(distance))


def test_triangles_within_the_limit_are_proved() -> None:
    surface = waves()
    points = triangles(surface, 400, 0.3, 3)
    true_distance, _ = dense(surface, points)
    limit = 0.02
    distance, _ = prove(surface, bounds_of(surface), points, limit)
    assert np.count_nonzero(true_distance < 0.98 * limit) > 100
    assert np.all(np.isfinite(distance[true_distance < 0.98 * limit]))


def test_a_triangle_across_a_crease_is_not_proved_from_smooth_derivatives() -> None:
    surface = creased()
    across = np.array([[[3.9, 3.0, 0.1], [4.2, 3.0, 0.2], [4.0, 3.3, 0.0]]])
    across[..., 2] = surface(across[..., 0], across[..., 1])
    true_distance, _ = dense(surface, across)
    assert true_distance[0] > 0.01
    assert np.isinf(prove(surface, bounds_of(surface), across, 0.01)[0, 0])
    low, high = across[..., :2].min(axis=1).T, across[..., :2].max(axis=1).T
    assert np.all(np.isinf(bounds_of(surface).over(low, high)))


def test_the_constant_of_the_rest() -> None:
    weights = lattice(120, corners=True)
    nodes = np.concatenate([np.eye(3), (np.eye(3) + np.eye(3)[[1, 2, 0]]) / 2.0])
    a, b, c = weights.T
    lagrange = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])
    length = np.abs(nodes[:, None] - weights[None]).sum(axis=2) / 2.0
    largest = float((np.abs(lagrange) * length**3).sum(axis=0).max()) / 6.0
    assert 0.999 * REST < largest < REST


def test_a_long_proof_is_refused_before_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    surface = rough()
    x, y = triangles(surface, 150, 1.5, 7)[..., :2].transpose(2, 0, 1)
    refuse_long_proof(bounds_of(surface), x, y, 0.004)
    monkeypatch.setattr(certify_triangles, "MAX_PARTS", 1000)
    with pytest.raises(InputError, match=r"too rough, so its proof .* use a larger tolerance"):
        refuse_long_proof(bounds_of(surface), x, y, 0.004)
