"""The distance of points from a surface along its normal."""

from __future__ import annotations

import numpy as np
import pytest
from helpers.printers import PRINTER

from tacbench_cad.extensions.printer_models.prediction import Print
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.distance import distance_along_normal
from tacbench_cad.util.types import Floats


def test_the_distance_from_a_plane_is_exact_and_positive_above_it() -> None:
    points = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -1.0], [5.0, 0.0, 10.0]])

    def plane(x: Floats, y: Floats) -> tuple[Floats, Floats, Floats]:
        return 2.0 * x, np.full_like(x, 2.0), np.zeros_like(y)

    assert distance_along_normal(points, plane) == pytest.approx(np.array([3.0, -3.0, 0.0]) / np.sqrt(5.0))


@pytest.mark.parametrize("preset", ["paper", "released"])
def test_points_beside_steep_flanks_have_the_distance_of_the_nearest_place(preset: str) -> None:
    block = Block.of("4", preset)
    formula, printed = block.surface, Print(file=block, model=PRINTER)
    x, y = np.random.default_rng(1).uniform(1.0, 22.0, (2, 150))
    points = np.column_stack([x, y, printed.surface(x, y)])
    found = distance_along_normal(points, lambda u, v: (formula(u, v), *formula.gradient(u, v)))
    around, nearest = np.linspace(-0.25, 0.25, 501), []
    for point in points:
        heights = formula.grid(point[0] + around, point[1] + around)
        nearest.append(np.sqrt(np.min(around[:, None] ** 2 + around**2 + (heights - point[2]) ** 2)))
    vertical = points[:, 2] - formula(x, y)
    assert np.max(np.abs(vertical)) > 0.5 > 2.0 * np.max(nearest)
    assert np.all(found * vertical >= 0.0)
    assert np.mean(np.abs(found) < np.array(nearest) + 0.005) > 0.85
    assert np.std(found) == pytest.approx(np.sqrt(np.mean(np.square(nearest))), rel=0.05)
