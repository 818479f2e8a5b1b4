"""The drawing of a block."""

from __future__ import annotations

import numpy as np

from tacbench_cad.geometry.block_mesh import mesh_block
from tacbench_cad.geometry.mesh import Mesh
from tacbench_cad.render.drawing.cuts import Cuts
from tacbench_cad.render.drawing.sheet import Callout, CutMark, Dimension, Drawing, View, length
from tacbench_cad.render.raster import Camera, render
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.label import LABEL_DEPTH_MM, STROKE_MM
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.spec.sampling import Tolerance, highest_sample
from tacbench_cad.util.text import decimal, mm
from tacbench_cad.util.types import Bytes, Floats

#: Deviation that is accepted of a printed block's sides, height and key, in mm: with two thirds of the clearance of
#: the fit ``slip`` on block and pocket each, the last third is left.
BLOCK_ACCEPTS_MM = 0.1
#: Deviation that is accepted of any other length of a print, in mm.
ACCEPTS_MM = 0.3
#: A section keeps this far from the walls, in mm.
_INSIDE_MM = 1e-5
#: Pixels of the shaded plan along its longer side.
_SHADE_PIXELS = 700


def block_drawing(block: Block, press: bool = False) -> Drawing:
    """Draw a block: the plan, a section through its highest point and one through its lowest.

    Args:
        block: The block.
        press: Show the press positions with the first one's place and their pitch.

    Raises:
        InputError: The block cannot be meshed, or the press grid leaves it.
    """
    mesh = mesh_block(block)[0]
    cuts = Cuts(mesh)
    high, low = _extremes(block, mesh)
    return Drawing(
        name=block.name,
        title=f"Block {block.texture.name}, {mm(*block.size_mm, block.height_mm)}",
        facts=(
            ("texture", block.texture.name),
            ("z", block.texture.equation),
            ("preset", f"{block.preset}, scale {decimal(block.scale)}"),
            ("mm per unit", ", ".join(f"{one:.6g}" for one in block.mm_per_unit)),
            ("surface", _surface(block)),
        ),
        accepts_mm=ACCEPTS_MM,
        plan=_plan(block, mesh, cuts, (float(low[0]), float(high[1])), press),
        front=_front(block, cuts, float(high[1])),
        side=_side(block, cuts, float(low[0]), float(low[1])),
        notes=_notes(block, high, low),
    )


def lowest_mm(block: Block) -> float:
    """Height z of the lowest point of the top as it is printed, in mm: the formula's, or the lowest sample's."""
    if isinstance(block.sampling, Tolerance):
        return block.base_mm
    upside_down = block.surface.mapped((1.0, 1.0), -1.0)
    return block.datum_mm - highest_sample(upside_down, block.samples_mm, block.keep)


def _extremes(block: Block, mesh: Mesh) -> tuple[Floats, Floats]:
    """The highest and the lowest vertex of the top, of equal ones that nearest to the middle; shape (3,) each."""
    z = mesh.vertices[:, 2]
    top = mesh.vertices[z > (LABEL_DEPTH_MM + 1e-3 if block.label else 1e-6)]
    middle = np.array(block.size_mm) / 2.0
    found = []
    for sign in (1.0, -1.0):
        near = top[sign * top[:, 2] >= (sign * top[:, 2]).max() - 1e-6]
        one = near[np.argmin(np.hypot(*(near[:, :2] - middle).T))].copy()
        for i, frequency in enumerate(block.surface.highest_frequency):
            # Where nothing changes along an axis, vertices lie at its ends only.
            one[i] = middle[i] if frequency == 0.0 else np.clip(one[i], _INSIDE_MM, block.size_mm[i] - _INSIDE_MM)
        found.append(one)
    return found[0], found[1]


def _surface(block: Block) -> str:
    sampling = block.sampling
    if isinstance(sampling, Tolerance):
        return f"the file follows the formula within {length(sampling.mm)} mm"
    return f"the file joins {sampling.nx} x {sampling.ny} samples"


def _plan(block: Block, mesh: Mesh, cuts: Cuts, at: tuple[float, float], press: bool) -> View:
    (x, y), key = block.size_mm, block.key_mm
    outline = cuts.level(lowest_mm(block) / 2.0 if not block.label else (lowest_mm(block) + LABEL_DEPTH_MM) / 2.0)
    label = cuts.level(LABEL_DEPTH_MM / 2.0) if block.label else ()
    hidden = tuple(one for one in label if not _is_outline(one, block))
    dimensions = [
        Dimension(name="side x", value_mm=x, start=(0.0, y), end=(x, y), side="top", accept_mm=BLOCK_ACCEPTS_MM),
        Dimension(name="side y", value_mm=y, start=(0.0, 0.0), end=(0.0, y), side="left", accept_mm=BLOCK_ACCEPTS_MM),
    ]
    if key is not None:
        accept = BLOCK_ACCEPTS_MM
        dimensions += [
            Dimension(name="key along x", value_mm=key, start=(x - key, 0.0), end=(x, key), side="bottom"),
            Dimension(
                name="key along y", value_mm=key, start=(x - key, 0.0), end=(x, key), side="right", accept_mm=accept
            ),
        ]
    callouts = []
    if block.engraving is not None:
        words = " ".join(block.label_words)
        points = np.concatenate(hidden)
        tip = points[np.argmax(points[:, 0])]
        text = (
            f"label {words}\nin the underside, {length(LABEL_DEPTH_MM)} deep\n"
            f"glyphs {length(block.engraving.glyph_mm)}, strokes {length(STROKE_MM)}"
        )
        callouts.append(Callout(name="label", text=text, at=(float(tip[0]), float(tip[1]))))
    crosses: tuple[tuple[float, float], ...] = ()
    if press:
        grid = PressGrid.paper(block.scale)
        grid.require_on(block)
        crosses = tuple((float(a), float(b)) for a, b in grid.positions_mm)
        dimensions += _press_dimensions(block, grid)
        last = crosses[len(grid.x_mm) * 3 - 1]
        callouts.append(Callout(name="press positions", text="5 x 5 press\npositions", at=last))
    return View(
        seen=outline,
        hidden=hidden,
        crosses=crosses,
        dimensions=tuple(dimensions),
        callouts=tuple(callouts),
        cut_marks=(CutMark(letter="A", at=at[1], across=True), CutMark(letter="B", at=at[0], across=False)),
        shade=_shade(mesh),
    )


def _press_dimensions(block: Block, grid: PressGrid) -> list[Dimension]:
    (_, y), (x0, x1), (y0, y1) = block.size_mm, (grid.x_mm[0], grid.x_mm[-1]), (grid.y_mm[0], grid.y_mm[-1])
    pitch_x, pitch_y = (f"4 x {length(one)} = {{}}" for one in grid.spacing_mm)
    return [
        Dimension(
            name="first press column", value_mm=x0, start=(0.0, y), end=(x0, y1), side="top", ends=("edge", "cross")
        ),
        Dimension(
            name="press columns",
            value_mm=x1 - x0,
            start=(x0, y1),
            end=(x1, y1),
            side="top",
            ends=("cross", "cross"),
            form=pitch_x,
        ),
        Dimension(
            name="first press row", value_mm=y0, start=(0.0, 0.0), end=(x0, y0), side="left", ends=("edge", "cross")
        ),
        Dimension(
            name="press rows",
            value_mm=y1 - y0,
            start=(x0, y0),
            end=(x0, y1),
            side="left",
            ends=("cross", "cross"),
            form=pitch_y,
        ),
    ]


def _is_outline(loop: Floats, block: Block) -> bool:
    """Whether a loop of the underside is the block's own outline."""
    return bool(np.ptp(loop[:, 0]) > block.size_mm[0] - 1e-3)


def _shade(mesh: Mesh) -> tuple[Bytes, tuple[float, float, float, float]]:
    """The mesh from above, shaded and pale, with where it lies."""
    low, high = mesh.bounds_mm
    x, y = (float(one) for one in (high - low)[:2])
    width, height = (max(8, round(_SHADE_PIXELS * side / max(x, y))) for side in (x, y))
    image = render(mesh, width, height, Camera(azimuth_deg=-90.0, elevation_deg=90.0))
    pale = np.rint(255.0 - 0.32 * (255.0 - image.astype(np.float64))).astype(np.uint8)
    # The renderer leaves a pixel free on every side.
    per_mm = min((width - 2.0) / x, (height - 2.0) / y)
    half_x, half_y = width / per_mm / 2.0, height / per_mm / 2.0
    a, b = float(low[0] + x / 2.0), float(low[1] + y / 2.0)
    return pale, (a - half_x, a + half_x, b - half_y, b + half_y)


def _front(block: Block, cuts: Cuts, y_mm: float) -> View:
    x, top = block.size_mm[0], block.height_mm
    cut = cuts.from_front(y_mm)
    points = np.concatenate(cut)
    peak = float(points[np.argmax(points[:, 1]), 0])
    height = Dimension(
        name="height", value_mm=top, start=(0.0, 0.0), end=(peak, top), side="left", accept_mm=BLOCK_ACCEPTS_MM
    )
    return View(caption="A–A", cut=cut, other=(np.array([(0.0, top), (x, top)]),), dimensions=(height,))


def _side(block: Block, cuts: Cuts, x_mm: float, y_mm: float) -> View:
    (_, y), top, base = block.size_mm, block.height_mm, lowest_mm(block)
    return View(
        caption="B–B",
        cut=cuts.from_right(x_mm),
        other=(np.array([(-top, 0.0), (-top, y)]),),
        dimensions=(
            Dimension(name="base", value_mm=base, start=(-base, y_mm), end=(0.0, y), side="top", form="base {}"),
            Dimension(
                name="relief",
                value_mm=top - base,
                start=(-top, y),
                end=(-base, y_mm),
                side="top",
                ends=("other", "edge"),
                form="relief {}",
            ),
        ),
    )


def _notes(block: Block, high: Floats, low: Floats) -> list[str]:
    notes = [
        f"A–A is cut through the highest point, x {length(high[0])}, y {length(high[1])}; "
        f"B–B through the lowest, x {length(low[0])}, y {length(low[1])}.",
        "Thin chain line: the height of the highest point. Relief: from the lowest point to the highest.",
        "Print with the underside on the bed. No supports.",
    ]
    if block.label:
        notes.append("Dashed: the label, seen through the block; it is read from below.")
    return notes
