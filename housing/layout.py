"""The positions of pockets, screws and push-out holes in a holder that fits a block, or in the authors' holder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import shapely

from housing.fits import MIN_WALL_MM
from housing.shapes import Bore, Rectangle
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

#: The diameter of the four screw holes, in mm. It is the same as in the authors' holder.
SCREW_HOLE_MM = 4.0
#: The distance from the axis of a screw to both edges of its corner, in mm.
SCREW_INSET_MM = 4.5
#: The diameter of the push-out hole in the floor, in mm, for large and for small blocks.
PUSH_OUTS_MM = (6.0, 3.0)
#: The possible positions of the push-out hole, as fractions of the sides of the block.
_PUSH_OUT_FRACTIONS = (0.3, 0.4, 0.5, 0.6, 0.7)
#: The same for an outline that is not a rectangle.
_OUTLINE_FRACTIONS = tuple(k / 20.0 for k in range(2, 19))
#: The distance between the push-out hole and the press positions, if the block is large enough, in mm.
_PUSH_OUT_CLEAR_MM = 2.0


@dataclass(frozen=True, kw_only=True)
class HolderLayout:
    """A plate with pockets and screw holes, in the holder frame.

    Args:
        plate_mm: The sides and the height of the plate.
        pocket_mm: The sides and the depth of a pocket.
        floor_mm: The thickness of the floor below the pockets.
        pocket_lows_mm: The lower corner of each pocket.
        screws_mm: The axes of the screw holes, at low x and y, high x and low y, low x and high y, high x and y.
    """

    plate_mm: tuple[float, float, float]
    pocket_mm: tuple[float, float, float]
    floor_mm: float
    pocket_lows_mm: tuple[tuple[float, float], ...]
    screws_mm: tuple[tuple[float, float], ...]

    @property
    def pockets(self) -> tuple[Rectangle, ...]:
        """The pockets seen from above."""
        x, y, _ = self.pocket_mm
        return tuple(Rectangle(low=low, high=(low[0] + x, low[1] + y)) for low in self.pocket_lows_mm)

    @property
    def screws(self) -> tuple[Bore, ...]:
        """The screw holes."""
        return tuple(Bore(at_mm=place, diameter_mm=SCREW_HOLE_MM) for place in self.screws_mm)

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The name and the thickness of each wall, in mm."""
        x, y, _ = self.plate_mm
        half = SCREW_HOLE_MM / 2.0
        screws, pockets = shapely.points(self.screws_mm), np.array([p.polygon for p in self.pockets], dtype=object)
        edges = [min(p.low[0], p.low[1], x - p.high[0], y - p.high[1]) for p in self.pockets]
        return {
            "floor": self.floor_mm,
            "wall from pocket to plate edge": min(edges),
            "wall from screw hole to plate edge": min(min(a, b, x - a, y - b) for a, b in self.screws_mm) - half,
            "wall from screw hole to pocket": float(shapely.distance(screws, pockets[:, None]).min()) - half,
        }


#: The authors' holder, as measured. The low edges of the pocket are 9.98 and 30.51 mm from the low edges of the plate,
#: and the high edges of the pocket are 4.31 and 4.50 mm from the high edges of the plate.
RELEASED = HolderLayout(
    plate_mm=(45.39, 65.01, 7.47),
    pocket_mm=(31.1, 30.0, 5.82),
    floor_mm=1.65,
    pocket_lows_mm=((9.98, 30.51),),
    screws_mm=((3.57, 3.10), (42.31, 3.10), (3.31, 62.13), (42.31, 62.13)),
)


def fitted(
    pocket_mm: tuple[float, float, float], slots: int, floor_mm: float, margin_mm: float, web_mm: float
) -> HolderLayout:
    """Return a layout for pockets of one size, in rows, so that the plate is roughly square.

    Args:
        pocket_mm: The sides and the depth of a pocket.
        slots: The number of pockets. They are counted along x first, then along y.
        floor_mm: The thickness of the floor below the pockets.
        margin_mm: The distance from the pockets to the edge of the plate.
        web_mm: The distance between two pockets.
    """
    columns = math.ceil(math.sqrt(slots))
    rows = math.ceil(slots / columns)
    width, length, depth = pocket_mm
    x = columns * width + (columns - 1) * web_mm + 2.0 * margin_mm
    y = rows * length + (rows - 1) * web_mm + 2.0 * margin_mm
    places = ((i % columns, i // columns) for i in range(slots))
    e = SCREW_INSET_MM
    return HolderLayout(
        plate_mm=(x, y, floor_mm + depth),
        pocket_mm=pocket_mm,
        floor_mm=floor_mm,
        pocket_lows_mm=tuple((margin_mm + i * (width + web_mm), margin_mm + j * (length + web_mm)) for i, j in places),
        screws_mm=((e, e), (x - e, e), (e, y - e), (x - e, y - e)),
    )


@dataclass(frozen=True, kw_only=True)
class PushOut:
    """The hole in the floor through which the user pushes out a block, in the block frame.

    Args:
        bore: The hole.
        ledge_mm: The width of the remaining floor around the hole, on which the block rests.
        clear_of_press_mm: The distance from the edge of the hole to the nearest press position; negative if a press
            position is above the hole.
    """

    bore: Bore
    ledge_mm: float
    clear_of_press_mm: float

    @classmethod
    def under(cls, block: Block) -> PushOut:
        """Return the hole under a block.

        The diameter is 6 mm, or 3 mm if the ledge around a hole of 6 mm would be narrower than 1.6 mm. A rectangle has
        25 possible positions, and another outline has more. The ledge also counts to holes of a ring. The hole takes
        the position nearest to the middle of the block that is at least 2 mm away from every press position of the
        paper (at the scale of the block). If there is none, it takes the one furthest from the press positions.
        """
        x, y = block.size_mm
        fractions = _PUSH_OUT_FRACTIONS if block.outline is None else _OUTLINE_FRACTIONS
        places = [(x * a, y * b) for a in fractions for b in fractions]
        for diameter in PUSH_OUTS_MM:
            holes = [cls._at(place, diameter, block) for place in places]
            wide_ledge = [hole for hole in holes if hole.ledge_mm >= MIN_WALL_MM]
            clear = [hole for hole in wide_ledge if hole.clear_of_press_mm >= _PUSH_OUT_CLEAR_MM]
            if clear:
                return min(clear, key=lambda hole: math.dist(hole.bore.at_mm, (x / 2.0, y / 2.0)))
            if wide_ledge:
                return max(wide_ledge, key=lambda hole: hole.clear_of_press_mm)
        return max(holes, key=lambda hole: hole.ledge_mm)

    @classmethod
    def _at(cls, place: tuple[float, float], diameter: float, block: Block) -> PushOut:
        (a, b), (x, y) = place, block.size_mm
        press = PressGrid.paper(block.scale).positions_mm
        inside = min(a, b, x - a, y - b) if block.outline is None else -float(block.outline.distance(a, b))
        return cls(
            bore=Bore(at_mm=place, diameter_mm=diameter),
            ledge_mm=inside - diameter / 2.0,
            clear_of_press_mm=float(np.linalg.norm(press - np.array(place), axis=1).min()) - diameter / 2.0,
        )
