"""The holder: a plate with a pocket for each block, screwed to the rig's bed.

Holder frame: lower corner of the plate at the origin, z up, bed at 0; printed as it is used, pockets open upward.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from housing.fits import (
    MIN_FLOOR_MM,
    NOZZLE_MM,
    ROUNDING_MM,
    clearance_mm,
    min_bearing_wall_mm,
    require_nozzle,
    require_walls,
)
from housing.fixture import Fixture
from housing.layout import RELEASED, SCREW_HOLE_MM, Layout, PushOut, fitted
from housing.placement import Placement, block_stem, turned_size_mm
from housing.shapes import Bore, Rectangle, box, one_solid, prism
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import decimal, mm
from tacbench_cad.util.types import Floats

#: How far the holder's top lies below the block's: as in the authors' holder, in mm.
RIM_MM = 1.18
#: Thickness below the pocket: as in the authors' holder, so that the block's top stands as high over the bed, in mm.
FLOOR_MM = 1.65
#: From the pocket to the plate's edge: room for a screw's head in the corner, in mm.
MARGIN_MM = 11.0
#: Between two pockets: a contact of 10 mm radius, 4 mm from the block's edge, stays clear of the next block, in mm.
WEB_MM = 8.0
#: Least depth of a pocket that still holds a block, in mm.
MIN_DEPTH_MM = 1.0
#: Most slots in one tray.
MAX_SLOTS = 24
#: Holders: made to the block, or the one that the authors printed.
PRESETS: tuple[str, ...] = ("fitted", "released")


def min_key_mm(block: Block, fit: str | float = "slip") -> float:
    """The key's leg above which a wrongly turned block does not go into the keyed pocket.

    The pocket is the block's outline moved outwards by the clearance c. A block that is turned by half brings a full
    corner to the filled one; pushed into the opposite corner of the pocket it reaches to ``x - y = X - 2 c``, and the
    pocket ends at ``X - K + sqrt(2) c``. So it goes in up to ``K = (2 + sqrt(2)) c``. Tilting it in its clearance
    helps nothing: to first order a tilt costs more room than it gains. A quarter turn, which a block goes through
    whose sides differ by no more than 2 c, meets the same bound.

    Args:
        block: The block; the bound is the same for all.
        fit: The fit, or mm per side.
    """
    return (2.0 + math.sqrt(2.0)) * clearance_mm(fit)


def require_key(block: Block, fit: str | float) -> None:
    """Refuse a key so small that a block turned by half still goes into a pocket.

    Raises:
        InputError: The block's key is too small for the fit.
    """
    least = min_key_mm(block, fit)
    if block.key_mm is not None and block.key_mm <= least:
        raise InputError(
            "key",
            block.key_mm,
            f"must be above {least:.4g} mm and at most {min(block.size_mm) / 3.0:.4g} mm; with a smaller key, a block "
            f"turned by 180 degrees would still fit (clearance {clearance_mm(fit):g} mm per side)",
        )


@dataclass(frozen=True, kw_only=True)
class Holder(Fixture):
    """A holder, or with more slots a tray, for blocks of one size.

    Args:
        block: The block that it holds: sides, height and key count.
        preset: ``fitted`` is made to the block; ``released`` is the holder that the authors printed, as measured.
        fit: ``press``, ``slip``, ``loose``, or the clearance in mm per side.
        rim_mm: How far the holder's top lies below the block's highest point.
        slots: Number of pockets.
        quarter_turns: Quarter turns counter-clockwise by which the block lies; None for the preset's own: 0, and 1
            in ``released`` (the block's y along the plate's x, which is our reading).
        floor_mm: Thickness below the pockets.
        margin_mm: From the pockets to the plate's edge.
        web_mm: Between two pockets.
        nozzle_mm: The printer's nozzle: sets the least wall, changes nothing else.

    Raises:
        InputError: A value is not allowed, a wall is too thin, or the key would let a wrong orientation in.
    """

    kind = "holder"
    options = ("fit", "rim_mm", "slots", "nozzle_mm")
    asked_by = (*options, "key_mm")

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
        """The holder for a block: in ``released`` the authors' own, where nothing asks for another."""
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
        if self.preset == "released":
            self._check_released()
        else:
            self._check_fitted()

    def _check_fitted(self) -> None:
        most = self.block.height_mm - MIN_DEPTH_MM
        if not 0.0 <= self.rim_mm <= most:
            height = self.block.height_mm
            raise InputError(
                "rim",
                self.rim_mm,
                f"must be from 0 to {most:.4g} mm: a block {height:.4g} mm high needs a pocket of {MIN_DEPTH_MM:g} mm"
                if most >= 0.0
                else f"the block is {height:.4g} mm high, less than the least pocket depth of {MIN_DEPTH_MM:g} mm",
            )
        require_walls("floor", self.floor_mm, {"floor": self.floor_mm}, MIN_FLOOR_MM)
        least = min_bearing_wall_mm(self.nozzle_mm)
        walls = dict(self.walls_mm)
        del walls["floor"]
        if "wall between pockets" in walls:
            require_walls("web", self.web_mm, {"wall between pockets": walls.pop("wall between pockets")}, least)
        ledge = {"ledge round the push-out hole": walls.pop("ledge round the push-out hole")}
        require_walls("size", mm(*self.block.size_mm), ledge, least)
        require_walls("margin", self.margin_mm, walls, least)
        if self.block.key_mm is not None:
            require_key(self.block, self.fit)

    def _check_released(self) -> None:
        for field in fields(self):
            if field.name in ("fit", "rim_mm", "slots", "floor_mm", "margin_mm", "web_mm"):
                value = getattr(self, field.name)
                if value != field.default:
                    name = field.name.removesuffix("_mm")
                    raise InputError(name, value, "the authors' holder is as measured; this needs the fitted one")
        if self.block.key_mm is not None:
            raise InputError("key", self.block.key_mm, "the authors' holder has no key; this needs the fitted one")
        room, sides = RELEASED.pocket_mm[:2], self._footprint_mm
        if any(not -ROUNDING_MM <= room[i] - sides[i] <= 2.0 for i in (0, 1)):
            raise InputError(
                "size",
                mm(*sides),
                f"the authors' holder has a pocket of {mm(*room)} and takes sides of up to 2 mm less; "
                "other blocks need the fitted one",
            )
        if not MIN_DEPTH_MM <= RELEASED.pocket_mm[2] <= self.block.height_mm:
            raise InputError(
                "height", self.block.height_mm, f"the authors' pocket is {RELEASED.pocket_mm[2]:g} mm deep"
            )

    @property
    def holder(self) -> Holder:
        """Itself: the holder in whose frame it is used."""
        return self

    @property
    def is_released(self) -> bool:
        """Whether this is the holder that the authors printed."""
        return self.preset == "released"

    @property
    def turns(self) -> int:
        """Quarter turns counter-clockwise by which the block lies in the holder."""
        return self.quarter_turns if self.quarter_turns is not None else self._own_turns

    @property
    def _own_turns(self) -> int:
        return 1 if self.is_released else 0

    @property
    def _footprint_mm(self) -> tuple[float, float]:
        return turned_size_mm(self.block.size_mm, self.turns)

    @cached_property
    def layout(self) -> Layout:
        """Plate, pockets and screws."""
        if self.is_released:
            return RELEASED
        (x, y), c = self._footprint_mm, clearance_mm(self.fit)
        pocket = (x + 2.0 * c, y + 2.0 * c, self.block.height_mm - self.rim_mm)
        return fitted(pocket, self.slots, self.floor_mm, self.margin_mm, self.web_mm)

    @property
    def clearance_mm(self) -> tuple[float, float]:
        """Clearance per side between block and pocket along the holder's x and y, the block in the middle."""
        if not self.is_released:
            return (clearance_mm(self.fit),) * 2
        (x, y), (room_x, room_y, _) = self._footprint_mm, RELEASED.pocket_mm
        return ((room_x - x) / 2.0, (room_y - y) / 2.0)

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Bounding box of the plate, in mm."""
        return self.layout.plate_mm

    @property
    def pocket_size_mm(self) -> tuple[float, float, float]:
        """Sides and depth of a pocket, in mm."""
        return self.layout.pocket_mm

    @property
    def pockets(self) -> tuple[Rectangle, ...]:
        """The pockets' plans in the holder frame; the key's corner is filled in addition."""
        return self.layout.pockets

    @property
    def screws(self) -> tuple[Bore, ...]:
        """The four screw holes: low low, high low, low high, high high."""
        return self.layout.screws

    @property
    def rim_height_mm(self) -> float:
        """How far the holder's top lies below the block's highest point, in mm: part of the stimulus."""
        return round(self.block.height_mm - RELEASED.pocket_mm[2], 9) if self.is_released else self.rim_mm

    @property
    def pocket_key_mm(self) -> float:
        """Leg of the filled corner of a pocket, in mm: the block's key moved out by the clearance; 0 without a key."""
        if self.block.key_mm is None:
            return 0.0
        return self.block.key_mm + (2.0 - math.sqrt(2.0)) * clearance_mm(self.fit)

    def block_placements(self) -> tuple[Placement, ...]:
        """Where the block lies in each slot, in the middle of its clearance."""
        cx, cy = self.clearance_mm
        return tuple(
            Placement.at((low[0] + cx, low[1] + cy, self.layout.floor_mm), self.block.size_mm, self.turns)
            for low in self.layout.pocket_lows_mm
        )

    @cached_property
    def push_out(self) -> PushOut | None:
        """The push-out hole in the block frame; None in the authors' holder."""
        return None if self.is_released else PushOut.under(self.block)

    @property
    def push_outs(self) -> tuple[Bore, ...]:
        """The push-out holes, slot by slot, in the holder frame."""
        if self.push_out is None:
            return ()
        bore = self.push_out.bore
        points = [one.to_holder([bore.at_mm])[0] for one in self.block_placements()]
        return tuple(Bore(at_mm=(float(x), float(y)), diameter_mm=bore.diameter_mm) for x, y in points)

    @property
    def drilled(self) -> tuple[tuple[Bore, float], ...]:
        """Through holes: four for screws, and one under each block."""
        floor = self.layout.floor_mm
        return (*((bore, self.size_mm[2]) for bore in self.screws), *((bore, floor) for bore in self.push_outs))

    @property
    def admits_deg(self) -> tuple[int, ...]:
        """Angles by which a block may be turned from its proper place and still go in."""
        if self.block.key_mm is not None:
            return (0,)
        x, y = self._footprint_mm
        room_x, room_y, _ = self.pocket_size_mm
        quarter = y <= room_x + ROUNDING_MM and x <= room_y + ROUNDING_MM
        return (0, 90, 180, 270) if quarter else (0, 180)

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The holder's walls and their thickness, in mm."""
        walls = dict(self.layout.walls_mm)
        if self.slots > 1:
            walls["wall between pockets"] = self.web_mm
        if self.push_out is not None:
            walls["ledge round the push-out hole"] = self.push_out.ledge_mm
        return walls

    @property
    def stem(self) -> str:
        """The name without ``holder_``: the block's part, then only what is not the default."""
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
        """Stem of the file names: ``holder_paper_x1_slots6_fit0.2``."""
        return f"holder_{self.stem}"

    @property
    def title(self) -> str:
        """One line for people."""
        who = "Holder as the authors printed it" if self.is_released else "Holder"
        blocks = "1 block" if self.slots == 1 else f"{self.slots} blocks"
        return f"{who} for {blocks} of {mm(*self.block.size_mm, self.block.height_mm)}"

    @property
    def volume_mm3(self) -> float:
        """Plate less pockets, filled corners, screw and push-out holes, in mm^3."""
        x, y, z = self.size_mm
        depth = self.pocket_size_mm[2]
        pockets = sum(p.area_mm2 - self.pocket_key_mm**2 / 2.0 for p in self.pockets) * depth
        screws = sum(bore.volume_mm3(z) for bore in self.screws)
        return x * y * z - pockets - screws - sum(bore.volume_mm3(self.layout.floor_mm) for bore in self.push_outs)

    def pocket_outline(self) -> Floats:
        """A pocket's outline in the block frame, counter-clockwise, shape (n, 2), in mm; the fitted preset's only."""
        (x, y), k = self.block.size_mm, self.pocket_key_mm
        cx, cy = self.clearance_mm if self.turns % 2 == 0 else self.clearance_mm[::-1]
        corner = [(x + cx, -cy)] if k == 0.0 else [(x + cx - k, -cy), (x + cx, -cy + k)]
        return np.array([(-cx, -cy), *corner, (x + cx, y + cy), (-cx, y + cy)])

    @cached_property
    def shape(self) -> Any:
        """The build123d solid, in the holder frame."""
        x, y, z = self.size_mm
        floor = self.layout.floor_mm
        plate = box(Rectangle(low=(0.0, 0.0), high=(x, y)), (0.0, z))
        outline = self.pocket_outline()
        tools = [prism(one.to_holder(outline), [], (floor, z + 1.0)) for one in self.block_placements()]
        tools += [bore.solid((0.0, depth)) for bore, depth in self.drilled]
        return one_solid(plate.cut(*tools), "holder")

    def spec(self) -> dict[str, Any]:
        """Everything that went into the holder, as plain JSON values."""
        angles = " or ".join(map(str, self.admits_deg))
        notes = [
            "print as it lies, pockets upward, no supports",
            f"without a key, a block fits in {len(self.admits_deg)} orientations: turned by {angles} degrees"
            if self.block.key_mm is None
            else f"keyed: one orientation goes in; any key above {min_key_mm(self.block, self.fit):.4g} mm does that",
        ]
        if self.is_released:
            notes += [
                "which way the authors laid the block is our reading: its y along the plate's x; quarter_turns says",
                f"as measured, one screw hole leaves {self.min_wall_mm:.3f} mm to the pocket: slicers leave that out",
                "no push-out hole was measured",
            ]
        if self.push_out is not None:
            clear = self.push_out.clear_of_press_mm
            notes.append(f"nearest press position: {clear:.3g} mm from the push-out hole's edge")
        return {
            "block": block_stem(self.block),
            "block_size_mm": [*self.block.size_mm, self.block.height_mm],
            "preset": self.preset,
            "fit": self.fit if not self.is_released else "measured",
            "clearance_per_side_mm": list(self.clearance_mm),
            "rim_below_block_top_mm": self.rim_height_mm,
            "slots": self.slots,
            "pocket_size_mm": list(self.pocket_size_mm),
            "floor_mm": self.layout.floor_mm,
            "margin_mm": None if self.is_released else self.margin_mm,
            "web_mm": None if self.is_released else self.web_mm,
            "screw_holes": [{"at_mm": list(b.at_mm), "diameter_mm": b.diameter_mm} for b in self.screws],
            "push_out_holes": [{"at_mm": list(b.at_mm), "diameter_mm": b.diameter_mm} for b in self.push_outs],
            "key_mm": self.block.key_mm,
            "least_key_mm": None if self.is_released else min_key_mm(self.block, self.fit),
            "block_admitted_at_deg": list(self.admits_deg),
            "block_placements": [one.as_dict() for one in self.block_placements()],
            "walls_mm": dict(self.walls_mm),
            "nozzle_mm": self.nozzle_mm,
            "print_orientation": "as it lies, pockets upward",
            "notes": notes,
        }

    def facts(self) -> dict[str, str]:
        """The lines of the dimension report."""
        cx, cy = self.clearance_mm
        return {
            "plate": mm(*self.size_mm),
            "pocket": mm(*self.pocket_size_mm)
            + (f", corner filled by {self.pocket_key_mm:.4g} mm" if self.block.key_mm else ""),
            "clearance": f"{mm(cx, cy)} per side",
            "rim": f"{mm(self.rim_height_mm)} below the block's top",
            "floor": mm(self.layout.floor_mm),
            "screw holes": "4 of " + mm(SCREW_HOLE_MM),
            "push-out": f"{len(self.push_outs)} of {mm(self.push_outs[0].diameter_mm)}" if self.push_outs else "none",
            "least wall": self._thinnest,
            "goes in at": ", ".join(map(str, self.admits_deg)) + " degrees",
        }
