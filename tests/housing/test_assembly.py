"""Assemblies: the parts do not collide, the clearances are the stated ones, and markers are at press positions."""

from __future__ import annotations

from functools import cache

import manifold3d
import numpy as np
import pytest
from helpers.cases import mostly_long
from helpers.fixture_measure import block_prism, cylinders, manifold, require_sound
from helpers.fixtures import HOLDER, JIG, KEYED, KEYED_JIG

from housing.holder import Holder
from housing.jig import Jig
from housing.placement import Placement
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.geometry.solids import tessellate
from tacbench_cad.spec.block import Block

#: The largest common volume of touching parts, caused by rounding to float32, in mm^3. It is far below 0.001 mm times
#: the sides of the plate.
TOUCHING_MM3 = 0.01

CASES = [
    HOLDER,
    Holder(block=Block.of(1, key_mm=3.0), slots=2, fit="loose"),
    Holder(block=Block.of(1, scale=0.8, key_mm=2.0)),
    Holder(block=Block.of(1, scale=0.8), fit="press"),
    Holder(block=Block.of(1, scale=1.5, key_mm=5.0), fit=0.2, rim_mm=0.5),
    Holder(block=Block.of(1, key_mm=3.0), quarter_turns=1),
    Holder(block=Block.of(1, "released"), preset="released"),
]
TRAY = Holder(block=Block.of(1, key_mm=3.0), slots=6)


@cache
def meshed(holder: Holder) -> tuple[Jig, manifold3d.Manifold, manifold3d.Manifold]:
    """Return the jig of a holder, the mesh of the holder, and the mesh of the jig in its place of use."""
    shared = {known.holder: known for known in (JIG, KEYED_JIG)}
    jig = shared.get(holder) or Jig(holder=holder)
    return jig, manifold(holder.part().mesh[0]), manifold(tessellate(jig.solid_in_use))


def placed(block: Block, place: Placement, shift: tuple[float, float] = (0.0, 0.0)) -> manifold3d.Manifold:
    """Return the prism of the block in its place in the holder, shifted."""
    x, y, z = place.origin_mm
    return block_prism(block).rotate((0.0, 0.0, 90.0 * place.quarter_turns)).translate((x + shift[0], y + shift[1], z))


@pytest.mark.parametrize(
    "holder",
    mostly_long([*CASES, TRAY], CASES[1], CASES[5]),
    ids=lambda holder: getattr(holder, "name", None),
)
def test_nothing_collides_and_markers_are_over_their_positions(holder: Holder) -> None:
    jig, plate, seated = meshed(holder)
    blocks = [placed(holder.block, place) for place in holder.block_placements()]
    assert len(blocks) == holder.slots
    assert (plate ^ seated).volume() < TOUCHING_MM3
    for block in blocks:
        assert (plate ^ block).volume() < TOUCHING_MM3
        assert (seated ^ block).volume() < TOUCHING_MM3
        # The block's highest point is above the rim by the stated height, and the jig is 0.3 mm above that point.
        top = block.bounding_box()[5]
        assert top - holder.size_mm[2] == pytest.approx(holder.rim_height_mm, abs=1e-5)
        raised = block.translate((0.0, 0.0, 0.29))
        assert (seated ^ raised).volume() < TOUCHING_MM3
        assert (seated ^ block.translate((0.0, 0.0, 0.32))).volume() > 1.0
    # If the jig is moved down by 0.02 mm, it touches the rim: the jig rests on the rim.
    assert (plate ^ seated.translate((0.0, 0.0, -0.02))).volume() > 1.0
    _markers_are_over_their_positions(jig)


def _markers_are_over_their_positions(jig: Jig) -> None:
    axes = np.array([point for _, point in cylinders(jig.solid_in_use)])
    counts = np.zeros(len(axes), dtype=int)
    for place in jig.holder.block_placements():
        in_block = place.to_block(axes)
        for position in jig.grid.positions_mm[[0, 4, 12, 20, 24]]:
            near = np.abs(in_block - position).max(axis=1) < 1e-6
            assert near.sum() == 1
            counts += near
    assert (counts == 1).all()


@pytest.mark.parametrize("holder", mostly_long(CASES, CASES[1], CASES[5]), ids=lambda holder: holder.name)
def test_clearances_are_as_named(holder: Holder) -> None:
    """A block and the jig can be shifted by the stated clearance to every side, but no further."""
    jig, plate, seated = meshed(holder)
    for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        (cx, cy), (jx, jy) = holder.clearance_mm, jig.clearance_mm
        for place in holder.block_placements():
            assert (plate ^ placed(holder.block, place, (x * cx, y * cy))).volume() < TOUCHING_MM3
            too_far = placed(holder.block, place, (x * (cx + 0.01), y * (cy + 0.01)))
            assert (plate ^ too_far).volume() > 0.5
        assert (plate ^ seated.translate((x * jx, y * jy, 0.0))).volume() < TOUCHING_MM3
        assert (plate ^ seated.translate((x * (jx + 0.01), y * (jy + 0.01), 0.0))).volume() > 0.5


def test_the_keyed_corner_has_the_same_clearance() -> None:
    holder = KEYED
    plate, place = meshed(holder)[1], holder.block_placements()[0]
    step = 0.15 / np.sqrt(2.0)
    assert (plate ^ placed(holder.block, place, (step, -step))).volume() < TOUCHING_MM3
    step += 0.01
    corner = plate ^ placed(holder.block, place, (step, -step))
    assert corner.volume() > 0.1
    low = corner.bounding_box()[:2]
    assert np.array(low) == pytest.approx(place.to_holder([[20.3, 0.0]])[0], abs=0.3)


def test_block_and_jig_pushed_to_one_corner_leave_the_markers_in_place() -> None:
    for fit, shift in (("slip", 0.0), ("loose", 0.0), ("press", 0.10)):
        jig = Jig(holder=Holder(block=Block.of(1), fit=fit))
        assert jig.datum_shift_mm == pytest.approx((shift, shift), abs=1e-12)
        jig_moves, block_moves = jig.clearance_mm[0], jig.holder.clearance_mm[0]
        assert jig_moves - block_moves == pytest.approx(shift, abs=1e-12)
        assert f"{shift:g} x {shift:g} mm" in " ".join(jig.spec()["notes"])


def test_printed_and_seated_are_the_same_part() -> None:
    jig, _, _ = meshed(CASES[1])
    printed, _ = jig.part().mesh
    seated = tessellate(jig.solid_in_use, 0.005)
    turned = seated.vertices * (1.0, -1.0, -1.0)
    turned -= turned.min(axis=0)
    order, other = np.lexsort(turned.round(3).T), np.lexsort(printed.vertices.round(3).T)
    assert turned[order] == pytest.approx(printed.vertices[other], abs=2e-5)
    assert Mesh(turned, seated.faces).transformed(jig.from_print).vertices == pytest.approx(seated.vertices, abs=2e-6)


def test_a_real_block_of_the_formula_fits() -> None:
    """The textured block itself, with the overshoot of texture 4, and not only its prism."""
    from tacbench_cad.geometry.block_mesh import mesh_block

    holder = KEYED  # of a block of the same size
    _, plate, seated = meshed(holder)
    mesh, _ = mesh_block(Block.of(4, key_mm=3.0))
    place = holder.block_placements()[0]
    block = manifold(mesh).translate(place.origin_mm)
    assert block.bounding_box()[5] - holder.size_mm[2] == pytest.approx(1.18, abs=1e-5)
    assert (block ^ plate).volume() < TOUCHING_MM3
    assert (block ^ seated).volume() < TOUCHING_MM3


@pytest.mark.parametrize("seed", mostly_long(range(63), 0))
def test_random_assemblies(seed: int) -> None:
    """For any scale, key, fit, rim, turn and number of slots, the parts are valid and fit together."""
    rng = np.random.default_rng(seed)
    scale = round(float(rng.uniform(0.74, 2.5)), 3)
    key = None if rng.random() < 0.5 else round(float(rng.uniform(1.2, 23.3 * scale / 3.0)), 2)
    holder = Holder(
        block=Block.of(1, scale=scale, key_mm=key),
        fit=round(float(rng.uniform(0.0, 0.3)), 3),
        rim_mm=round(float(rng.uniform(0.0, 7.0 * scale - 1.0)), 2),
        slots=int(rng.integers(1, 4)),
        quarter_turns=int(rng.integers(0, 4)),
    )
    jig = Jig(holder=holder)
    require_sound(holder.part())
    require_sound(jig.part())
    plate, seated = manifold(holder.part().mesh[0]), manifold(tessellate(jig.solid_in_use))
    assert (plate ^ seated).volume() < TOUCHING_MM3
    for place in holder.block_placements():
        block = placed(holder.block, place)
        assert (plate ^ block).volume() < TOUCHING_MM3
        assert (seated ^ block).volume() < TOUCHING_MM3
    _markers_are_over_their_positions(jig)
