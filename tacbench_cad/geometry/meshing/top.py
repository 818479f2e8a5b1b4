"""The textured top of a block: on a sample grid, or within a tolerance.

A top on a sample grid and a separable top are heights on a tensor grid of lines. Any other top is a net of triangles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tacbench_cad.geometry.mesh import MAX_TRIANGLES, Certificate, refuse_too_many
from tacbench_cad.geometry.meshing.adaptive import NetTop, adaptive_top
from tacbench_cad.geometry.meshing.axis import SineAxis
from tacbench_cad.geometry.meshing.certify import Allowance, AxisProof, prove_axis, vertical, within
from tacbench_cad.geometry.meshing.certify_cells import Cells
from tacbench_cad.geometry.meshing.sheet import Sheet
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.sampling import SampleGrid
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats


@dataclass(frozen=True, eq=False)
class Profiles:
    """The two fits of a separable top. The height at (x, y) is the sum of the datum and both fits.

    Args:
        a: The heights at the lines along x, shape (n,), in mm.
        b: The heights at the lines along y, shape (m,), in mm.
    """

    a: Floats
    b: Floats


@dataclass(frozen=True, eq=False)
class Top:
    """A faceted top.

    Args:
        x: The positions of the lines along x, float32 values from 0 to the side, ascending, shape (n,).
        y: The positions of the lines along y, shape (m,).
        z: The heights at the crossings of the lines, float32 values, shape (n, m), in mm.
        profiles: The two fits, if all cells are planar; None if each cell consists of two different triangles. The
            diagonal of each cell runs from (i + 1, j) to (i, j + 1).
        certificate: The proved bounds.
    """

    x: Floats
    y: Floats
    z: Floats
    profiles: Profiles | None
    certificate: Certificate

    @property
    def sheet(self) -> Sheet:
        """The triangles of the top."""
        n, m = len(self.x), len(self.y)
        places = np.broadcast_arrays(self.x[:, None], self.y[None, :], self.z)
        index = np.arange(n * m, dtype=np.int32).reshape(n, m)
        a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
        triangles = np.stack([a, b, d, b, c, d], axis=1).reshape(-1, 3)
        sides = (index[:, 0], index[-1, :], index[::-1, -1], index[0, ::-1])
        return Sheet(np.stack(places, axis=-1).reshape(-1, 3), triangles, sides)


def single(values: Floats) -> Floats:
    """Round to float32 values, and return them as float64."""
    return np.asarray(values, dtype=np.float64).astype(np.float32).astype(np.float64)


def triangles_of(n: int, m: int) -> int:
    """Return the number of triangles of a block without key and label whose top has n by m lines."""
    return 2 * (n - 1) * (m - 1) + 2 * (n + m) + 2


def textured_top(block: Block) -> Top | NetTop:
    """Make the top of a block according to its ``sampling``.

    Raises:
        InputError: The top would need too many triangles, or the tolerance is too fine for single precision.
    """
    if isinstance(block.sampling, SampleGrid):
        return _sampled_top(block, block.sampling)
    tolerance = block.sampling.mm - block.surface.error
    rounding = _rounding_mm(block)
    if tolerance < 8.0 * rounding + block.surface.error:
        if block.surface.error > rounding:
            own = f"must be at least twice the error {block.surface.error:.2g} mm of the texture itself"
            raise InputError("tolerance", block.sampling.mm, own)
        limit = f"{8.0 * rounding:.2g}"
        raise InputError(
            "tolerance", tolerance, f"must be at least {limit} mm, because STL files have single precision"
        )
    if block.surface.is_separable and _peak_survives(block):
        return _fitted_top(block, tolerance)
    return adaptive_top(block, tolerance)


def _rounding_mm(block: Block) -> float:
    """Return the largest error of rounding a height to float32, in mm."""
    return float(np.spacing(np.float32(block.height_mm))) / 2.0


def _peak_survives(block: Block) -> bool:
    """Check whether the highest point of the whole rectangle is not cut off by the key or the outline."""
    if block.region is None:
        return True
    x, y = block.size_mm
    whole = block.surface.extremes((0.0, x), (0.0, y))
    return block.extremes.high >= whole.high - 4.0 * whole.error - 1e-12


def _crowned(z: Floats, block: Block, kept: Bools, top: tuple[int, int] | None) -> Floats:
    """Round heights to float32, limit those in ``kept`` to the block's height, and set the height at ``top`` to it."""
    height = float(np.float32(block.height_mm))
    rounded = single(z)
    rounded[kept] = np.minimum(rounded[kept], height)
    if top is not None:
        rounded[top] = height
    return rounded


def _sampled_top(block: Block, grid: SampleGrid) -> Top:
    size = f"{grid.nx}x{grid.ny}"
    refuse_too_many("grid", size, triangles_of(grid.nx, grid.ny), "use fewer samples")
    x, y = block.samples_mm
    surface, datum = block.surface, block.datum_mm
    lines = (single(x), single(y))
    heights = datum + surface.grid(x, y)
    inside = np.ones(heights.shape, dtype=np.bool_)
    if block.region is not None:
        inside = block.region.distance(x[:, None], y[None, :]) <= 0.0
    z = _crowned(heights, block, inside, None)
    if surface.is_separable:
        a, b = surface.along_u(x), surface.along_v(y)
        proofs = prove_axis(surface.along_u, lines[0], a), prove_axis(surface.along_v, lines[1], b)
        bound = vertical(*proofs) + float(np.abs(z - heights).max())
        return Top(*lines, z, Profiles(a, b), Certificate(distance_mm=bound, vertical_mm=bound))
    bound = float(Cells(surface, *lines).prove(z - datum, rising=False).max())
    return Top(*lines, z, None, Certificate(distance_mm=bound, vertical_mm=bound))


def _fitted_top(block: Block, tolerance: float) -> Top:
    p, q = _axes(block)
    fraction = _fraction_of_x(p, q)
    budget = tolerance - 2.0 * _rounding_mm(block)
    fractions = (fraction, 1.0 - fraction)
    _refuse_fine(tolerance, *(_lines_needed(axis, budget, part) for axis, part in zip((p, q), fractions, strict=True)))
    x, a, along_x = _fit(p, budget, fraction)
    y, b, along_y = _fit(q, budget, 1.0 - fraction)
    proofs = along_x, along_y
    distance = within(*proofs, fraction)
    high = vertical(*proofs)
    refuse_too_many("tolerance", tolerance, triangles_of(len(x), len(y)), "use a larger tolerance")
    heights = block.formula_datum_mm + (a[:, None] + b[None, :])
    highest = (int(np.argmax(a)), int(np.argmax(b)))
    z = _crowned(heights, block, np.ones(heights.shape, dtype=np.bool_), highest)
    moved = float(np.abs(z - heights).max())
    certificate = Certificate(distance_mm=min(distance, high) + moved, vertical_mm=high + moved)
    return Top(x, y, z, Profiles(a, b), certificate)


def _axes(block: Block) -> tuple[SineAxis, SineAxis]:
    axes = []
    sums = (block.surface.along_u, block.surface.along_v)
    for sines, side, place in zip(sums, block.size_mm, block.extremes.at_high, strict=True):
        length = float(np.float32(side))
        peak = length if abs(place - length) < 1e-6 * length else place
        axes.append(SineAxis(sines=sines, length_mm=length, peak_mm=peak, peak_height_mm=float(sines(place))))
    return axes[0], axes[1]


def _fraction_of_x(p: SineAxis, q: SineAxis) -> float:
    """Return the fraction of the tolerance for x."""
    if q.sines.is_constant:
        return 1.0
    return 0.0 if p.sines.is_constant else 0.5


def _lines_needed(axis: SineAxis, tolerance: float, fraction: float) -> float:
    return (
        2.0 if axis.sines.is_constant else axis.links_needed(Allowance(tolerance_mm=tolerance, fraction=fraction)) + 1.0
    )


def _fit(axis: SineAxis, tolerance: float, fraction: float) -> tuple[Floats, Floats, AxisProof]:
    if axis.sines.is_constant:
        ends = np.array([0.0, axis.length_mm])
        height = axis.sines(ends)
        return ends, height, prove_axis(axis.sines, ends, height)
    return axis.fit(Allowance(tolerance_mm=tolerance, fraction=fraction))


def _refuse_fine(tolerance: float, n: float, m: float) -> None:
    """Check before the fit that the estimated number of triangles is not far above the limit."""
    needed = triangles_of(math.ceil(n), math.ceil(m))
    if needed > 1.1 * MAX_TRIANGLES:
        ratio = needed / MAX_TRIANGLES
        coarser = tolerance * (ratio if min(n, m) > 2.0 else ratio**2)
        refuse_too_many("tolerance", tolerance, needed, f"use about {coarser:.2g} mm")
