"""Pictures of a frame with its markers."""

from __future__ import annotations

import numpy as np

from tacbench_cad.extensions.markers.markers import Markers
from tacbench_cad.extensions.markers.tracking import Track
from tacbench_cad.lab.rig import Frame
from tacbench_cad.util.types import Floats

#: The width of the picture relative to the frame, and the number of binary places of the coordinates.
_ENLARGED, _PLACES = 2, 4
_FOUND, _PREDICTED, _OTHER, _MOVED = (0, 220, 0), (0, 0, 255), (255, 160, 0), (0, 255, 255)


def markers_drawn(frame: Frame, reference_px: Floats, markers: Markers, track: Track) -> Frame:
    """Draw the markers in a frame, which is enlarged twice.

    Args:
        frame: The frame.
        reference_px: The positions from which displacements are measured, shape (n, 2).
        markers: The markers that were found in the frame.
        track: The reference's markers in the frame.

    Returns:
        The picture in BGR. Green markers were followed. Red markers were not found; they are drawn at the positions
        predicted from their neighbours. Blue markers were found, but do not belong to the reference. Yellow lines are
        the displacements from the reference.
    """
    import cv2

    colour = frame if frame.ndim == 3 else cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR)
    picture = cv2.resize(colour, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_CUBIC)
    radius = round(_ENLARGED * 2.0**_PLACES * 5)

    def at(places: Floats) -> list[tuple[int, int]]:
        return [(x, y) for x, y in np.rint((places + 0.5) * _ENLARGED * 2.0**_PLACES).astype(int).tolist()]

    def circle(place: tuple[int, int], shade: tuple[int, int, int]) -> None:
        cv2.circle(picture, place, radius, shade, 1, cv2.LINE_AA, _PLACES)

    places = reference_px + track.displacement_px
    for start, end, found in zip(at(reference_px), at(places), track.found.tolist(), strict=True):
        cv2.line(picture, start, end, _MOVED, 1, cv2.LINE_AA, _PLACES)
        circle(end, _FOUND if found else _PREDICTED)
    others = np.setdiff1d(np.arange(len(markers)), track.index)
    for place in at(markers.centres_px[others]):
        circle(place, _OTHER)
    return np.asarray(picture)
