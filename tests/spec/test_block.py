"""Blocks: presets, options, datum, base, key and names."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacbench_cad.lab.runs.info import printed_block_from
from tacbench_cad.lab.study.spec import PrintedBlock
from tacbench_cad.spec.block import MIN_BASE_MM, Block
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.spec.presets import PRESETS
from tacbench_cad.spec.sampling import SampleGrid, Tolerance
from tacbench_cad.spec.sines import Wave
from tacbench_cad.spec.textures import BlockTable, Texture
from tacbench_cad.spec.waves import WaveSum
from tacbench_cad.util.errors import InputError

SINGLE_PEAK = Texture(
    name="peak",
    equation="one hill with its top near the key",
    surface=WaveSum((Wave(amplitude=1.0, f=0.1, g=0.0), Wave(amplitude=1.0, f=0.0, g=0.1, phase=math.pi / 2))),
)


def test_the_presets_agree_with_the_paper() -> None:
    paper, released = Block.of(4), Block.of(4, "released")
    assert paper.size_mm == (23.3, 30.0)
    assert paper.domain == (pytest.approx((0.0, 6 * math.pi + 0.5)), pytest.approx((0.0, 6 * math.pi + 1.2)))
    assert paper.mm_per_unit[2] == 1.0
    assert paper.sampling == Tolerance(mm=0.01)
    assert released.size_mm == (29.3, 30.0)
    assert released.mm_per_unit == (1.0, 1.0, 1.0)
    assert released.sampling == SampleGrid(nx=294, ny=301)
    assert {paper.height_mm, released.height_mm} == {7.0}
    assert len(paper.texture.surface.waves) == 26
    assert len(released.texture.surface.waves) == 102


@pytest.mark.parametrize(("number", "relief"), [(1, 2.0), (2, 4.0), (3, 3.937), (4, 4.693), (5, 1.969), (6, 2.346)])
def test_the_released_relief_is_the_published_relief(number: int, relief: float) -> None:
    block = Block.of(number, "released")
    x, y = block.samples_mm
    z = block.surface.grid(x, y)
    assert z.max() - z.min() == pytest.approx(relief, abs=6e-4)
    assert np.max(block.height_at(x[:, None], y[None, :])) == pytest.approx(7.0, abs=1e-12)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("number", range(1, 7))
def test_the_highest_point_is_at_the_height(number: int, preset: str) -> None:
    block = Block.of(number, preset)
    x, y = block.extremes.at_high
    assert block.formula_datum_mm + float(block.surface(x, y)) == pytest.approx(7.0, abs=1e-9)
    assert block.base_mm == pytest.approx(7.0 - block.relief_mm)


def test_scale_multiplies_everything_except_the_domain() -> None:
    original, scaled = Block.of(4), Block.of(4, scale=2.5)
    assert scaled.size_mm == (23.3 * 2.5, 75.0)
    assert scaled.height_mm == 17.5
    assert scaled.relief_mm == pytest.approx(2.5 * original.relief_mm)
    assert scaled.domain == original.domain
    x, y = np.linspace(0, 23.3, 50), np.linspace(0, 30, 50)
    np.testing.assert_allclose(scaled.height_at(2.5 * x, 2.5 * y), 2.5 * original.height_at(x, y), atol=1e-9)


def test_size_keeps_the_mapping_and_mm_per_unit_keeps_the_size() -> None:
    plain = Block.of(2)
    resized = Block.of(2, size_mm=(40.0, 50.0))
    assert resized.mm_per_unit == plain.mm_per_unit
    assert resized.domain[0][1] == pytest.approx(40.0 / plain.mm_per_unit[0])
    coarse = Block.of(2, mm_per_unit=(2.0, 3.0, 0.5))
    assert coarse.size_mm == plain.size_mm
    assert coarse.domain == ((0.0, 23.3 / 2.0), (0.0, 10.0))
    assert coarse.relief_mm == pytest.approx(2.0, abs=1e-6)
    both = Block.of(2, mm_per_unit=(2.0, 3.0, 0.5), size_mm=(20.0, 30.0), height_mm=5.0, scale=2.0)
    assert both.domain == ((0.0, 10.0), (0.0, 10.0))
    assert both.size_mm == (40.0, 60.0)
    assert both.height_mm == 10.0


def test_the_message_about_a_thin_base_names_a_sufficient_height() -> None:
    with pytest.raises(InputError, match=r"1\.518 mm less than the 0\.8 mm.*use a height of at least 5\.52 mm"):
        Block.of(4, height_mm=4.0)
    assert Block.of(4, height_mm=5.52).base_mm >= MIN_BASE_MM
    with pytest.raises(InputError, match="below the label"):
        Block.of(4, height_mm=5.52, label=True)
    assert Block.of(4, height_mm=5.92, label=True).base_mm >= MIN_BASE_MM + LABEL_DEPTH_MM


def test_the_preset_released_with_another_size_needs_a_sampling() -> None:
    for options in ({"size_mm": (40.0, 40.0)}, {"height_mm": 8.0}, {"mm_per_unit": (1.0, 1.0, 0.5)}):
        with pytest.raises(InputError, match="--grid or --tolerance"):
            Block.of(2, "released", **options)
    assert Block.of(2, "released", scale=2.0).sampling == SampleGrid(nx=294, ny=301)
    wider = Block.of(2, "released", size_mm=(40.0, 50.0), sampling="grid")
    assert wider.sampling == SampleGrid(nx=401, ny=501)


def test_the_block_table_of_a_texture_file_replaces_the_preset() -> None:
    domain = ((1.0, 11.0), (2.0, 22.0))
    block = Block.of(SINGLE_PEAK, table=BlockTable(domain=domain, mm_per_unit=(2.0, 1.5, 1.0), height_mm=6.0))
    assert block.size_mm == (20.0, 30.0)
    assert block.domain == (pytest.approx(domain[0]), pytest.approx(domain[1]))
    assert float(block.surface(0.0, 0.0)) == pytest.approx(float(SINGLE_PEAK.surface(1.0, 2.0)))
    stretched = Block.of(SINGLE_PEAK, table=BlockTable(domain=domain, size_mm=(30.0, 30.0)))
    assert stretched.mm_per_unit == pytest.approx((3.0, 1.5, 1.0))
    with pytest.raises(InputError, match="leave one of the three out"):
        Block.of(SINGLE_PEAK, table=BlockTable(domain=domain, size_mm=(30.0, 30.0), mm_per_unit=(1.0, 1.0, 1.0)))
    with pytest.raises(InputError, match="lower end"):
        Block.of(SINGLE_PEAK, table=BlockTable(domain=((1.0, 1.0), (0.0, 2.0))))
    with pytest.raises(InputError, match="--grid"):
        Block.of(SINGLE_PEAK, "released", table=BlockTable(height_mm=6.5))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scale": 0.0}, "scale = 0.0"),
        ({"scale": math.nan}, "scale = nan"),
        ({"scale": math.inf}, "scale = inf"),
        ({"scale": -1.0}, "scale = -1.0"),
        ({"size_mm": (math.nan, 30.0)}, "size x = nan"),
        ({"size_mm": (30.0, -1.0)}, r"size y = -1.0"),
        ({"size_mm": (3000.0, 30.0)}, "size x = 3000.0"),
        ({"height_mm": 0.0}, "height = 0.0"),
        ({"height_mm": math.inf}, "height = inf"),
        ({"mm_per_unit": (0.0, 1.0, 1.0)}, "mm per unit x = 0.0"),
        ({"mm_per_unit": (1.0, 1.0, math.nan)}, "mm per unit z = nan"),
        ({"key_mm": 0.0}, "key = 0.0"),
        ({"key_mm": 8.0}, r"key = 8.0.*7.767"),
        ({"copy": 0}, "copy = 0"),
        ({"preset": "papr"}, 'did you mean "paper"'),
        ({"texture": "9"}, "texture = '9'"),
    ],
)
def test_bad_values_are_named(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Block.of(**{"texture": 4, **options})  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [0.0, -0.01, math.nan, math.inf])
def test_bad_tolerances_and_grids_are_named(value: float) -> None:
    with pytest.raises(InputError, match="tolerance"):
        Tolerance(mm=value)
    with pytest.raises(InputError, match="grid nx"):
        SampleGrid(nx=1, ny=20)


def test_the_corner_of_the_key_does_not_count_for_the_height() -> None:
    plain = Block.of(SINGLE_PEAK)
    assert plain.extremes.at_high[1] == pytest.approx(0.0, abs=1e-6)
    keyed = Block.of(SINGLE_PEAK, key_mm=7.0)
    x, y = keyed.extremes.at_high
    assert keyed.region is not None
    assert float(keyed.region.distance(x, y)) <= 1e-9
    xs, ys = np.meshgrid(np.linspace(0, 23.3, 401), np.linspace(0, 30, 401))
    inside = keyed.region.distance(xs, ys) <= 0
    sampled = keyed.surface(xs[inside], ys[inside]).max()
    assert sampled <= keyed.extremes.high + keyed.extremes.error
    assert sampled == pytest.approx(keyed.extremes.high, abs=1e-3)


@pytest.mark.parametrize("number", [2, 4, 6])
@pytest.mark.parametrize("key", [None, 3.0, 7.5])
def test_the_closed_form_volume_agrees_with_quadrature(number: int, key: float | None) -> None:
    block = Block.of(number, key_mm=key)
    x, y = block.size_mm
    nodes, weights = np.polynomial.legendre.leggauss(400)
    xs, ys = x * (nodes + 1) / 2, y * (nodes + 1) / 2
    integral = float(x * y / 4 * (weights @ block.height_at(xs[:, None], ys[None, :]) @ weights))
    corner = 0.0
    if key is not None:
        s, t = (nodes[:, None] + 1) / 2, (nodes[None, :] + 1) / 2
        values = block.height_at(x - key + key * s, key * s * t) * key**2 * s
        corner = float(weights @ values @ weights / 4)
    assert block.volume_mm3(block.datum_mm) == pytest.approx(integral - corner, rel=1e-8)


def test_the_volume_of_the_label_is_subtracted() -> None:
    plain, labelled = Block.of(2), Block.of(2, copy=3)
    assert labelled.engraving is not None
    difference = plain.volume_mm3(plain.datum_mm) - labelled.volume_mm3(labelled.datum_mm)
    assert difference == pytest.approx(labelled.engraving.area_mm2 * LABEL_DEPTH_MM)
    assert labelled.label_words == ("T2", "PAPER", "X1", "03")


def test_only_the_published_grids_of_4_and_6_alias() -> None:
    aliased = [b.name for p in PRESETS for n in range(1, 7) if (b := Block.of(n, p, sampling="grid")).grid_aliases]
    assert aliased == ["texture-4_released_x1", "texture-6_released_x1"]


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({}, "texture-4_paper_x1"),
        ({"preset": "released"}, "texture-4_released_x1"),
        ({"scale": 0.5}, "texture-4_paper_x0.5"),
        ({"scale": 2 / 3}, "texture-4_paper_x0.6666666666666666"),
        ({"size_mm": (40.0, 40.0)}, "texture-4_paper_x1_40x40x7"),
        ({"height_mm": 7.5}, "texture-4_paper_x1_23.3x30x7.5"),
        ({"mm_per_unit": (1.0, 1.25, 1.0)}, "texture-4_paper_x1_mm1x1.25x1"),
        ({"key_mm": 2.0}, "texture-4_paper_x1_key2"),
        ({"sampling": "grid"}, "texture-4_paper_x1_grid189x201"),
        ({"sampling": Tolerance(mm=0.005)}, "texture-4_paper_x1_tol0.005"),
        ({"sampling": Tolerance(mm=0.01)}, "texture-4_paper_x1"),
        ({"copy": 3}, "texture-4_paper_x1_copy03"),
        ({"label": True}, "texture-4_paper_x1_label"),
        ({"preset": "released", "sampling": Tolerance()}, "texture-4_released_x1_tol0.01"),
    ],
)
def test_names_contain_options_that_are_not_default(options: dict[str, object], name: str) -> None:
    assert Block.of(**{"texture": 4, **options}).name == name  # type: ignore[arg-type]


MILLIMETRES = "[block]\nmm_per_unit = [0.28489, 0.28489, 0.21]\ndomain = [[-1.0, 90.0], [2.0, 95.0]]\n"


@pytest.mark.parametrize(
    ("wave", "block", "options", "rest"),
    [
        ("wavelength_mm = 1.3\nangle_deg = 60", "", {}, ""),
        ("wavelength_mm = 1.3\nangle_deg = 60", "[block]\nsize_mm = [20, 21]\nheight_mm = 6\n", {}, "_20x21x6"),
        ("wavelength_mm = 1.3\nangle_deg = 60", "[block]\nsize_mm = [20, 21]\n", {"size_mm": (23.3, 30.0)}, ""),
        ("f = 1.0\ng = 0.5", MILLIMETRES, {"size_mm": (30.0, 30.0), "key_mm": 3.0}, "_30x30x7_key3"),
        (
            "f = 1.0\ng = 0.5",
            MILLIMETRES,
            {"size_mm": (9.0, 9.0), "mm_per_unit": (1.5, 1.0, 0.2)},
            "_9x9x7_mm1.5x1x0.2",
        ),
        ("f = 1.0\ng = 0.5", "[block]\noutline = 'disc:20'\nheight_mm = 6\n", {}, "_disc20_h6"),
    ],
)
def test_names_state_what_differs_from_the_texture_file(
    wave: str, block: str, options: dict[str, Any], rest: str, tmp_path: Path
) -> None:
    """The name is short, and a run folder keeps the same block."""
    path = tmp_path / "bumps.toml"
    head = '[texture]\nname = "slider-bumps"\nfamily = "plane-waves"\n[[wave]]\namplitude = 0.3\n'
    path.write_text(f"{head}{wave}\n{block}", encoding="utf-8")
    own = Block.of(path, **options)
    assert own.name == f"slider-bumps_paper_x1{rest}"
    stored = printed_block_from(PrintedBlock(block=own, printer="ender-3", filament="pla").as_dict())
    assert (stored.block, stored.block.name) == (own, own.name)
