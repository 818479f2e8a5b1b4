"""Decide whether spots in frames are the markers of a sensor, and how many markers there should be.

Every picture has spots: grains of a material, reflections, dust, blocks of a compressed file. Markers differ from them
in four properties, which all have to hold:

* They are many, in most frames.
* They have more contrast than the noise, the grains and the compression of a soft image.
* Their spacing is regular. For random places, the standard deviation of the distances to the nearest neighbour is 52 %
  of the mean distance. It was 2 to 15 % for the markers of all kinds of frames
  in the tests.
* They are in all frames of a run, displaced smoothly. The print of a fabric is regular too, but moves as it likes.

The limits lie far from both sides; ``tests/extensions/markers/test_pattern.py`` measures the distances.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacbench_cad.extensions.markers.tracking import NEIGHBOURS, MarkerTracker
from tacbench_cad.util.types import Bools, Floats

#: The smallest number of equal spots that are taken for markers.
MIN_MARKERS = 12
#: The smallest usual contrast of markers, in counts.
MIN_CONTRAST = 10.0
#: The largest standard deviation of the distances to the nearest neighbour, as a fraction of their mean.
MAX_IRREGULARITY = 0.36
#: The largest cost of a track from a frame to another frame; it is 1 if fewer than half of the spots are found again.
MAX_COST = 0.45
#: The largest distance of two markers of the same field, relative to the usual distance.
_MAX_GAP = 2.5
#: The smallest number of neighbours of a marker within that distance, relative to the usual number.
_FEW = 0.25
#: A gap is a place for a marker if the circle through its neighbours is larger than the usual one by this factor. The
#: usual one is a quantile of those of some neighbours.
_GAP, _USUAL, _NEAR = 1.35, 0.25, 40


def irregularity(centres_px: Floats) -> float:
    """Return the standard deviation of the distances to the nearest neighbour, as a fraction of their mean."""
    from scipy.spatial import cKDTree

    distance = cKDTree(centres_px).query(centres_px, 2)[0][:, 1]
    return float(distance.std() / distance.mean())


def change(frames_px: Sequence[Floats]) -> float:
    """Return the median cost of the tracks from the frame with most spots to the others; 0 for a single frame."""
    first = max(frames_px, key=len)
    tracker = MarkerTracker(reference_px=first)
    return float(np.median([tracker.follow(each).cost for each in frames_px if each is not first] or [0.0]))


def no_pattern(frames_px: Sequence[Floats], contrast: float) -> str:
    """Return why spots are not markers; empty if they are.

    Args:
        frames_px: The centres of the spots in each frame, shape (n, 2) each.
        contrast: The usual contrast of the spots, in counts.
    """
    count = float(np.median([len(each) for each in frames_px]))
    if count < MIN_MARKERS:
        return f"a frame has {count:g} spots of equal size, and a pattern has at least {MIN_MARKERS}"
    if contrast < MIN_CONTRAST:
        return f"the spots have a contrast of {contrast:.1f} counts, and markers have at least {MIN_CONTRAST:g}"
    many = [each for each in frames_px if len(each) >= MIN_MARKERS]
    uneven = float(np.median([irregularity(each) for each in many]))
    if uneven > MAX_IRREGULARITY:
        return (
            f"the distances between the spots vary by {100 * uneven:.0f} %, and those of markers by at most "
            f"{100 * MAX_IRREGULARITY:.0f} %"
        )
    if change(many) > MAX_COST:
        return "the spots are at other places in each frame"
    return ""


def in_field(centres: Floats) -> Bools:
    """Return whether each centre belongs to the largest group of neighbours."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    if len(centres) < MIN_MARKERS:
        return np.ones(len(centres), dtype=bool)
    tree = cKDTree(centres)
    spacing = float(np.median(tree.query(centres, 2)[0][:, 1]))
    pairs = tree.query_pairs(_MAX_GAP * spacing, output_type="ndarray")
    count = np.bincount(pairs.ravel(), minlength=len(centres))
    pairs = pairs[(count[pairs] > _FEW * np.median(count)).all(axis=1)]  # a spot outside the field has few neighbours
    near = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(centres),) * 2)
    group = connected_components(near, directed=False)[1]
    return np.asarray(group == np.bincount(group).argmax())


def expected_count(centres_px: Floats) -> int:
    """Return how many markers the field should have, from the spacing: those found, and one for each gap.

    If up to a third of the markers are missing, the estimate is right within 12 % for the pins of a TacTip with an even
    spacing, and up to 22 % too small if the spacing differs between directions. Markers that are missing at the rim are
    not counted.

    Args:
        centres_px: The centres of the markers that were found, shape (n, 2).
    """
    from scipy.spatial import cKDTree

    if len(centres_px) <= NEIGHBOURS:
        return len(centres_px)
    points = centres_px
    middle, radius = _empty_circles(points)
    tree = cKDTree(middle)
    usual = np.quantile(radius[tree.query(middle, min(_NEAR, len(middle)))[1]], _USUAL, axis=1)
    while True:
        size = radius / usual[tree.query(middle)[1]]
        added: list[int] = []
        for gap in np.argsort(-size)[: int(np.sum(size >= _GAP))]:
            if all(np.hypot(*(middle[gap] - middle[other])) >= radius[gap] for other in added):
                added.append(int(gap))
        if not added or len(points) > 2 * len(centres_px):
            return len(points)
        points = np.vstack([points, middle[added]])
        middle, radius = _empty_circles(points)


def circle_around(centres_px: Floats) -> str:
    """Return the circle around markers, enlarged by their spacing, as a value of ``--roi``.

    It shows where the sensor is if its surroundings are as dark as its skin, so that no outline is visible.

    Args:
        centres_px: The centres of the markers, shape (n, 2).
    """
    import cv2

    (x, y), radius = cv2.minEnclosingCircle(centres_px.astype(np.float32))
    return f"circle:{x:.1f},{y:.1f},{radius + MarkerTracker(reference_px=centres_px).spacing_px:.1f}"


def _empty_circles(points: Floats) -> tuple[Floats, Floats]:
    """Return the centres (n, 2) and radii (n,) of the circles through three points that contain no other point.

    Circles whose centre is outside of the field are left out.
    """
    from scipy.spatial import Delaunay, Voronoi, cKDTree

    middle = Voronoi(points).vertices
    middle = middle[Delaunay(points).find_simplex(middle) >= 0]
    return middle, cKDTree(points).query(middle)[0]
