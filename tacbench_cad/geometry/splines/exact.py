"""The relief of a block whose surface is a spline: its own pieces are the patches, so the solid follows it exactly."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tacbench_cad.geometry.mesh import Certificate
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.operations import as_spline
from tacbench_cad.spec.spline import SplineAxis, SplineSurface
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bools, Floats

#: The largest number of poles of a surface for which a solid is made. A solid of a larger height map would take minutes
#: and hundreds of megabytes.
MAX_SPLINE_POLES = 160_000
#: The largest number of spans on a patch. With 12 spans, the kernel's area of a wall below a patch is wrong by 1e-5.
#: With 8 spans, it is wrong by less than 2e-6.
MAX_SPANS = 8
#: The stated distance of the solid from the spline in mm. The kernel's own tolerance is smaller; the rest allows for
#: its areas of walls.
KERNEL_MM = 1e-6


@dataclass(frozen=True, eq=False)
class PieceAxis:
    """One axis of a spline surface, divided into patches.

    Args:
        lines: The ends of the patches in mm, ascending, shape (patches + 1,).
        pieces: The knots on each patch.
        smooth: Whether the splines on neighbouring patches have the same slope at the joint.
    """

    lines: Floats
    pieces: tuple[SplineAxis, ...]
    smooth: bool = False

    @property
    def patches(self) -> int:
        """The number of patches."""
        return len(self.pieces)

    @property
    def degree(self) -> int:
        """The polynomial degree."""
        return self.pieces[0].degree

    @property
    def pole_count(self) -> int:
        """The number of poles along the whole axis. Poles at joints are counted once."""
        return sum(piece.count - 1 for piece in self.pieces) + 1

    @cached_property
    def firsts(self) -> list[int]:
        """The index of the first pole of each patch."""
        return [0, *np.cumsum([piece.count - 1 for piece in self.pieces]).tolist()]

    def knots_of(self, patch: int) -> tuple[Floats, list[int]]:
        """Return the different knots of a patch in mm, and the number of copies of each."""
        piece = self.pieces[patch]
        times = np.diff(np.append(np.searchsorted(piece.knots, piece.breaks), len(piece.knots)))
        return piece.breaks, times.tolist()

    def values(self, patch: int, t: Floats) -> Floats:
        """Return all basis functions of a patch at ``t`` in [0, 1], shape (len(t), count)."""
        piece = self.pieces[patch]
        low, high = piece.ends
        first, local = piece.local(np.clip(low + (high - low) * t, low, high))
        full = np.zeros((len(t), piece.count))
        np.put_along_axis(full, first[:, None] + np.arange(piece.degree + 1), local.T, axis=1)
        return full

    def abscissae_mm(self, patch: int) -> Floats:
        """Return the positions of the poles of a patch along the axis in mm, shape (count,)."""
        return self.pieces[patch].greville

    def joined(self) -> tuple[tuple[Floats, list[int]], Bools]:
        """Return the knots of the whole axis, the copies of each, and a mask of the poles that are needed.

        At a joint, one of two equal poles is removed. If the splines are smooth there, the other one is a mean of its
        neighbours and is removed as well.
        """
        keep = np.concatenate([np.arange(piece.count) > 0 for piece in self.pieces])
        keep[0] = True
        if self.smooth:
            keep[np.cumsum([piece.count for piece in self.pieces])[:-1] - 1] = False
        knots, times = [self.lines[:1]], [self.degree + 1]
        for patch in range(self.patches):
            at, copies = self.knots_of(patch)
            knots.append(at[1:])
            times += [*copies[1:-1], self.degree - self.smooth]
        times[-1] = self.degree + 1
        return (np.concatenate(knots), times), keep


@dataclass(frozen=True, eq=False)
class SplinePatches:
    """The pieces of a spline surface over the rectangle of a block. Create them with :func:`spline_patches`.

    Args:
        surface: The surface in mm.
        datum_mm: The z of the surface's zero.
        x: The axis along x.
        y: The axis along y.
        poles: The heights of all poles without the datum, shape (x.pole_count, y.pole_count).
        certificate: The proved bounds of the distance between the patches and the surface, which is only rounding.
    """

    surface: SplineSurface
    datum_mm: float
    x: PieceAxis
    y: PieceAxis
    poles: Floats
    certificate: Certificate

    @property
    def pole_count(self) -> int:
        """The number of poles of the whole surface."""
        return self.poles.size

    def heights_mm(self, i: int, j: int) -> Floats:
        """Return the heights z of the poles of patch (i, j) in mm, shape (count x, count y)."""
        rows = slice(self.x.firsts[i], self.x.firsts[i + 1] + 1)
        columns = slice(self.y.firsts[j], self.y.firsts[j + 1] + 1)
        return np.asarray(self.datum_mm + self.poles[rows, columns])

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return the heights z of the patches at the points (x, y), in mm."""
        return np.asarray(self.datum_mm + self.surface(x, y))


def spline_refusal(surface: SplineSurface) -> str | None:
    """Return the reason why a surface has no solid, or None if it has one."""
    if surface.poles.size <= MAX_SPLINE_POLES:
        return None
    return (
        f"its spline has {surface.poles.shape[0]} x {surface.poles.shape[1]} poles, and a solid may have "
        f"{MAX_SPLINE_POLES:,} at most; use a smaller block or a coarser height map, or fit waves to it"
    )


def spline_patches(block: Block, tolerance_mm: float) -> SplinePatches:
    """Divide the surface of a block into patches of splines. There are lines along all creases.

    A surface that is not a spline is sampled within half of the tolerance.

    Raises:
        InputError: The surface has too many poles, or its own error is larger than the tolerance.
    """
    width, depth = block.size_mm
    surface = as_spline(block.surface, tolerance_mm / 2.0).over((0.0, width), (0.0, depth))
    if refusal := spline_refusal(surface):
        raise InputError("formats", "step", f"{block.texture.name} has no solid: {refusal}")
    if surface.error > tolerance_mm:
        raise InputError(
            "step-tolerance",
            tolerance_mm,
            f"must be larger than the error {surface.error:.2g} mm of the texture itself",
        )
    lines_x, lines_y = _lines(surface.u, 0.0, width), _lines(surface.v, 0.0, depth)
    x, poles = _pieces(surface.u, surface.poles, lines_x)
    y, turned = _pieces(surface.v, poles.T, lines_y)
    rounding = KERNEL_MM + 64.0 * float(np.finfo(float).eps) * (surface.amplitude_sum + abs(block.solid_datum_mm))
    return SplinePatches(
        surface=surface,
        datum_mm=block.solid_datum_mm,
        x=x,
        y=y,
        poles=np.ascontiguousarray(turned.T),
        certificate=Certificate(distance_mm=rounding, vertical_mm=rounding),
    )


def _lines(axis: SplineAxis, low: float, high: float) -> Floats:
    """Return the ends of the patches between two positions: all creases, and some of the knots between them."""
    ends = [low, *axis.creases[(axis.creases > low) & (axis.creases < high)].tolist(), high]
    lines = [np.array([low])]
    for start, end in itertools.pairwise(ends):
        inner = axis.breaks[(axis.breaks > start) & (axis.breaks < end)]
        parts = math.ceil((len(inner) + 1) / MAX_SPANS)
        chosen = [inner[len(inner) * k // parts] for k in range(1, parts)]
        lines.append(np.array([*chosen, end]))
    return np.concatenate(lines)


def _pieces(axis: SplineAxis, poles: Floats, lines: Floats) -> tuple[PieceAxis, Floats]:
    """Insert knots so that the first axis of the poles is divided at the lines."""
    for at in lines[1:-1].tolist():
        axis, poles = axis.inserted(poles, at, axis.degree)
    pieces = []
    for low, high in itertools.pairwise(lines.tolist()):
        near = 1e-12 * (axis.knots[-1] - axis.knots[0])
        inner = axis.knots[(axis.knots > low + near) & (axis.knots < high - near)]
        ends = [np.full(axis.degree + 1, end) for end in (low, high)]
        pieces.append(SplineAxis(np.concatenate([ends[0], inner, ends[1]]), axis.degree))
    return PieceAxis(lines, tuple(pieces)), poles
