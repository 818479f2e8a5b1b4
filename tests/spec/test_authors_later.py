"""The authors' later textures against their equations."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tacbench_cad.geometry.brep import solid_refusal
from tacbench_cad.spec.authors_later import LATER, later_surface
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import STEP_TOLERANCE_MM, TOLERANCE_MM, Tolerance
from tacbench_cad.spec.wavelengths import error_note
from tacbench_cad.util.types import Floats

REFERENCE = {
    "ripple": lambda x, y: np.sin(x + y) + 0.5 * np.cos(2 * x - 2 * y),
    "rings": lambda x, y: np.sin(np.pi * np.sqrt(np.sin(x) ** 2 + np.cos(y) ** 2)),
    "diamond": lambda x, y: np.abs(np.sin(x)) + np.abs(np.cos(y)),
    "weave": lambda x, y: np.sin(x) * np.sin(y) + 0.3 * np.cos(3 * x) * np.cos(3 * y),
    "hexagons": lambda x, y: np.cos(x) + np.cos(x / 2 + 3**0.5 / 2 * y) + np.cos(x / 2 - 3**0.5 / 2 * y),
    "ridges": lambda x, y: 1 - np.abs(np.sin(x) * np.cos(y)),
    "rock": lambda x, y: np.maximum(np.sin(x), np.cos(y)) + 0.5 * np.minimum(np.sin(2 * x), np.cos(2 * y)),
    "dunes": lambda x, y: np.exp(np.sin(x)) * np.cos(y),
    "dimples": lambda x, y: -np.sqrt(np.sin(x / 2) ** 2 * np.cos(y / 2) ** 2),
    "scales": lambda x, y: np.sin(x + np.sin(y)) * np.cos(y),
    "knurl": lambda x, y: np.arcsin(np.sin(x) * np.cos(y)),
    "swirl": lambda x, y: np.sin(x + np.cos(y)) + np.cos(y + np.sin(x)),
    "chevron": lambda x, y: np.arccos(np.cos(x + np.arcsin(np.sin(y)))),
    "coral": lambda x, y: (
        np.sin(x) * np.cos(y) + 0.5 * np.sin(2 * x + np.pi / 4) * np.cos(2 * y) + 0.25 * np.sin(4 * x) * np.sin(4 * y)
    ),
}
#: The largest distance from the equation, and whether it is proved.
ERRORS = dict.fromkeys(("ripple", "weave", "hexagons", "coral", "dunes", "scales", "swirl"), (1e-11, "proved"))
ERRORS |= dict.fromkeys(("diamond", "ridges", "dimples"), (1.1e-06, "proved"))
ERRORS |= dict.fromkeys(("rings", "knurl"), (0.0009, "measured"))
ERRORS |= dict.fromkeys(("rock", "chevron"), (0.016, "measured"))


def heights(name: str, points: Floats) -> Floats:
    return np.asarray(REFERENCE[name](*points))


@pytest.mark.parametrize("name", LATER)
def test_the_surface_is_the_equation(name: str) -> None:
    points = np.random.default_rng(1).uniform(-30.0, 30.0, (2, 20_000))
    surface = later_surface(name)
    error, evidence = ERRORS[name]
    assert np.abs(surface(*points) - heights(name, points)).max() <= max(surface.error, 1e-11)
    assert surface.error <= error
    assert surface.evidence == evidence


@pytest.mark.parametrize("name", ["rings", "knurl", "rock", "chevron"])
def test_measured_errors_hold_next_to_cones_and_creases(name: str) -> None:
    rng = np.random.default_rng(2)
    centre = rng.integers(-4, 5, (2, 20_000)) * (math.pi / 2.0)
    points = centre + rng.normal(size=(2, 20_000)) * 10.0 ** rng.uniform(-4, -1, 20_000)
    surface = later_surface(name)
    assert np.abs(surface(*points) - heights(name, points)).max() <= 1.2 * surface.error


@pytest.mark.parametrize("name", LATER)
def test_default_tolerances_are_large_enough_for_the_texture_itself(name: str) -> None:
    block = Block.of(name)
    assert isinstance(block.sampling, Tolerance)
    error = block.surface.error
    assert block.sampling.mm >= max(2.0 * error, TOLERANCE_MM)
    assert block.step_tolerance_mm >= max(error, STEP_TOLERANCE_MM)
    assert solid_refusal(block) is None
    coarse = 2.0 * error > TOLERANCE_MM
    assert (block.sampling.mm > TOLERANCE_MM) == coarse == bool(error_note(block))
