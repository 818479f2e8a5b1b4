"""Compare the numbers of a drawing with its outlines, which were cut out of the mesh."""

from __future__ import annotations

import itertools

import numpy as np

from tacbench_cad.extensions.drawings.ink import drawn
from tacbench_cad.extensions.drawings.sheet import Callout, Dimension, Drawing, DrawingView, Outlines, Point
from tacbench_cad.util.plotting import only_style
from tacbench_cad.util.types import Floats

#: The kinds of line on which the two ends of a dimension lie, by the beginning of the dimension's name: an outline of
#: the part (the default), an axis of symmetry, a cross, or the thin outline of another part.
ENDS = {
    "screw from edge": ("edge", "axis"),
    "screw to screw": ("axis", "axis"),
    "push-out from": ("edge", "axis"),
    "first hole from": ("axis", "axis"),
    "columns": ("axis", "axis"),
    "rows": ("axis", "axis"),
    "first press": ("edge", "cross"),
    "press": ("cross", "cross"),
    "relief": ("other", "edge"),
    "clearance": ("edge", "other"),
    "rim": ("edge", "other"),
}
#: The outlines of the part itself.
PART = ("seen", "fine", "hidden", "cut")


def outlines_of(view: DrawingView, *names: str) -> list[Floats]:
    return [loop for name in names for loop in view.outlines.get(name, ())]


def to_outlines(point: Point, loops: Outlines) -> float:
    """Return the distance from a point to the nearest of the closed outlines."""
    distance = np.inf
    for loop in loops:
        a, b = loop, np.roll(loop, -1, axis=0)
        edge = b - a
        fraction = np.clip(((point - a) * edge).sum(1) / np.maximum((edge**2).sum(1), 1e-300), 0.0, 1.0)
        distance = min(distance, float(np.hypot(*(a + fraction[:, None] * edge - point).T).min()))
    return distance


def first_hits(point: Point, axis: int, loops: Outlines) -> tuple[float, float]:
    """Return the distances to the first outline below and above a point along an axis."""
    below, above = np.inf, np.inf
    other = 1 - axis
    for loop in loops:
        a, b = loop, np.roll(loop, -1, axis=0)
        spans = (a[:, other] > point[other]) != (b[:, other] > point[other])
        a, b = a[spans], b[spans]
        fraction = (point[other] - a[:, other]) / (b[:, other] - a[:, other])
        at = a[:, axis] + fraction * (b[:, axis] - a[:, axis]) - point[axis]
        below = min(below, float((-at[at < 0.0]).min(initial=np.inf)))
        above = min(above, float(at[at > 0.0].min(initial=np.inf)))
    return below, above


def faults(drawing: Drawing, within_mm: float) -> list[str]:
    """Return a description of each wrong number in a drawing."""
    faults: list[str] = []
    for view in (drawing.plan, drawing.front, drawing.side):
        for dimension in view.dimensions:
            faults += _dimension(view, dimension, within_mm)
        faults += [fault for callout in view.callouts for fault in _callout(view, callout, within_mm)]
    return faults


def _dimension(view: DrawingView, dimension: Dimension, within_mm: float) -> list[str]:
    axis, part = dimension.axis, outlines_of(view, *PART)
    kinds = next((kinds for name, kinds in ENDS.items() if dimension.name.startswith(name)), ("edge", "edge"))
    faults = []
    for point, kind in zip((dimension.start, dimension.end), kinds, strict=True):
        if kind == "cross":
            off = min(float(np.hypot(*(point - cross[0]))) for cross in view.outlines["cross"])
        elif kind == "axis":
            below, above = first_hits(point, axis, part)
            off = abs(below - above) if np.isfinite(below) else np.inf
        else:
            off = to_outlines(point, part if kind == "edge" else outlines_of(view, "other"))
        if not off <= within_mm:
            faults.append(f"{dimension.name}: {point} is {off} from its {kind}")
    return faults


def _callout(view: DrawingView, callout: Callout, within_mm: float) -> list[str]:
    if callout.diameter_mm is None:
        return []
    rings = [np.hypot(*(loop - callout.at).T) for loop in outlines_of(view, *PART)]
    off = min(float(np.abs(ring - callout.diameter_mm / 2.0).max()) for ring in rings)
    return [] if off <= within_mm else [f"{callout.text}: no circle of that size at {callout.at}, nearest {off}"]


def clashes(drawing: Drawing) -> list[str]:
    """Return a description of each text that overlaps another text, a dimension line or the sheet's frame."""
    with only_style("drawings", {"font.family": "DejaVu Sans"}):
        figure = drawn(drawing)
        axes = figure.axes[0]
        axes.set(xlim=(0.0, 297.0), ylim=(0.0, 210.0))
        renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
        to_mm = axes.transData.inverted()
        texts = []
        for text in axes.texts:
            text.set_bbox(None)
            texts.append((text.get_text().replace("\n", " "), text.get_window_extent(renderer).transformed(to_mm)))
        lines = [np.asarray(line.get_xydata()) for line in axes.lines if line.get_linewidth() >= 0.45]
    faults = []
    for (name, box), (other_name, other) in itertools.combinations(texts, 2):
        if min(box.x1, other.x1) - max(box.x0, other.x0) > 0.05 and min(box.y1, other.y1) - max(box.y0, other.y0) > 0.3:
            faults.append(f"{name!r} overlaps {other_name!r}")
    for name, box in texts:
        if box.x0 < 5.5 or box.x1 > 291.5 or box.y0 < 5.5 or box.y1 > 204.5:
            faults.append(f"{name!r} leaves the frame")
        inner = (box.x0 + 0.3, box.x1 - 0.3, box.y0 + 0.6, box.y1 - 0.6)
        faults += [f"{name!r} overlaps a line {line.tolist()}" for line in lines if _meets(line, inner)]
    return faults


def _meets(line: Floats, box: tuple[float, float, float, float]) -> bool:
    """Return whether a polyline crosses a box, sampled in steps of 0.2 mm."""
    x0, x1, y0, y1 = box
    for a, b in itertools.pairwise(line):
        points = np.linspace(a, b, 2 + int(np.hypot(*(b - a)) / 0.2))
        if ((points[:, 0] > x0) & (points[:, 0] < x1) & (points[:, 1] > y0) & (points[:, 1] < y1)).any():
            return True
    return False
