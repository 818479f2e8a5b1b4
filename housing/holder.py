"""The holder: a plate with a pocket for each block, screwed to the bed of the rig.

In the holder frame, the lower corner of the plate is at the origin, z points up, and the bed is at z = 0. The holder is
printed in the same orientation, with the pockets up.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

from housing.fits import (
    MIN_FLOOR_MM,
    NOZZLE_MM,
    ROUNDING_MM,
    clearance_mm,
    min_bearing_wall_mm,
    min_key_mm,
    require_key,
    require_nozzle,
    require_walls,
)
from housing.fixture import CHORD_MM, Fixture
from housing.layout import RELEASED, HolderLayout, PushOut, fitted
from housing.placement import Placement, block_stem, turned_size_mm
from housing.shapes import Bore, Rectangle, box, cut, cylinder, one_solid, prism
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.outlines import Circle, Corners, Loop
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import decimal, mm
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid

#: The height from the holder's top to the block's highest point, in mm. It is the same as in the authors' holder.
RIM_MM = 1.18
#: The thickness of the floor below the pocket, in mm. It is the same as in the authors' holder, so that the block's
#: top has the same height above the bed.
FLOOR_MM = 1.65
#: The distance from the pocket to the edge of the plate, in mm. It leaves room for the head of a screw in the corner.
MARGIN_MM = 11.0
#: The distance between two pockets, in mm. A contact of 10 mm radius at 4 mm from the edge of a block does not reach
#: the next block.
WEB_MM = 8.0
#: The smallest depth of a pocket that still holds a block, in mm.
MIN_DEPTH_MM = 1.0
#: The largest number of slots in a holder.
MAX_SLOTS = 24
#: The presets: a holder that fits the block, and the holder that the authors printed.
PRESETS: tuple[str, ...] = ("fitted", "released")


def pocket_tool(holder: Holder, place: Placement, grown_mm: float, z_mm: tuple[float, float]) -> Any:
    """Return the solid that cuts the pocket of a block, or a wider recess over it.

    Args:
        holder: The holder.
        place: The placement of the block.
        grown_mm: How much wider the recess is than the pocket, on each side.
        z_mm: The lower and the upper end.
    """
    loop = holder.pocket_loop.moved_outwards(grown_mm)
    if isinstance(loop, Circle):
        x, y = place.to_holder([loop.centre])[0].tolist()
        return cylinder((x, y), loop.radius, z_mm)
    return prism(place.to_holder(loop.array), [], z_mm)


@dataclass(frozen=True, kw_only=True)
class Holder(Fixture):
    """A holder for one block, or for several blocks of the same size.

    Args:
        block: The block. The holder depends on its sides, its height and its key.
        preset: ``fitted`` for a holder that fits the block, ``released`` for the authors' holder as measured.
        fit: ``press``, ``slip``, ``loose``, or the clearance in mm per side.
        rim_mm: The height from the holder's top to the block's highest point.
        slots: The number of pockets.
        quarter_turns: The number of quarter turns, counter-clockwise, of the block in its pocket. None stands for the
            preset's own value: 0 for ``fitted``, and 1 for ``released``, where we assume that the block's y axis is
            along the plate's x axis.
        floor_mm: The thickness of the floor below the pockets.
        margin_mm: The distance from the pockets to the edge of the plate.
        web_mm: The distance between two pockets.
        nozzle_mm: The width of the printer's nozzle. It sets the smallest allowed wall and has no other effect.

    Raises:
        InputError: A value is not allowed, a wall is too thin, or the block would still fit in a wrong orientation
            because the key is too small.
    """

    kind = "holder"
    options = ("fit", "rim_mm", "slots", "nozzle_mm")
    asked_by = (*options, "key_mm")
    reported = (
        *("pocket_size_mm", "clearance_per_side_mm", "rim_below_block_top_mm", "floor_mm", "screw_holes"),
        *("push_out_holes", "filled_corner_mm", "block_fits"),
    )

    block: Block
    preset: str = "fitted"
    fit: str | float = "slip"
    rim_mm: float = RIM_MM
    slots: int = 1
    quarter_turns: int | None = None
    floor_mm: float = FLOOR_MM
    margin_mm: float = MARGIN_MM
    web_mm: float = WEB_MM
    nozzle_mm: float = NOZZLE_MM

    @classmethod
    def requested(cls, block: Block, options: Mapping[str, Any]) -> Holder:
        """Return the holder for a block.

        For the preset ``released`` this is the authors' holder, unless the block or the options need another holder.
        """
        own = {name: value for name, value in options.items() if name in cls.options}
        if block.preset == "released" and not set(own) - {"nozzle_mm"}:
            with contextlib.suppress(InputError):
                return cls(block=block, preset="released", **own)
        return cls(block=block, **own)

    def __post_init__(self) -> None:
        one_of("holder preset", self.preset, PRESETS)
        require_nozzle(self.nozzle_mm)
        if self.quarter_turns not in (None, 0, 1, 2, 3):
            raise InputError("quarter turns", self.quarter_turns, "must be 0, 1, 2 or 3")
        clearance_mm(self.fit)
        if isinstance(self.slots, bool) or not isinstance(self.slots, int) or not 1 <= self.slots <= MAX_SLOTS:
            raise InputError("slots", self.slots, f"must be a whole number from 1 to {MAX_SLOTS}")
        for field in ("rim_mm", "floor_mm", "margin_mm", "web_mm"):
            value = getattr(self, field)
            if isinstance(value, bool) or not math.isfinite(value):
                raise InputError(field.removesuffix("_mm"), value, "must be a number of mm")
        if self.is_released:
            self._check_released()
        else:
            self._check_fitted()

    def _check_fitted(self) -> None:
        max_rim = self.block.height_mm - MIN_DEPTH_MM
        if not 0.0 <= self.rim_mm <= max_rim:
            height = self.block.height_mm
            raise InputError(
                "rim",
                self.rim_mm,
                f"must be from 0 to {max_rim:.4g} mm, so that the block, which is {height:.4g} mm high, has a pocket "
                f"of {MIN_DEPTH_MM:g} mm"
                if max_rim >= 0.0
                else f"the block is only {height:.4g} mm high, but a pocket is at least {MIN_DEPTH_MM:g} mm deep",
            )
        require_walls("floor", self.floor_mm, {"floor": self.floor_mm}, MIN_FLOOR_MM)
        min_wall = min_bearing_wall_mm(self.nozzle_mm)
        walls = dict(self.walls_mm)
        del walls["floor"]
        if "wall between pockets" in walls:
            require_walls("web", self.web_mm, {"wall between pockets": walls.pop("wall between pockets")}, min_wall)
        ledge = {"ledge round the push-out hole": walls.pop("ledge round the push-out hole")}
        require_walls("size", mm(*self.block.size_mm), ledge, min_wall)
        require_walls("margin", self.margin_mm, walls, min_wall)
        if self.block.key_mm is not None:
            require_key(self.block, self.fit)

    def _check_released(self) -> None:
        for field in fields(self):
            if field.name in ("fit", "rim_mm", "slots", "floor_mm", "margin_mm", "web_mm"):
                value = getattr(self, field.name)
                if value != field.default:
                    name = field.name.removesuffix("_mm")
                    raise InputError(name, value, "the authors' holder cannot be changed; use the preset fitted")
        if self.block.key_mm is not None:
            raise InputError("key", self.block.key_mm, "the authors' holder has no key; use the preset fitted")
        if self.block.outline is not None:
            allowed = "does not fit the authors' holder; use the preset fitted"
            raise InputError("outline", str(self.block.outline), allowed)
        room, sides = RELEASED.pocket_mm[:2], self.footprint_mm
        if any(not -ROUNDING_MM <= room[i] - sides[i] <= 2.0 for i in (0, 1)):
            raise InputError(
                "size",
                mm(*sides),
                f"the pocket of the authors' holder is {mm(*room)}, and the sides of a block may be at most 2 mm "
                "smaller; use the preset fitted for other blocks",
            )
        if not MIN_DEPTH_MM <= RELEASED.pocket_mm[2] <= self.block.height_mm:
            raise InputError(
                "height", self.block.height_mm, f"must be at least {RELEASED.pocket_mm[2]:g} mm for the authors' holder"
            )

    @property
    def holder(self) -> Holder:
        """The holder itself, because a holder is used in its own frame."""
        return self

    @property
    def is_released(self) -> bool:
        """Whether this is the authors' holder."""
        return self.preset == "released"

    @property
    def turns(self) -> int:
        """The number of quarter turns, counter-clockwise, of the block in the holder."""
        return self.quarter_turns if self.quarter_turns is not None else self._own_turns

    @property
    def _own_turns(self) -> int:
        return 1 if self.is_released else 0

    @property
    def footprint_mm(self) -> tuple[float, float]:
        """The sides of the block along the holder's x and y, in mm."""
        return turned_size_mm(self.block.size_mm, self.turns)

    @cached_property
    def layout(self) -> HolderLayout:
        """The positions and sizes of plate, pockets and screws."""
        if self.is_released:
            return RELEASED
        low, high = self.pocket_loop.box
        room = turned_size_mm((high[0] - low[0], high[1] - low[1]), self.turns)
        depth = self.block.height_mm - self.rim_mm
        return fitted((*room, depth), self.slots, self.floor_mm, self.margin_mm, self.web_mm)

    @property
    def clearance_mm(self) -> tuple[float, float]:
        """The clearance per side along the holder's x and y if the block is in the middle of its pocket, in mm."""
        if not self.is_released:
            return (clearance_mm(self.fit),) * 2
        (x, y), (room_x, room_y, _) = self.footprint_mm, RELEASED.pocket_mm
        return ((room_x - x) / 2.0, (room_y - y) / 2.0)

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """The size of the plate, in mm."""
        return self.layout.plate_mm

    @property
    def pocket_size_mm(self) -> tuple[float, float, float]:
        """The sides and the depth of a pocket, in mm."""
        return self.layout.pocket_mm

    @property
    def pockets(self) -> tuple[Rectangle, ...]:
        """The pockets seen from above, in the holder frame, without the filled corner of a key."""
        return self.layout.pockets

    @property
    def screws(self) -> tuple[Bore, ...]:
        """The four screw holes, at low x and y, high x and low y, low x and high y, high x and y."""
        return self.layout.screws

    @property
    def rim_height_mm(self) -> float:
        """The height from the holder's top to the block's highest point, in mm. It influences what the sensor feels."""
        return round(self.block.height_mm - RELEASED.pocket_mm[2], 9) if self.is_released else self.rim_mm

    @property
    def pocket_key_mm(self) -> float:
        """The leg of the filled corner of a pocket, in mm: the key offset by the clearance, or 0 without a key."""
        if self.block.key_mm is None:
            return 0.0
        return self.block.key_mm + (2.0 - math.sqrt(2.0)) * clearance_mm(self.fit)

    def block_placements(self) -> tuple[Placement, ...]:
        """Return the placement of the block in each slot, in the middle of its clearance."""
        return tuple(
            Placement.of_box((*low, self.layout.floor_mm), self.pocket_loop.box, self.turns)
            for low in self.layout.pocket_lows_mm
        )

    @cached_property
    def push_out(self) -> PushOut | None:
        """The push-out hole in the block frame; None for the authors' holder."""
        return None if self.is_released else PushOut.under(self.block)

    @cached_property
    def pocket_loop(self) -> Loop:
        """The outline of a pocket in the block frame: that of the block, moved outwards by the clearance."""
        if self.block.region is not None:
            return self.block.region.loops[0].moved_outwards(self.clearance_mm[0])
        (x, y), (cx, cy) = self.block.size_mm, turned_size_mm(self.clearance_mm, self.turns)
        return Corners(((-cx, -cy), (x + cx, -cy), (x + cx, y + cy), (-cx, y + cy)))

    @property
    def recessed(self) -> tuple[tuple[Bore, float], ...]:
        """The round pockets of discs and rings."""
        loop, depth = self.pocket_loop, self.pocket_size_mm[2]
        if not isinstance(loop, Circle):
            return ()
        centres = [place.to_holder([loop.centre])[0] for place in self.block_placements()]
        return tuple((Bore(at_mm=(float(x), float(y)), diameter_mm=2.0 * loop.radius), depth) for x, y in centres)

    @property
    def push_outs(self) -> tuple[Bore, ...]:
        """The push-out holes in the order of the slots, in the holder frame."""
        if self.push_out is None:
            return ()
        bore = self.push_out.bore
        points = [place.to_holder([bore.at_mm])[0] for place in self.block_placements()]
        return tuple(Bore(at_mm=(float(x), float(y)), diameter_mm=bore.diameter_mm) for x, y in points)

    @property
    def drilled(self) -> tuple[tuple[Bore, float], ...]:
        """The through holes: four for screws, and a push-out hole under each block."""
        floor = self.layout.floor_mm
        return (*((bore, self.size_mm[2]) for bore in self.screws), *((bore, floor) for bore in self.push_outs))

    @property
    def admits_deg(self) -> tuple[int, ...]:
        """The angles by which a block can be turned and fits into its pocket, in degrees. No angles stand for all."""
        if self.block.key_mm is not None:
            return (0,)
        if self.block.outline is not None:
            turns = self.block.outline.turns
            return () if turns is None else tuple(round(360 * k / turns) for k in range(turns))
        x, y = self.footprint_mm
        room_x, room_y, _ = self.pocket_size_mm
        quarter = y <= room_x + ROUNDING_MM and x <= room_y + ROUNDING_MM
        return (0, 90, 180, 270) if quarter else (0, 180)

    @property
    def _orientations(self) -> str:
        if not self.admits_deg:
            return "in any orientation; mark the block, so that it is always inserted in the same one"
        if self.admits_deg == (0,):
            return "in one orientation only"
        angles = " or ".join(map(str, self.admits_deg))
        return f"in {len(self.admits_deg)} orientations: turned by {angles} degrees"

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The name and the thickness of each wall, in mm."""
        walls = dict(self.layout.walls_mm)
        if self.slots > 1:
            walls["wall between pockets"] = self.web_mm
        if self.push_out is not None:
            walls["ledge round the push-out hole"] = self.push_out.ledge_mm
        return walls

    @property
    def stem(self) -> str:
        """The name without ``holder_``: the preset and scale of the block, then all values that are not the default."""
        parts = [block_stem(self.block)]
        if self.is_released:
            parts.append("measured")
        if self.slots != 1:
            parts.append(f"slots{self.slots}")
        if self.turns != self._own_turns:
            parts.append(f"turn{self.turns}")
        if clearance_mm(self.fit) != clearance_mm("slip"):
            parts.append(f"fit{decimal(clearance_mm(self.fit))}")
        defaults = (("rim", RIM_MM), ("floor", FLOOR_MM), ("margin", MARGIN_MM), ("web", WEB_MM))
        for word, default in defaults:
            value = getattr(self, f"{word}_mm")
            if value != default:
                parts.append(f"{word}{decimal(value)}")
        return "_".join(parts)

    @property
    def name(self) -> str:
        """The stem of the file names: ``holder_paper_x1_slots6_fit0.2``."""
        return f"holder_{self.stem}"

    @property
    def title(self) -> str:
        """A description in one line."""
        who = "Holder as the authors printed it" if self.is_released else "Holder"
        blocks = "1 block" if self.slots == 1 else f"{self.slots} blocks"
        return f"{who} for {blocks} of {mm(*self.block.size_mm, self.block.height_mm)}"

    @property
    def volume_mm3(self) -> float:
        """The volume of the plate without pockets, screw holes and push-out holes, in mm^3."""
        x, y, z = self.size_mm
        depth = self.pocket_size_mm[2]
        pockets = self.slots * self.pocket_loop.area_mm2 * depth
        screws = sum(bore.volume_mm3(z) for bore in self.screws)
        return x * y * z - pockets - screws - sum(bore.volume_mm3(self.layout.floor_mm) for bore in self.push_outs)

    def pocket_outline(self) -> Floats:
        """Return the outline of a pocket in the block frame, counter-clockwise, shape (n, 2), in mm.

        Chords replace a circle.
        """
        return self.pocket_loop.chords(CHORD_MM, None)[0].array

    @cached_property
    def solid_in_use(self) -> TopoDS_Solid:
        """The Open CASCADE solid, in the holder frame."""
        x, y, z = self.size_mm
        floor = self.layout.floor_mm
        plate = box(Rectangle(low=(0.0, 0.0), high=(x, y)), (0.0, z))
        tools = [pocket_tool(self, place, 0.0, (floor, z + 1.0)) for place in self.block_placements()]
        tools += [bore.solid((0.0, depth)) for bore, depth in self.drilled]
        return one_solid(cut(plate, tools), "holder")

    def spec(self) -> dict[str, Any]:
        """Return all values that define the holder, and notes for the user, as plain JSON values."""
        notes = [
            "print in the orientation of the file, with the pockets up, without supports",
            f"a block fits {self._orientations}"
            + ("" if self.block.key_mm is None else f"; for that the key must be above {min_key_mm(self.fit):.4g} mm"),
        ]
        if self.is_released:
            notes += [
                "the orientation of the authors' block is our assumption: its y axis is along the plate's x axis "
                "(see quarter_turns)",
                f"the wall between one screw hole and the pocket is {self.min_wall_mm:.3f} mm, as measured; slicers do "
                "not print such a thin wall",
                "the measurements of the authors' holder include no push-out hole",
            ]
        if self.push_out is not None:
            clear = self.push_out.clear_of_press_mm
            notes.append(f"the press position nearest to the push-out hole is {clear:.3g} mm from the hole's edge")
        return {
            "block": block_stem(self.block),
            "block_size_mm": (*self.block.size_mm, self.block.height_mm),
            "preset": self.preset,
            "fit": self.fit if not self.is_released else "measured",
            "clearance_per_side_mm": self.clearance_mm,
            "rim_below_block_top_mm": self.rim_height_mm,
            "slots": self.slots,
            "pocket_size_mm": self.pocket_size_mm,
            "floor_mm": self.layout.floor_mm,
            "margin_mm": None if self.is_released else self.margin_mm,
            "web_mm": None if self.is_released else self.web_mm,
            "screw_holes": [{"at_mm": list(b.at_mm), "diameter_mm": b.diameter_mm} for b in self.screws],
            "push_out_holes": [{"at_mm": list(b.at_mm), "diameter_mm": b.diameter_mm} for b in self.push_outs],
            "key_mm": self.block.key_mm,
            "least_key_mm": None if self.is_released else min_key_mm(self.fit),
            "filled_corner_mm": self.pocket_key_mm or None,
            "block_admitted_at_deg": list(self.admits_deg),
            "block_fits": self._orientations,
            "block_placements": [place.as_dict() for place in self.block_placements()],
            "walls_mm": dict(self.walls_mm),
            "nozzle_mm": self.nozzle_mm,
            "print_orientation": "as in the file, with the pockets up",
            "notes": notes,
        }
