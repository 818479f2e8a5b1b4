"""The check that a block is complete: nothing is cut out of it, and its label is the expected one."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np

from tacbench_cad.checks.body_shape import BodyShape
from tacbench_cad.checks.match import Candidate, Match
from tacbench_cad.checks.report import Check
from tacbench_cad.spec.block import MAX_COPIES, Block
from tacbench_cad.spec.label import LABEL_DEPTH_MM
from tacbench_cad.spec.outlines import Outline
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import counted
from tacbench_cad.util.types import Floats

#: The largest allowed difference of the area of the label's pockets, in mm^2. It covers the rounding to float32.
LABEL_MM2 = 0.01
#: The relative error of the kernel's default volume, and of the volume of a mesh of float32 values.
SOLID_FRACTION, MESH_FRACTION = 1e-4, 1e-5
#: The number of points along each side of the block with which the area of its relief is estimated, and of its key with
#: which the volume below lines between samples is computed.
_SIDE_POINTS = 200
#: The factor for the error of the estimated area.
_AREA_FACTOR = 1.1


def completeness_checks(
    shape: BodyShape, match: Match, claimed: Block | None, outline: Outline | None, allowed_mm: float
) -> list[Check]:
    """Compare the volume, the through holes, the shells and the label of a shape with those of its block.

    Together with the checks of the relief, the outline and the underside, these find everything that is cut out of a
    block or added to it, also if it is too small for its volume to be noticed.

    Args:
        shape: The shape.
        match: Its block and its placement.
        claimed: The block that the file claims to contain; None for a file without a claim.
        outline: The outline of the block; None for a rectangle.
        allowed_mm: The largest distance of the relief from the block.
    """
    scaled = max(abs(factor - 1.0) for factor in match.candidate.stretch) > 1e-4
    block = claimed or _like(shape, match.candidate.block, outline)
    volume = None if scaled or block is None else _volume(shape, match.candidate, block, allowed_mm)
    checks = [_complete(shape, volume, outline)]
    if block is not None and (shape.engraved or block.label):
        checks.append(_label(shape, block, claimed is not None, scaled))
    return checks


def _like(shape: BodyShape, block: Block, outline: Outline | None) -> Block | None:
    """Return a block with the outline and the key of a shape; None if it cannot have them, which is another fault."""
    try:
        if outline is not None:
            nominal = outline.scaled(1.0 / block.scale)
            return replace(block, nominal_outline=nominal, nominal_size_mm=nominal.size_mm)
        return replace(block, key_mm=shape.cut_corners[0][2]) if len(shape.cut_corners) == 1 else block
    except InputError:
        return None


def _complete(shape: BodyShape, volume: tuple[float, float] | None, outline: Outline | None) -> Check:
    """Check the holes and the shells, and the volume against the expected one and its tolerance."""
    faults, facts = [], []
    if volume is not None and shape.volume_mm3 is not None:
        expected, allowed = volume
        off = shape.volume_mm3 - expected
        if abs(off) > allowed:
            direction = "small" if off < 0.0 else "large"
            faults.append(f"the volume is {abs(off):.3g} mm^3 too {direction} (allowed {allowed:.2g} mm^3)")
        facts.append(f"the volume is {abs(off):.2g} mm^3 from the block's (allowed {allowed:.2g} mm^3)")
    holes = 0 if outline is None else len(outline.loops) - 1
    if shape.holes is not None:
        facts.append(counted(shape.holes, "through hole"))
        if shape.holes != holes:
            faults.append(f"{facts[-1]} instead of {holes}")
    if shape.shells != 1:
        faults.append(f"{shape.shells} shells instead of 1: the block has a hollow")
    return Check(name="complete", ok=not faults, detail="; ".join(faults or facts) or "not closed, so not measured")


def _volume(shape: BodyShape, candidate: Candidate, block: Block, allowed_mm: float) -> tuple[float, float]:
    """Return the expected volume with the label that the shape has, and the largest allowed difference from it."""
    engraved = 0.0 if block.engraving is None else block.engraving.volume_mm3
    expected, diagonals = block.volume_mm3(candidate.datum_mm) + engraved, 0.0
    if candidate.on_grid:
        expected, diagonals = _below_samples(candidate, block)
    expected -= LABEL_DEPTH_MM * shape.pockets_mm2
    places = (np.arange(_SIDE_POINTS) + 0.5) / _SIDE_POINTS
    x, y = block.size_mm
    along_x, along_y = block.surface.gradient(x * places[:, None], y * places[None, :])
    relief_mm2 = _AREA_FACTOR * block.footprint_mm2 * float(np.mean(np.sqrt(1.0 + along_x**2 + along_y**2)))
    allowed = allowed_mm * relief_mm2 + (SOLID_FRACTION if shape.is_solid else MESH_FRACTION) * expected + diagonals
    if block.outline is not None and not shape.is_solid:  # chords instead of circles
        loops = (loop.array for loop in block.outline.chords(allowed_mm).loops)
        around = sum(float(np.hypot(*(loop - np.roll(loop, 1, axis=0)).T).sum()) for loop in loops)
        allowed += allowed_mm * around * block.height_mm
    return expected, allowed


def _below_samples(candidate: Candidate, block: Block) -> tuple[float, float]:
    """Return the volume below lines between samples without a label, and half of what the choice of diagonals changes.

    The volume below a cell is that below the mean of its two pairs of triangles.
    """
    x, y = block.samples_mm
    z = candidate.datum_mm + block.surface.grid(x, y)
    cell = (x[1] - x[0]) * (y[1] - y[0])
    twist = z[1:, 1:] + z[:-1, :-1] - z[1:, :-1] - z[:-1, 1:]
    volume = float(cell * (z[1:, 1:] + z[:-1, :-1] + z[1:, :-1] + z[:-1, 1:]).sum() / 4.0)
    diagonals = float(cell * np.abs(twist).sum() / 12.0)
    if block.key_mm is not None:
        volume -= float(np.mean(_heights_of_key(candidate, block))) * block.key_mm**2 / 2.0
        diagonals += 1e-3 * block.key_mm**2  # the error of the sum over points
    return volume, diagonals


def _heights_of_key(candidate: Candidate, block: Block) -> Floats:
    """Return the heights of the top at points that are evenly spread over the triangle of the key."""
    assert block.key_mm is not None
    a, b = np.meshgrid(*[(np.arange(_SIDE_POINTS) + 0.5) / _SIDE_POINTS] * 2, indexing="ij")
    inside = a > b
    x = block.size_mm[0] - block.key_mm * (1.0 - a[inside])
    y = block.key_mm * b[inside]
    return candidate.top_mm(x, y)


def _label(shape: BodyShape, block: Block, named: bool, scaled: bool) -> Check:
    """Compare the area of the label's pockets with that of the label in the name, or of any label of the block."""
    area = f"{shape.pockets_mm2:.5g} mm^2 of pockets in the underside, {LABEL_DEPTH_MM:g} mm deep"
    if scaled:
        return Check(name="label", ok=True, detail=f"{area}; not compared, because the file has a wrong size")
    areas = []
    for copy in [block.copy] if named else itertools.chain([None], range(1, MAX_COPIES + 1)):
        try:
            engraving = replace(block, label=block.label or not named, copy=copy).engraving
        except InputError:
            continue
        areas.append(0.0 if engraving is None else engraving.area_mm2)
        if abs(areas[-1] - shape.pockets_mm2) <= LABEL_MM2:
            return Check(name="label", ok=True, detail=area)
    if named:
        expectation = f"instead of {areas[0]:.5g} mm^2" if areas and areas[0] else "but the block has no label"
    else:
        expectation = "which is no label of this block"
    return Check(name="label", ok=False, detail=f"{area}, {expectation}")
