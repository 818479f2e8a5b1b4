"""The drawing of a block."""

from __future__ import annotations

import numpy as np

from tacbench_cad.extensions.drawings.cuts import Cuts
from tacbench_cad.extensions.drawings.sheet import Callout, Dimension, Drawing, DrawingView, length, sides
from tacbench_cad.geometry import Mesh, mesh_block
from tacbench_cad.render import Body, Camera, relief_of, render
from tacbench_cad.spec import LABEL_DEPTH_MM, STROKE_MM, Block, PressGrid, Tolerance
from tacbench_cad.util.types import Bytes, Floats

_Point = tuple[float, float, float]

#: Accepted deviation of a printed block's sides, height and key, in mm. If the block and its pocket both deviate by
#: this much, a third of the clearance of the fit ``slip`` is left.
BLOCK_ACCEPTED_MM = 0.1
#: Smallest distance of a section from the walls, in mm.
_INSIDE_MM = 1e-5
#: Pixels of the shaded plan along its longer side.
_SHADE_PIXELS = 700


def block_drawing(block: Block, press: bool = False) -> Drawing:
    """Draw a block: the plan, a section through its highest point, and a section through its lowest point.

    Args:
        block: The block.
        press: Show the press positions, the place of the first position, and their spacing.

    Raises:
        InputError: The block cannot be meshed, or the press grid leaves it.
    """
    mesh = mesh_block(block)[0]
    cuts = Cuts(mesh)
    (x, y), top = block.size_mm, block.height_mm
    high, low = _extremes(block, mesh)
    base = block.base_mm if isinstance(block.sampling, Tolerance) else low[2]
    front, side = cuts.front(high[1], beyond=False), cuts.right(low[0], beyond=False)
    front["other"], side["other"] = [np.array([(0.0, top), (x, top)])], [np.array([(-top, 0.0), (-top, y)])]
    peak = max(np.concatenate(front["cut"]).tolist(), key=lambda point: point[1])[0]
    notes = [
        f"A–A is cut through the highest point, x {length(high[0])}, y {length(high[1])}; "
        f"B–B through the lowest, x {length(low[0])}, y {length(low[1])}.",
        "Thin chain line: the height of the highest point. Relief: from the lowest point to the highest.",
        "Print with the underside on the bed. No supports.",
    ]
    if block.label:
        notes.append("Dashed: the label, seen through the block; it is read from below.")
    return Drawing(
        report=str(block),
        facts=("z", "mm per unit", "relief", "finest wave", "mesh"),
        plan=_plan(block, mesh, cuts, high, low, press),
        front=DrawingView(front, [Dimension("height", (0.0, 0.0), (peak, top), "left", BLOCK_ACCEPTED_MM)]),
        side=DrawingView(
            side,
            [
                Dimension("base", (-base, low[1]), (0.0, y), "top", form="base {}"),
                Dimension("relief", (-top, y), (-base, low[1]), "top", form="relief {}"),
            ],
        ),
        notes=notes,
    )


def _extremes(block: Block, mesh: Mesh) -> list[_Point]:
    """The highest and the lowest vertex of the top. Of several equal vertices it takes the nearest to the middle."""
    top = mesh.vertices[mesh.vertices[:, 2] > (LABEL_DEPTH_MM + 1e-3 if block.label else 1e-6)]
    middle = np.array(block.size_mm) / 2.0
    # If the texture does not change along an axis, vertices are only at the ends of that axis.
    flat = np.array(block.surface.highest_frequency) == 0.0
    extremes = []
    for z in (top[:, 2].max(), top[:, 2].min()):
        near = top[np.abs(top[:, 2] - z) <= 1e-6]
        point = near[np.argmin(np.hypot(*(near[:, :2] - middle).T))]
        x, y = np.where(flat, middle, np.clip(point[:2], _INSIDE_MM, 2.0 * middle - _INSIDE_MM))
        extremes.append((float(x), float(y), float(point[2])))
    return extremes


def _plan(block: Block, mesh: Mesh, cuts: Cuts, high: _Point, low: _Point, press: bool) -> DrawingView:
    (x, y), key, accept = block.size_mm, block.key_mm, BLOCK_ACCEPTED_MM
    depth = LABEL_DEPTH_MM if block.label else 0.0
    # The deepest valley of the top lies above this level, and the label lies below it.
    outline = cuts.level((low[2] + depth) / 2.0)
    hidden = [loop for loop in cuts.level(depth / 2.0) if np.ptp(loop[:, 0]) < x - 1e-3] if block.label else []
    dimensions = sides("side", (0.0, 0.0), (x, y), ("top", "left"), accept, accept)
    if key is not None:
        dimensions += [
            Dimension("key along x", (x - key, 0.0), (x, key), "bottom"),
            Dimension("key along y", (x - key, 0.0), (x, key), "right", accept),
        ]
    callouts = []
    if block.engraving is not None:
        sizes = f"glyphs {length(block.engraving.glyph_mm)}, strokes {length(STROKE_MM)}"
        text = f"label {' '.join(block.label_words)}\nin the underside, {length(depth)} deep\n{sizes}"
        callouts.append(Callout(text, max(map(tuple, np.concatenate(hidden).tolist()))))
    crosses: Floats = np.empty((0, 2))
    if press:
        grid = PressGrid.paper(block.scale)
        grid.require_on(block)
        crosses = grid.positions_mm
        (x0, x1), (y0, y1) = ((places[0], places[-1]) for places in (grid.x_mm, grid.y_mm))
        pitch_x, pitch_y = (f"4 x {length(pitch)} = {{}}" for pitch in grid.spacing_mm)
        dimensions += [
            Dimension("first press column", (0.0, y), (x0, y1), "top"),
            Dimension("press columns", (x0, y1), (x1, y1), "top", form=pitch_x),
            Dimension("first press row", (0.0, 0.0), (x0, y0), "left"),
            Dimension("press rows", (x0, y0), (x0, y1), "left", form=pitch_y),
        ]
        callouts.append(Callout("5 x 5 press\npositions", (x1, grid.y_mm[2])))
    outlines = {"seen": outline, "hidden": hidden, "cross": list(crosses[:, None])}
    return DrawingView(outlines, dimensions, callouts, cuts=(high[1], low[0]), shade=_shade(block, mesh))


def _shade(block: Block, mesh: Mesh) -> tuple[Bytes, tuple[float, ...]]:
    """The block from above, shaded and pale, and the rectangle x0, x1, y0, y1 that the picture covers, in mm."""
    low, high = np.array(mesh.bounds_mm)[:, :2]
    pixels = np.maximum(8, np.rint(_SHADE_PIXELS * (high - low) / max(high - low)))
    body = Body(mesh=mesh, relief=relief_of(block))
    image = render([body], int(pixels[0]), int(pixels[1]), Camera(azimuth_deg=-90.0, elevation_deg=90.0))
    pale = np.rint(255.0 - 0.32 * (255.0 - image.astype(np.float64))).astype(np.uint8)
    # The renderer leaves one pixel free on every side.
    half = pixels * max((high - low) / (pixels - 2.0)) / 2.0
    (a, b), (c, d) = (low + high) / 2.0 - half, (low + high) / 2.0 + half
    return pale, (float(a), float(c), float(b), float(d))
