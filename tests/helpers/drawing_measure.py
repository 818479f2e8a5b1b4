"""Compare the numbers of a drawing with its outlines, which were cut out of the mesh."""

from __future__ import annotations

import itertools

import numpy as np
import shapely

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


def closed(loops: Outlines) -> shapely.MultiLineString:
    return shapely.MultiLineString([[*loop, loop[0]] for loop in loops])


def first_hits(point: Point, axis: int, loops: Outlines) -> tuple[float, float]:
    """Return the distances to the first outline below and above a point along an axis; nan if there is none."""
    far = 1e4 * np.eye(2)[axis]
    start, at, rings = np.asarray(point), shapely.Point(point), closed(loops)
    below, above = (shapely.LineString([start, start + way]).intersection(rings) for way in (-far, far))
    return at.distance(below), at.distance(above)


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
            off = np.nan_to_num(abs(below - above), nan=np.inf)
        else:
            off = closed(part if kind == "edge" else outlines_of(view, "other")).distance(shapely.Point(point))
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
        lines = [shapely.LineString(line.get_xydata()) for line in axes.lines if line.get_linewidth() >= 0.45]
    faults = []
    for (name, box), (other_name, other) in itertools.combinations(texts, 2):
        if min(box.x1, other.x1) - max(box.x0, other.x0) > 0.05 and min(box.y1, other.y1) - max(box.y0, other.y0) > 0.3:
            faults.append(f"{name!r} overlaps {other_name!r}")
    for name, box in texts:
        if box.x0 < 5.5 or box.x1 > 291.5 or box.y0 < 5.5 or box.y1 > 204.5:
            faults.append(f"{name!r} leaves the frame")
        inner = shapely.box(box.x0 + 0.3, box.y0 + 0.6, box.x1 - 0.3, box.y1 - 0.6)
        faults += [f"{name!r} overlaps a line {line.wkt}" for line in lines if inner.intersects(line)]
    return faults
