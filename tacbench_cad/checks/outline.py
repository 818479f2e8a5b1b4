"""Checks of the walls of a block: they follow its outline, or the sides and the key of a rectangle."""

from __future__ import annotations

import numpy as np

from tacbench_cad.checks.body_shape import BodyShape
from tacbench_cad.checks.candidates import SIDE_MM
from tacbench_cad.checks.match import Match
from tacbench_cad.checks.report import Check
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.label import MARGIN_MM
from tacbench_cad.spec.outlines import MIN_SIDE_MM, MIN_WIDTH_MM, NAMED, Disc, Outline, RegularPolygon, Ring
from tacbench_cad.spec.sampling import Tolerance
from tacbench_cad.util.types import Floats


def outline_of(shape: BodyShape, match: Match, claimed: Block | None) -> Outline | None:
    """Return the outline of the named block, or the known outline of a file without a name; None for a rectangle."""
    if claimed is not None:
        return claimed.outline
    if len(shape.cut_corners) < 2:
        return None
    underside, walls = (
        np.stack(match.placement.to_block(points, shape.size_mm)) for points in (shape.outline, shape.off_sides_mm)
    )
    return _known_outline(underside, walls, match.placement.sides(shape.size_mm))


def outline_checks(
    shape: BodyShape, match: Match, claimed: Block | None, outline: Outline | None, allowed_mm: float
) -> list[Check]:
    """Check the walls, the outline of the underside and the key.

    Args:
        shape: The shape.
        match: Its block.
        claimed: The block that the file claims to contain; None for a file without a claim.
        outline: The outline; None for a rectangle.
        allowed_mm: The largest allowed distance of the relief from the block.
    """
    # The rounding of its corners can turn a narrow triangle of the relief into a wall.
    walls = shape.off_sides_mm[~match.candidate.contains(shape.off_sides_mm, shape, match.placement, allowed_mm)]
    if outline is None:
        return [*_corner(shape, match, claimed), *_sides(shape, walls)]
    x, y = match.placement.to_block(shape.outline, shape.size_mm)
    if shape.engraved:  # the rims of the pockets are points of the underside, too
        rims = outline.distance(x, y) < SIDE_MM - MARGIN_MM
        x, y = x[~rims], y[~rims]
    wall_x, wall_y = match.placement.to_block(walls, shape.size_mm)
    x, y = np.concatenate([x, wall_x]), np.concatenate([y, wall_y])
    off = np.abs(outline.distance(x, y))
    allowed = SIDE_MM if shape.is_solid else SIDE_MM + allowed_mm
    if not len(off) or off.max() <= allowed:
        return [Check(name="outline", ok=True, detail=str(outline))]
    i = int(off.argmax())
    where = f"at x {x[i]:.4g}, y {y[i]:.4g} mm, {off[i]:.3g} mm from the {outline} (allowed {allowed:.2g} mm)"
    return [Check(name="outline", ok=False, detail=f"a wall is {where}")]


def _known_outline(underside: Floats, walls: Floats, size_mm: tuple[float, float]) -> Outline | None:
    """Return the disc, ring or regular polygon on which points lie, or None. Points inside belong to a label.

    Args:
        underside: The x and y of points of the underside, shape (2, n).
        walls: The x and y of points of walls, shape (2, m). No wall of a label is among them.
        size_mm: The sides of the bounding box.
    """
    diameter = size_mm[0]
    known: list[Outline] = []
    if abs(size_mm[0] - size_mm[1]) <= SIDE_MM:
        known.append(Disc(diameter_mm=diameter))
        inner = 2.0 * float(np.hypot(*(walls - diameter / 2.0)).min(initial=diameter))
        if MIN_SIDE_MM < inner < diameter - 2.0 * MIN_WIDTH_MM:
            known.insert(0, Ring(outer_mm=diameter, inner_mm=inner))
    for sides in NAMED.values():
        width = RegularPolygon(sides=sides, diameter_mm=100.0).size_mm[0] / 100.0
        known.append(RegularPolygon(sides=sides, diameter_mm=diameter / width))
    limit = SIDE_MM + Tolerance().mm
    points = np.concatenate([underside, walls], axis=1)
    for outline in known:
        fits = all(abs(a - b) <= SIDE_MM for a, b in zip(outline.size_mm, size_mm, strict=True))
        distance = outline.distance(*points)
        near = np.abs(distance) <= limit
        on_outline = near | (distance < -MARGIN_MM + SIDE_MM)
        if isinstance(outline, Ring):  # its inner circle was found from one wall, so all walls must confirm it
            on_outline[underside.shape[1] :] &= near[underside.shape[1] :]
        if fits and on_outline.all() and near.any():
            return outline
    return None


def _corner(shape: BodyShape, match: Match, claimed: Block | None) -> list[Check]:
    """Check the key, which is the cut corner at (X, 0) of the block."""
    cut = shape.cut_corners
    key_mm = None if claimed is None else claimed.key_mm
    if not cut and key_mm is None:
        return []
    if not cut:
        return [Check(name="key", ok=False, detail=f"missing; a key of {key_mm:g} mm is expected")]
    if len(cut) > 1:
        detail = f"{len(cut)} corners of the underside are cut off, but a key cuts off only one"
        return [Check(name="key", ok=False, detail=detail)]
    i, j, leg = cut[0]
    corner = np.array([[i * shape.size_mm[0], j * shape.size_mm[1]]])
    x, y = (float(values[0]) for values in match.placement.to_block(corner, shape.size_mm))
    width = match.placement.sides(shape.size_mm)[0]
    right = abs(x - width) < SIDE_MM and abs(y) < SIDE_MM
    where = "at the corner (X, 0)" if right else f"at the corner ({x:.4g}, {y:.4g}) mm instead of (X, 0)"
    size_ok = claimed is None or (key_mm is not None and abs(leg - key_mm) <= SIDE_MM)
    expectation = "" if size_ok else f"; {'no key' if key_mm is None else f'{key_mm:g} mm'} is expected"
    return [Check(name="key", ok=right and size_ok, detail=f"{leg:.4g} mm {where}{expectation}")]


def _sides(shape: BodyShape, walls: Floats) -> list[Check]:
    """Check that all walls are on the sides of the bounding box, or on the cut of the key."""
    off = walls[:, :2]
    for i, j, leg in shape.cut_corners:
        from_x = np.abs(off[:, 0] - i * shape.size_mm[0])
        from_y = np.abs(off[:, 1] - j * shape.size_mm[1])
        off = off[np.abs(from_x + from_y - leg) > SIDE_MM]
    if len(off) == 0:
        return []
    x, y = off[0].tolist()
    detail = (
        f"{len(off)} points of walls are not on a side of the bounding box "
        f"(for example x {x:.4g}, y {y:.4g} mm from its lower corner)"
    )
    return [Check(name="sides", ok=False, detail=detail)]
