"""The top surface that a print will have, computed from its beads, and the position of the block on the bed.

The cross-section of a bead is a rectangle with round ends. Its width follows from its area and from the height of its
layer. The surface at a point is the surface of the highest bead there, with its flat top and its rounded sides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tacbench_cad.extensions.slicing.gcode import Beads, Sliced
from tacbench_cad.spec import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats, Ints
from tacbench_cad.util.untrusted import require_within

#: The largest difference between the printed outline and the sides of the block, in mm. If it is larger, the G-code is
#: for another part.
OUTLINE_MM = 0.5
#: The largest length of a piece of a bead, in mm. Long beads are divided, so that their boxes contain few points.
_PIECE_MM = 1.0
#: The largest number of pieces over the block, and of points under them. A point counts once for each piece above it.
MAX_PIECES, MAX_COVERED = 10_000_000, 2e9
#: The number of points that are processed together.
_CHUNK = 1_500_000
#: The position of the block follows from the layers below this fraction of its base.
_LOW_FRACTION = 0.95


@dataclass(frozen=True, kw_only=True)
class BedPlace:
    """The position of the block on the bed.

    Args:
        x_mm: The smallest x of the block's outline on the bed.
        y_mm: The smallest y of the block's outline on the bed.
        quarters: The number of quarter turns of the block, counter-clockwise.
        source: ``outer walls`` if the position was computed from the G-code, ``given`` if the user gave it.
        outline_mm: The sides of the outline of the outer walls, along the bed's x and y; None if the user gave the
            position.
    """

    x_mm: float
    y_mm: float
    quarters: int = 0
    source: str = "given"
    outline_mm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x_mm) and math.isfinite(self.y_mm)):
            raise InputError("frame", (self.x_mm, self.y_mm), "must be finite numbers")
        if self.quarters not in (0, 1, 2, 3):
            raise InputError("frame", self.quarters * 90, "the rotation must be 0, 90, 180 or 270 degrees")

    def to_block(self, points_mm: Floats, size_mm: tuple[float, float]) -> Floats:
        """Convert points from the bed to the block frame.

        Args:
            points_mm: Points on the bed, shape (n, 2).
            size_mm: The sides of the block in its own frame.
        """
        x, y = points_mm[:, 0] - self.x_mm, points_mm[:, 1] - self.y_mm
        across, down = size_mm
        turned = {0: (x, y), 1: (y, down - x), 2: (across - x, down - y), 3: (across - y, x)}[self.quarters]
        return np.column_stack(turned)

    def as_dict(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {
            "x_mm": self.x_mm,
            "y_mm": self.y_mm,
            "turned_degrees": 90 * self.quarters,
            "source": self.source,
            "outline_mm": None if self.outline_mm is None else list(self.outline_mm),
        }


def frames_of(sliced: Sliced, block: Block) -> list[BedPlace]:
    """Return the possible positions of the block: one for each quarter turn that fits the outer walls of low layers.

    The outline of a layer is the bounding box of its outer walls, including half the width of the beads. The outline is
    the median over the layers below the relief. The first layer is left out if there are others, because slicers shrink
    it.

    Raises:
        InputError: The outline differs from that of the block.
    """
    beads = sliced.beads
    low = sliced.floor_mm + _LOW_FRACTION * block.base_mm
    boxes = []
    for top in [top for top in sliced.layer_tops_mm if top <= low][1:] or [float(sliced.layer_tops_mm[0])]:
        walls = np.flatnonzero(beads.wall & (np.abs(beads.top_mm - top) < 1e-3))
        if len(walls):
            ends = np.stack([beads.start_mm[walls], beads.end_mm[walls]])
            half = beads.width_mm[walls, None] / 2.0
            boxes.append([*(ends - half).min(axis=(0, 1)), *(ends + half).max(axis=(0, 1))])
    if not boxes:
        raise InputError(
            "file", str(sliced.path), "has no outer walls in its low layers; give the position with --frame X,Y"
        )
    x0, y0, x1, y1 = np.median(np.array(boxes), axis=0).tolist()
    outline, frames = (x1 - x0, y1 - y0), []
    for quarters in range(4):
        sides = block.size_mm if quarters % 2 == 0 else block.size_mm[::-1]
        if max(abs(length - side) for length, side in zip(outline, sides, strict=True)) <= OUTLINE_MM:
            corner = ((x0 + x1 - sides[0]) / 2.0, (y0 + y1 - sides[1]) / 2.0)
            frames.append(
                BedPlace(x_mm=corner[0], y_mm=corner[1], quarters=quarters, source="outer walls", outline_mm=outline)
            )
    if not frames:
        own = " x ".join(f"{side:.4g}" for side in block.size_mm)
        raise InputError(
            "file",
            str(sliced.path),
            f"is for another part: its outer walls measure {outline[0]:.4g} x {outline[1]:.4g} mm, but {block.name} "
            f"measures {own} mm; give the --texture, --preset and --scale of the sliced block, or --frame X,Y if there "
            "is more than one block on the plate",
        )
    return frames


def printed_heights(sliced: Sliced, block: Block, frame: BedPlace, x: Floats, y: Floats) -> Floats:
    """Return the heights of the printed top above the part's underside on a grid.

    Args:
        sliced: The G-code.
        block: The block.
        frame: The position of the block on the bed.
        x: The x coordinates of the grid in the block frame, evenly spaced, shape (n,).
        y: The y coordinates of the grid in the block frame, evenly spaced, shape (m,).

    Returns:
        The heights in mm, shape (n, m); 0 at points without a bead.
    """
    beads = replace(
        sliced.beads,
        start_mm=frame.to_block(sliced.beads.start_mm, block.size_mm),
        end_mm=frame.to_block(sliced.beads.end_mm, block.size_mm),
        top_mm=sliced.beads.top_mm - sliced.floor_mm,
    )
    heights = np.zeros(len(x) * len(y))
    for index, height in _covered(beads, x, y):
        np.maximum.at(heights, index, height)
    return heights.reshape(len(x), len(y))


def _covered(beads: Beads, x: Floats, y: Floats) -> Iterator[tuple[Ints, Floats]]:
    """Yield, in chunks, the indices of points under beads in the flattened grid, and the heights of the beads there."""
    run = beads.end_mm - beads.start_mm
    pieces = np.maximum(1, np.ceil(np.hypot(run[:, 0], run[:, 1]) / _PIECE_MM)).astype(np.int64)
    half = beads.width_mm[:, None] / 2.0
    before = np.maximum(beads.start_mm, beads.end_mm) + half < [x[0], y[0]]
    beyond = np.minimum(beads.start_mm, beads.end_mm) - half > [x[-1], y[-1]]
    pieces[(before | beyond).any(axis=1)] = 0
    require_within("file", float(pieces.sum()), MAX_PIECES, f"pieces of beads of {_PIECE_MM:g} mm over the block")
    of = np.repeat(np.arange(len(beads)), pieces)
    nth = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    step = run[of] / pieces[of, None]
    start = beads.start_mm[of] + nth[:, None] * step
    end = start + step
    width, height = beads.width_mm[of], beads.height_mm[of]
    round_mm = np.minimum(width, height) / 2.0
    flat = width / 2.0 - round_mm
    pitch = np.array([x[1] - x[0], y[1] - y[0]])
    origin, last_index = np.array([x[0], y[0]]), np.array([len(x), len(y)]) - 1
    low = np.ceil((np.minimum(start, end) - width[:, None] / 2.0 - origin) / pitch).astype(np.int64)
    high = np.floor((np.maximum(start, end) + width[:, None] / 2.0 - origin) / pitch).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, last_index)
    spans = np.maximum(high - low + 1, 0)
    counts = spans[:, 0] * spans[:, 1]
    bounds = np.concatenate([[0], np.cumsum(counts)])
    require_within("file", float(bounds[-1]), MAX_COVERED, "points under its beads")
    first = 0
    while first < len(of):
        last = max(first + 1, int(np.searchsorted(bounds, bounds[first] + _CHUNK, side="right")) - 1)
        these = np.arange(first, last)
        piece = np.repeat(these, counts[these])
        local = np.arange(len(piece)) - np.repeat(bounds[these] - bounds[first], counts[these])
        i, j = low[piece, 0] + local // spans[piece, 1], low[piece, 1] + local % spans[piece, 1]
        away = np.column_stack([x[i], y[j]]) - start[piece]
        along = step[piece]
        square = np.maximum((along**2).sum(axis=1), 1e-18)
        fraction = np.clip((away * along).sum(axis=1) / square, 0.0, 1.0)
        off = away - fraction[:, None] * along
        outside = np.maximum(np.hypot(off[:, 0], off[:, 1]) - flat[piece], 0.0)
        radius = round_mm[piece]
        under = outside < radius
        drop = radius[under] - np.sqrt(radius[under] ** 2 - outside[under] ** 2)
        yield i[under] * len(y) + j[under], beads.top_mm[of[piece[under]]] - drop
        first = last


def staircase(sliced: Sliced, formula_mm: Floats) -> Floats:
    """Return the best approximation of a surface by layers: at each point all layers with their middle below it.

    Args:
        sliced: The G-code. Its layers are used, with further layers of the usual height above the last layer.
        formula_mm: The heights of the surface above the underside, in any shape.
    """
    tops = sliced.layer_tops_mm - sliced.floor_mm
    missing = max(0, math.ceil((float(formula_mm.max()) - tops[-1]) / sliced.layer_mm + 0.5))
    edges = np.concatenate([[0.0], tops, tops[-1] + sliced.layer_mm * np.arange(1, missing + 1)])
    middles = (edges[1:] + edges[:-1]) / 2.0
    return np.asarray(edges[np.searchsorted(middles, formula_mm, side="right")], dtype=np.float64)
