"""Where a holder's plate has its pockets, screws and push-out holes: made to a block, or as the authors had them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from housing.fits import MIN_WALL_MM
from housing.shapes import Bore, Rectangle
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid

#: The four screw holes, as in the authors' holder, in mm.
SCREW_HOLE_MM = 4.0
#: From a screw's axis to both edges of its corner, in mm.
SCREW_INSET_MM = 4.5
#: Holes in the floor through which a block is pushed out, in mm: the first, or the second where the block is small.
PUSH_OUTS_MM = (6.0, 3.0)
#: Fraction of the block's sides at which the push-out hole may stand.
_PUSH_OUT_FRACTIONS = (0.3, 0.4, 0.5, 0.6, 0.7)
#: Distance that the push-out hole keeps from the press positions where it can, in mm.
_PUSH_OUT_CLEAR_MM = 2.0


@dataclass(frozen=True, kw_only=True)
class Layout:
    """A plate with pockets and screw holes, in the holder frame.

    Args:
        plate_mm: Sides and height of the plate.
        pocket_mm: Sides and depth of a pocket.
        floor_mm: Thickness below the pockets.
        pocket_lows_mm: Lower corner of each pocket.
        screws_mm: Axes of the screw holes: low low, high low, low high, high high.
    """

    plate_mm: tuple[float, float, float]
    pocket_mm: tuple[float, float, float]
    floor_mm: float
    pocket_lows_mm: tuple[tuple[float, float], ...]
    screws_mm: tuple[tuple[float, float], ...]

    @property
    def pockets(self) -> tuple[Rectangle, ...]:
        """The pockets' plans."""
        x, y, _ = self.pocket_mm
        return tuple(Rectangle(low=low, high=(low[0] + x, low[1] + y)) for low in self.pocket_lows_mm)

    @property
    def screws(self) -> tuple[Bore, ...]:
        """The screw holes."""
        return tuple(Bore(at_mm=place, diameter_mm=SCREW_HOLE_MM) for place in self.screws_mm)

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """What each wall is, and its thickness in mm."""
        x, y, _ = self.plate_mm
        half = SCREW_HOLE_MM / 2.0
        edges = [min(p.low[0], p.low[1], x - p.high[0], y - p.high[1]) for p in self.pockets]
        return {
            "floor": self.floor_mm,
            "wall from pocket to plate edge": min(edges),
            "wall from screw hole to plate edge": min(min(a, b, x - a, y - b) for a, b in self.screws_mm) - half,
            "wall from screw hole to pocket": min(p.distance_mm(at) for at in self.screws_mm for p in self.pockets)
            - half,
        }


#: The holder that the authors printed, as measured (PAPER.md): low edges of the pocket 9.98 and 30.51 mm from the
#: plate's low edges, high ones 4.31 and 4.50 mm from its high edges.
RELEASED = Layout(
    plate_mm=(45.39, 65.01, 7.47),
    pocket_mm=(31.1, 30.0, 5.82),
    floor_mm=1.65,
    pocket_lows_mm=((9.98, 30.51),),
    screws_mm=((3.57, 3.10), (42.31, 3.10), (3.31, 62.13), (42.31, 62.13)),
)


def fitted(
    pocket_mm: tuple[float, float, float], slots: int, floor_mm: float, margin_mm: float, web_mm: float
) -> Layout:
    """A plate for pockets of one size, in rows that make it about square.

    Args:
        pocket_mm: Sides and depth of a pocket.
        slots: Number of pockets: row by row from low y, each from low x.
        floor_mm: Thickness below them.
        margin_mm: From the pockets to the plate's edge.
        web_mm: Between two pockets.
    """
    columns = math.ceil(math.sqrt(slots))
    rows = math.ceil(slots / columns)
    width, length, depth = pocket_mm
    x = columns * width + (columns - 1) * web_mm + 2.0 * margin_mm
    y = rows * length + (rows - 1) * web_mm + 2.0 * margin_mm
    places = ((i % columns, i // columns) for i in range(slots))
    e = SCREW_INSET_MM
    return Layout(
        plate_mm=(x, y, floor_mm + depth),
        pocket_mm=pocket_mm,
        floor_mm=floor_mm,
        pocket_lows_mm=tuple((margin_mm + i * (width + web_mm), margin_mm + j * (length + web_mm)) for i, j in places),
        screws_mm=((e, e), (x - e, e), (e, y - e), (x - e, y - e)),
    )


@dataclass(frozen=True, kw_only=True)
class PushOut:
    """The hole in the floor through which a block is pushed out, in the block frame.

    Args:
        bore: The hole.
        ledge_mm: Width of the ledge that is left round it for the block to stand on.
        clear_of_press_mm: From its edge to the nearest press position; negative where one lies over the hole.
    """

    bore: Bore
    ledge_mm: float
    clear_of_press_mm: float

    @classmethod
    def under(cls, block: Block) -> PushOut:
        """The hole under a block, of 6 mm, or of 3 mm where a ledge round 6 mm would be below 1.6 mm.

        Of 25 places it takes the nearest to the block's middle that keeps 2 mm from every press position (the
        paper's, at the block's scale); where none does, the one furthest from them.
        """
        x, y = block.size_mm
        wide, narrow = PUSH_OUTS_MM
        diameter = wide if (min(x, y) - wide) / 2.0 >= MIN_WALL_MM else narrow
        places = [(x * a, y * b) for a in _PUSH_OUT_FRACTIONS for b in _PUSH_OUT_FRACTIONS]
        holes = [cls._at(place, diameter, block) for place in places]
        holes = [one for one in holes if one.ledge_mm >= MIN_WALL_MM] or [cls._at((x / 2.0, y / 2.0), diameter, block)]
        clear = [one for one in holes if one.clear_of_press_mm >= _PUSH_OUT_CLEAR_MM]
        if clear:
            return min(clear, key=lambda one: math.dist(one.bore.at_mm, (x / 2.0, y / 2.0)))
        return max(holes, key=lambda one: one.clear_of_press_mm)

    @classmethod
    def _at(cls, place: tuple[float, float], diameter: float, block: Block) -> PushOut:
        (a, b), (x, y) = place, block.size_mm
        press = PressGrid.paper(block.scale).positions_mm
        return cls(
            bore=Bore(at_mm=place, diameter_mm=diameter),
            ledge_mm=min(a, b, x - a, y - b) - diameter / 2.0,
            clear_of_press_mm=float(np.linalg.norm(press - np.array(place), axis=1).min()) - diameter / 2.0,
        )
