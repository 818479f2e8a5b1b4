"""Solids whose surface is a spline: the patches are its own pieces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tacbench_cad.geometry.brep import solid_refusal
from tacbench_cad.geometry.splines.exact import spline_patches
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.interpolation import height_map
from tacbench_cad.spec.textures import Texture
from tacbench_cad.util.errors import InputError


def hills(count: int) -> Texture:
    """A height map of 12 x 12 mm."""
    x = np.linspace(0.0, 12.0, count)
    heights = np.sin(x)[:, None] * np.cos(1.3 * x)[None, :]
    return Texture(name="hills", surface=height_map(heights, mm_per_pixel=12.0 / (count - 1)))


def block(count: int = 40, **options: float) -> Block:
    return Block.of(hills(count), mm_per_unit=(1, 1, 1), size_mm=(12.0, 12.0), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("thing", [block(), Block.of("diamond"), Block.of("dimples")], ids=lambda one: one.texture.name)
def test_the_patches_are_the_surface(thing: Block) -> None:
    patches = spline_patches(thing, 0.001)
    x, y = np.random.default_rng(0).uniform((0.0, 0.0), thing.size_mm, (300, 2)).T
    for i in range(patches.x.patches):
        for j in range(patches.y.patches):
            here = (x >= patches.x.lines[i]) & (x < patches.x.lines[i + 1])
            here &= (y >= patches.y.lines[j]) & (y < patches.y.lines[j + 1])
            left = patches.x.values(i, (x[here] - patches.x.lines[i]) / np.diff(patches.x.lines)[i])
            right = patches.y.values(j, (y[here] - patches.y.lines[j]) / np.diff(patches.y.lines)[j])
            z = np.einsum("ki,ij,kj->k", left, patches.heights_mm(i, j), right)
            np.testing.assert_allclose(z, thing.solid_datum_mm + thing.surface(x[here], y[here]), atol=1e-10)
    for axis, creases in zip((patches.x, patches.y), thing.surface.creases, strict=True):
        assert np.isin(creases, axis.lines).all()


def test_large_height_maps_have_no_solid() -> None:
    large = block(420)
    assert solid_refusal(block()) is None
    assert "420 x 420 poles, and a solid may have 160,000 at most" in str(solid_refusal(large))


def test_the_error_of_the_texture_limits_the_solid() -> None:
    with pytest.raises(InputError, match=r"step-tolerance = 0\.0001: must be larger than the error .* of the texture"):
        spline_patches(Block.of("knurl"), 0.0001)


@pytest.mark.parametrize("key_mm", [None, 2.5])
def test_the_solid_passes_all_checks_of_the_kernel(key_mm: float | None, tmp_path: Path) -> None:
    pytest.importorskip("OCP")
    from tacbench_cad.making.writing import export

    report = export(replace(block(24), key_mm=key_mm), tmp_path / "hills.step", full=True)
    assert report.ok, report.faults
    assert report.deviation_mm is not None
    assert report.deviation_mm < 2e-6
