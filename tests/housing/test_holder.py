"""The holder: dimensions, walls, key, and errors."""

from __future__ import annotations

import itertools
import json
import math

import manifold3d
import numpy as np
import pytest
from helpers.fixture_measure import cylinders, manifold, outline_of, overhang_heights, require_sound

from housing.fits import FITS, clearance_mm, min_key_mm
from housing.holder import Holder
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError

PAPER = Block.of(1)
KEYED = Block.of(1, key_mm=3.0)


def refusal(**options: object) -> str:
    with pytest.raises(InputError) as error:
        Holder(**{"block": PAPER, **options})  # type: ignore[arg-type]
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    "holder",
    [
        Holder(block=PAPER),
        Holder(block=KEYED, slots=6, fit="loose"),
        Holder(block=Block.of(4, scale=0.8, key_mm=2.0), slots=2, fit=0.2, rim_mm=0.0),
        Holder(block=PAPER, quarter_turns=3, slots=5, floor_mm=1.2, margin_mm=9.0, web_mm=1.6),
        Holder(block=Block.of(2, scale=0.35)),
        Holder(block=Block.of(1, "released"), preset="released"),
    ],
    ids=lambda holder: holder.name,
)
def test_mesh_and_solid_are_what_is_stated(holder: Holder) -> None:
    part = holder.part()
    require_sound(part)
    assert part.kind == "holder"
    assert part.mesh_needs_cad
    json.dumps(part.spec, allow_nan=False)
    assert overhang_heights(part.mesh[0]) == set()


def test_default_dimensions() -> None:
    holder = Holder(block=PAPER)
    assert holder.name == "holder_paper_x1"
    assert holder.pocket_size_mm == pytest.approx((23.6, 30.3, 5.82), abs=1e-12)
    assert holder.size_mm == pytest.approx((45.6, 52.3, 7.47), abs=1e-12)
    assert holder.part().size_mm == (45.6, 52.3, 7.47)
    assert holder.part().spec["pocket_size_mm"] == (23.6, 30.3, 5.82)
    assert holder.rim_height_mm == 1.18
    assert holder.genus == 5
    assert sorted(r for r, _ in cylinders(holder.solid_as_printed)) == [2.0, 2.0, 2.0, 2.0, 3.0]


def test_clearances_walls_rim_and_holes_do_not_scale() -> None:
    for scale in (0.8, 1.5):
        block = Block.of(1, scale=scale)
        holder = Holder(block=block)
        x, y = block.size_mm
        assert holder.pocket_size_mm == pytest.approx((x + 0.3, y + 0.3, 7.0 * scale - 1.18), abs=1e-12)
        assert holder.size_mm == pytest.approx((x + 22.3, y + 22.3, 7.0 * scale + 0.47), abs=1e-12)
        assert {bore.diameter_mm for bore in holder.screws} == {4.0}
        assert {bore.diameter_mm for bore in holder.push_outs} == {6.0}


@pytest.mark.parametrize("slots", [1, 2, 3, 5, 6, 12])
def test_slots_do_not_overlap_and_lie_in_the_plate(slots: int) -> None:
    holder = Holder(block=PAPER, slots=slots)
    assert len(holder.pockets) == len(holder.block_placements()) == holder.slots == slots
    x, y, _ = holder.size_mm
    for a, b in itertools.combinations(holder.pockets, 2):
        gap_mm = a.polygon.distance(b.polygon)
        assert gap_mm >= holder.web_mm - 1e-9
    for pocket in holder.pockets:
        assert min(*pocket.low, x - pocket.high[0], y - pocket.high[1]) >= holder.margin_mm - 1e-9


def test_push_out_hole_keeps_clear_of_the_press_positions() -> None:
    for scale in (0.5, 0.8, 1.0, 1.5, 3.0):
        holder = Holder(block=Block.of(1, scale=scale))
        assert holder.push_out is not None
        assert holder.push_out.ledge_mm >= 1.6
        if scale >= 0.8:
            assert holder.push_out.clear_of_press_mm >= 2.0
            assert f"{holder.push_out.clear_of_press_mm:.3g} mm" in " ".join(holder.spec()["notes"])


def test_the_preset_released_is_the_holder_of_the_authors() -> None:
    block = Block.of(1, "released")
    holder = Holder(block=block, preset="released")
    assert holder.name == "holder_released_x1_measured"
    assert holder.size_mm == (45.39, 65.01, 7.47)
    assert holder.pocket_size_mm == (31.1, 30.0, 5.82)
    assert holder.rim_height_mm == 1.18
    pocket = holder.pockets[0]
    edges = (pocket.low[0], 45.39 - pocket.high[0], pocket.low[1], 65.01 - pocket.high[1])
    assert edges == pytest.approx((9.98, 4.31, 30.51, 4.50), abs=1e-9)
    mesh, _ = holder.part().mesh
    floor = mesh.vertices[np.abs(mesh.vertices[:, 2] - 1.65) < 1e-5]
    assert floor[:, :2].min(axis=0) == pytest.approx((9.98, 30.51), abs=1e-5)
    assert floor[:, :2].max(axis=0) == pytest.approx((41.08, 60.51), abs=1e-5)
    holes = sorted((round(float(x), 6), round(float(y), 6), r) for r, (x, y) in cylinders(holder.solid_as_printed))
    assert holes == [(3.31, 62.13, 2.0), (3.57, 3.10, 2.0), (42.31, 3.10, 2.0), (42.31, 62.13, 2.0)]
    # With the block's y along the plate's x, the total clearances are 1.1 and 0.7 mm; otherwise 1.8 and 0.0 mm.
    assert holder.clearance_mm == pytest.approx((0.55, 0.35), abs=1e-9)
    other = Holder(block=block, preset="released", quarter_turns=0)
    assert other.clearance_mm == pytest.approx((0.9, 0.0), abs=1e-9)
    assert other.name != holder.name
    assert any("our assumption" in note for note in holder.spec()["notes"])
    assert holder.admits_deg == (0, 90, 180, 270)
    # One hole nearly touches the pocket, and the holder states this.
    assert holder.min_wall_mm == pytest.approx(math.hypot(42.31 - 41.08, 62.13 - 60.51) - 2.0, abs=1e-9)


def test_the_preset_released_cannot_be_changed() -> None:
    block = Block.of(1, "released")
    for option in ({"fit": "loose"}, {"rim_mm": 1.0}, {"slots": 2}, {"floor_mm": 2.0}):
        text = refusal(block=block, preset="released", **option)
        assert str(next(iter(option.values()))) in text
        assert "use the preset fitted" in text
    assert "31.1 x 30 mm" in refusal(preset="released")
    assert "58.6" in refusal(block=Block.of(1, "released", scale=2.0), preset="released")
    assert "no key" in refusal(block=Block.of(1, "released", key_mm=3.0), preset="released")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fit": "tight"}, ["fit", "tight", "press"]),
        ({"fit": -0.1}, ["fit", "-0.1", "0 to 1 mm"]),
        ({"fit": math.nan}, ["fit", "nan"]),
        ({"fit": 1.5}, ["1.5", "1 mm per side"]),
        ({"rim_mm": 6.5}, ["rim", "6.5", "0 to 6 mm"]),
        ({"rim_mm": -0.1}, ["rim", "-0.1"]),
        ({"rim_mm": math.inf}, ["rim", "inf"]),
        ({"slots": 0}, ["slots", "0", "1 to 24"]),
        ({"slots": 25}, ["slots", "25"]),
        ({"slots": True}, ["slots"]),
        ({"floor_mm": 1.1}, ["floor", "1.1 mm", "1.2 mm"]),
        ({"web_mm": 1.5, "slots": 2}, ["web", "1.5 mm", "1.6 mm"]),
        ({"margin_mm": 6.9}, ["margin", "screw hole to pocket", "1.394 mm", "1.6 mm"]),
        ({"nozzle_mm": 0.0}, ["nozzle", "0.02 to 1.2 mm"]),
        ({"preset": "releasd"}, ["releasd", 'did you mean "released"?']),
        ({"quarter_turns": 4}, ["4", "0, 1, 2 or 3"]),
        ({"block": Block.of(1, scale=0.2)}, ["rim", "1.4 mm high", "1 mm"]),
        ({"block": Block.of(1, size_mm=(6.0, 30.0))}, ["ledge", "1.5 mm", "1.6 mm"]),
    ],
)
def test_refusals_name_the_numbers(options: dict[str, object], words: list[str]) -> None:
    text = refusal(**options)
    for word in words:
        assert word in text


def test_no_wall_is_thinner_than_stated() -> None:
    """An opening of the plate by half of the thinnest wall removes nothing, so no wall is thinner than stated."""
    holder = Holder(block=KEYED, slots=2, margin_mm=8.0, web_mm=1.7)
    assert holder.min_wall_mm == min(holder.walls_mm.values()) == 1.65
    section = manifold(holder.part().mesh[0]).slice(holder.size_mm[2] - 1.0)
    thinnest = min(wall for name, wall in holder.walls_mm.items() if "floor" not in name and "ledge" not in name)
    opened = section.offset(-thinnest / 2 + 0.005, manifold3d.JoinType.Round, circular_segments=256)
    reopened = opened.offset(thinnest / 2, manifold3d.JoinType.Round, circular_segments=256)
    assert (section - reopened).area() < 0.6  # the corners of the plate, because an opening rounds them
    thinner = section.offset(-thinnest / 2 - 0.05, manifold3d.JoinType.Round, circular_segments=256)
    assert (section - thinner.offset(thinnest / 2 + 0.06, manifold3d.JoinType.Round)).area() > 20.0


@pytest.mark.parametrize("fit", [*FITS, 0.0, 0.2])
def test_a_block_with_a_key_fits_in_one_orientation(fit: str | float) -> None:
    """Compare the block with the pocket's outline in all four orientations, shifted and tilted in the clearance."""
    c = clearance_mm(fit)
    rng = np.random.default_rng(3)
    for size in ((23.3, 30.0), (30.0, 30.0), (30.0, 30.0 + 1.9 * c)):
        smallest = min_key_mm(fit)
        for key in (smallest + 0.01, 3.0):
            block = Block.of(1, size_mm=size, key_mm=key)
            pocket = Holder(block=block, fit=fit).pocket_outline()
            assert _fits_in(outline_of(block), pocket, 0, c, rng)
            for turns in (1, 2, 3):
                assert not _fits_in(outline_of(block), pocket, turns, c, rng)


def test_a_key_that_allows_a_half_turn_is_refused() -> None:
    rng = np.random.default_rng(4)
    for fit, c in FITS.items():
        smallest = min_key_mm(fit)
        assert smallest == pytest.approx((2.0 + math.sqrt(2.0)) * c)
        block = Block.of(1, key_mm=smallest - 0.01)
        text = refusal(block=block, fit=fit)
        assert f"above {smallest:.4g} mm" in text
        assert f"{c:g} mm per side" in text
        # The pocket of the refused holder: the pocket for the next larger key, with its corner moved back.
        pocket = Holder(block=Block.of(1, key_mm=smallest + 0.01), fit=fit).pocket_outline()
        pocket[1, 0] += 0.02
        pocket[2, 1] -= 0.02
        assert _fits_in(outline_of(block), pocket, 2, c, rng)


def _fits_in(outline: np.ndarray, pocket: np.ndarray, turns: int, c: float, rng: np.random.Generator) -> bool:
    """Return whether a turned outline fits into a convex pocket with any shift and any of many small tilts.

    For a given angle the possible shifts form a polygon. A linear program with one bound for each edge of the pocket
    decides exactly whether the polygon is empty. The tilts are sampled.
    """
    from scipy.optimize import linprog

    edges = np.roll(pocket, -1, axis=0) - pocket
    normals = np.column_stack([edges[:, 1], -edges[:, 0]]) / np.linalg.norm(edges, axis=1)[:, None]
    limits = np.einsum("ij,ij->i", normals, pocket)
    max_shift = 4.0 * c / 30.0
    for tilt in (0.0, *rng.uniform(-max_shift, max_shift, 12)):
        angle = turns * math.pi / 2.0 + tilt
        turned = outline @ np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        reach = (turned @ normals.T).max(axis=0)
        if linprog([0.0, 0.0], A_ub=normals, b_ub=limits - reach + 1e-9, bounds=[(None, None)] * 2).status == 0:
            return True
    return False


def test_holders_without_a_key_state_the_possible_orientations() -> None:
    assert Holder(block=PAPER).admits_deg == (0, 180)
    assert Holder(block=KEYED).admits_deg == (0,)
    nearly_square = Block.of(1, size_mm=(30.0, 30.25))
    assert Holder(block=nearly_square).admits_deg == (0, 90, 180, 270)
    assert Holder(block=nearly_square, fit="press").admits_deg == (0, 180)
    assert any("0 or 90 or 180 or 270" in note for note in Holder(block=nearly_square).spec()["notes"])


def test_different_holders_never_share_a_name() -> None:
    blocks = [PAPER, KEYED, Block.of(1, scale=0.8), Block.of(1, size_mm=(24.0, 30.0)), Block.of(1, height_mm=8.0)]
    blocks.append(Block.of(1, "released"))
    holders = [Holder(block=block, **options) for block in blocks for options in _OPTIONS]
    holders.append(Holder(block=Block.of(1, "released"), preset="released"))
    names = [holder.name for holder in holders]
    assert len(set(names)) == len(names)
    # Options that do not change a holder do not change its name.
    other = Block.of(3, label=True, copy=2, sampling="grid")
    assert Holder(block=other).name == "holder_paper_x1"
    assert Holder(block=PAPER, slots=6, fit=0.2, rim_mm=1.0).name == "holder_paper_x1_slots6_fit0.2_rim1"
    assert Holder(block=PAPER, fit=0.15).name == Holder(block=PAPER).name


_OPTIONS: tuple[dict[str, object], ...] = (
    {},
    {"slots": 2},
    {"fit": "loose"},
    {"fit": 0.2},
    {"rim_mm": 1.0},
    {"floor_mm": 2.0},
    {"margin_mm": 12.0},
    {"quarter_turns": 1},
    {"slots": 2, "web_mm": 9.0},
)
