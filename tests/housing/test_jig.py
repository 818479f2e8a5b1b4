"""The grid-marker jig: markers, walls, errors, and overhangs."""

from __future__ import annotations

import json

import manifold3d
import numpy as np
import pytest
import shapely
from helpers.fixture_measure import cylinders, manifold, overhang_heights, require_sound
from helpers.fixtures import ALL_HOLES, HOLDER, JIG

from housing.holder import Holder
from housing.jig import Jig
from housing.marks import DEPTH_MM, HAIR_MM
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import InputError


def refusal(holder: Holder = HOLDER, **options: object) -> str:
    with pytest.raises(InputError) as error:
        Jig(holder=holder, **options)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    "jig",
    [
        pytest.param(JIG, marks=pytest.mark.long),
        pytest.param(ALL_HOLES, marks=pytest.mark.long),
        Jig(holder=Holder(block=Block.of(1, scale=0.8, key_mm=2.0)), fit="loose"),
        pytest.param(
            Jig(holder=Holder(block=Block.of(1, scale=1.5), slots=2, fit="press", rim_mm=0.0)), marks=pytest.mark.long
        ),
        Jig(holder=Holder(block=Block.of(1, "released"), preset="released")),
    ],
    ids=lambda jig: getattr(jig, "name", None),
)
def test_mesh_and_solid_are_what_is_stated(jig: Jig) -> None:
    part = jig.part()
    require_sound(part)
    assert part.kind == "jig"
    json.dumps(part.spec, allow_nan=False)
    # The marked face is on the bed, so the only overhangs are the floors of the grooves, 0.4 mm above the bed.
    assert overhang_heights(part.mesh[0]) <= {DEPTH_MM}


def test_default_dimensions_and_report() -> None:
    jig = JIG
    assert jig.name == "jig_paper_x1"
    # Holder 45.6 x 52.3 mm, 0.15 mm clearance and 2.4 mm lips all round; 3 mm lip, 1.18 + 0.3 mm recess, 2 mm roof.
    assert jig.size_mm == pytest.approx((50.7, 57.4, 6.48), abs=1e-9)
    assert jig.genus == 5
    text = str(jig)
    for number in ("50.7 x 57.4 x 6.48 mm", "1.5 mm", "2.2 mm", "4, 5.25, 6.5, 7.75, 9 mm", "18, 19.25", "0.4 mm"):
        assert number in text


@pytest.mark.parametrize(("jig", "count", "hole", "lead"), [(JIG, 5, 1.5, 2.2), (ALL_HOLES, 25, 0.6, 0.8)])
def test_holes_have_the_stated_diameters(jig: Jig, count: int, hole: float, lead: float) -> None:
    from build123d import GeomType, Solid

    assert [r for r, _ in cylinders(jig.solid_as_printed)] == pytest.approx([hole / 2] * count)
    cones = Solid(jig.solid_as_printed).faces().filter_by(GeomType.CONE)
    assert len(cones) == count
    for cone in cones:
        box = cone.bounding_box()
        assert pytest.approx(lead, abs=1e-6) == box.size.X
        # The lead-in opens to the marked face, which is on the bed, at 45 degrees.
        assert pytest.approx(0.0, abs=1e-6) == box.min.Z
        assert pytest.approx((lead - hole) / 2, abs=1e-6) == box.max.Z


@pytest.mark.parametrize("scale", [0.8, 1.0, 1.5])
def test_every_position_is_a_hole_or_lies_on_the_hairs_of_its_row_and_column(scale: float) -> None:
    jig = Jig(holder=Holder(block=Block.of(1, scale=scale)))
    grid, keep = jig.grid, 1.1 + 0.4
    assert len(jig.holes_mm) == 5
    assert len(jig.cross_hairs_mm) == 20
    ticks = keep + 0.5
    for x, y in grid.positions_mm:
        # The ticks beyond both ends of the row and of the column point at the position.
        ends = [
            (x, grid.y_mm[0] - ticks),
            (x, grid.y_mm[-1] + ticks),
            (grid.x_mm[0] - ticks, y),
            (grid.x_mm[-1] + ticks, y),
        ]
        assert all(any(shapely.contains_xy(groove, *end) for groove in jig.grooves) for end in ends)
    incomplete = 0
    for x, y in jig.cross_hairs_mm:
        crossed = any(shapely.contains_xy(groove, x, y) for groove in jig.grooves)
        distance = np.linalg.norm(jig.holes_mm - (x, y), axis=1).min()
        if distance > keep + HAIR_MM:
            assert crossed
        if distance < keep:
            assert not crossed
        incomplete += not crossed
    assert incomplete == jig.crossings_cut_short
    assert (incomplete == 0) == (scale == 1.5)


def test_walls_between_markers_are_measured_not_assumed() -> None:
    """An opening of the marked face by a disc of the stated wall removes no wall, but a larger disc does."""
    jig = JIG
    assert jig.walls_mm["wall between markers"] == pytest.approx(0.4)
    section = manifold(jig.part().mesh[0]).slice(0.001)
    x, y = jig.holder.block_placements()[0].origin_mm[:2]
    corners = [(x + jig.grid.x_mm[i] + a, y + jig.grid.y_mm[i] + a, 0.0) for i, a in ((0, -2.4), (-1, 2.4))]
    low, high = np.sort((np.column_stack([corners, (1, 1)]) @ np.linalg.inv(jig.from_print).T)[:, :2], axis=0)
    field = manifold3d.CrossSection.square(tuple(high - low)).translate(tuple(low))
    for width, lost in ((0.39, 0), (0.45, 8)):
        opened = section.offset(-width / 2, manifold3d.JoinType.Round, circular_segments=128)
        opened = opened.offset(width / 2, manifold3d.JoinType.Round, circular_segments=128)
        removed = [piece for piece in ((section - opened) ^ field).decompose() if piece.area() > 0.02]
        assert len(removed) == lost


def test_merging_markers_are_refused_with_the_numbers() -> None:
    text = refusal(Holder(block=Block.of(1, scale=0.7)))
    for number in ("2.475 mm apart", "2.2 mm", "0.2749 mm", "0.4 mm", "0.736"):
        assert number in text
    Jig(holder=Holder(block=Block.of(1, scale=0.736)))
    text = refusal(Holder(block=Block.of(1, scale=0.8)), marks="all")
    for number in ("1 mm apart", "0.8 mm", "0.2 mm", "0.96"):
        assert number in text
    Jig(holder=Holder(block=Block.of(1, scale=0.96)), marks="all")
    Jig(holder=Holder(block=Block.of(1, scale=0.8)), marks="all", nozzle_mm=0.05)
    assert "0.2 mm" in refusal(press_grid=PressGrid.paper(1.0, "1mm"), marks="all")


@pytest.mark.parametrize("count", [16, pytest.param(60, marks=pytest.mark.long)])
def test_no_scale_is_refused_where_the_holes_have_room(count: int) -> None:
    """Hairs with gaps near holes and near each other never merge, at any scale."""
    for scale in np.linspace(0.736, 3.2, count):
        jig = Jig(holder=Holder(block=Block.of(1, scale=float(scale))))
        assert jig.min_wall_mm >= 0.4 - 1e-6
    for scale in np.linspace(0.96, 2.4, count // 4):
        assert Jig(holder=Holder(block=Block.of(1, scale=float(scale))), marks="all").min_wall_mm >= 0.4 - 1e-6


@pytest.mark.parametrize(
    ("holder", "options", "words"),
    [
        (Holder(block=Block.of(1, size_mm=(12.0, 20.0))), {}, ["12 x 20 mm", "9 x 23 mm", "too small"]),
        (HOLDER, {"marks": "most"}, ["jig", "most", "default, all"]),
        (HOLDER, {"nozzle_mm": 5.0}, ["nozzle", "5.0", "1.2 mm"]),
        (HOLDER, {"nozzle_mm": 0.8}, ["0.8 mm", "1.25 x 1.25 mm", "merge"]),
        (HOLDER, {"fit": "wide"}, ["fit", "wide"]),
        (Holder(block=Block.of(1), margin_mm=10.0), {}, ["recess", "screw corner", "0.7071 mm", "must be at least"]),
        (
            Holder(block=Block.of(1, size_mm=(60.0, 60.0))),
            {"press_grid": PressGrid(x_mm=(0.0, 2.0, 4.0, 6.0, 8.0), y_mm=(3.0, 5.0, 7.0, 9.0, 11.0))},
            ["press grid", "x 0 to 8, y 3 to 11 mm", "0.8 mm"],
        ),
    ],
)
def test_refusals_name_the_numbers(holder: Holder, options: dict[str, object], words: list[str]) -> None:
    text = refusal(holder, **options)
    for word in words:
        assert word in text


def test_different_jigs_never_share_a_name() -> None:
    grid = PressGrid(x_mm=(4.0, 5.5, 7.0, 8.5, 10.0), y_mm=(18.0, 19.5, 21.0, 22.5, 24.0))
    jigs = [
        Jig(holder=HOLDER),
        Jig(holder=HOLDER, marks="all"),
        Jig(holder=HOLDER, press_grid=PressGrid.paper(1.0, "1mm")),
        Jig(holder=HOLDER, press_grid=grid),
        Jig(holder=HOLDER, fit="loose"),
        Jig(holder=HOLDER, nozzle_mm=0.3),
        Jig(holder=Holder(block=Block.of(1), slots=2)),
        Jig(holder=Holder(block=Block.of(1), rim_mm=1.0)),
        Jig(holder=Holder(block=Block.of(1, scale=1.5))),
    ]
    assert len({jig.name for jig in jigs}) == len(jigs)
    assert jigs[1].name == "jig_paper_x1_all"
    assert Jig(holder=HOLDER, press_grid=PressGrid.paper()).name == "jig_paper_x1"
