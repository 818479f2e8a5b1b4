"""The grid-marker jig: a plate on the holder that marks the 5 x 5 press positions of each block.

It is modelled in its place of use, in the holder frame, and printed upside down. Then its marked face is on the bed of
the printer, and the lips and the recesses face up, so that they need no supports.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from housing.engraving import engraved
from housing.fits import (
    FITS,
    MIN_FLOOR_MM,
    NOZZLE_MM,
    ROUNDING_MM,
    clearance_mm,
    min_bearing_wall_mm,
    require_nozzle,
    require_walls,
)
from housing.fixture import Fixture, tidied
from housing.holder import Holder, pocket_tool
from housing.lettering import COUNTER_MM
from housing.marks import (
    DEPTH_MM,
    datum_lines,
    hairs,
    merged,
    min_gap_mm,
    numerals,
    outside_mm2,
)
from housing.seat import AIR_MM, LIP_MM, RECESS_MM, ROOF_MM, Seat
from housing.shapes import Bore, box, cut, one_solid, prism
from tacbench_cad.geometry.kernel import location
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PER_SIDE, PressGrid
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.text import decimal, mm
from tacbench_cad.util.types import Floats

if TYPE_CHECKING:
    from OCP.TopoDS import TopoDS_Solid


#: The smallest length of a lip between two corners, in mm.
MIN_LIP_LENGTH_MM = 8.0
#: The smallest wall between an engraving and the edge of the jig, in mm.
EDGE_MM = 0.8


@dataclass(frozen=True, kw_only=True)
class _Marker:
    """The diameters of a hole and of its lead-in, in mm, and the numbers of the positions that have a hole."""

    hole_mm: float
    lead_in_mm: float
    positions: tuple[int, ...]


_LAST = PER_SIDE * PER_SIDE - 1
_MARKERS = {
    # Only corners and centre: the paper's spacing of 1.25 mm is too small for 25 holes by a nozzle of 0.4 mm.
    "default": _Marker(
        hole_mm=1.5, lead_in_mm=2.2, positions=(0, PER_SIDE - 1, _LAST // 2, _LAST + 1 - PER_SIDE, _LAST)
    ),
    "all": _Marker(hole_mm=0.6, lead_in_mm=0.8, positions=tuple(range(_LAST + 1))),
}
#: The names of the sets of marks.
MARKS: tuple[str, ...] = tuple(_MARKERS)


@dataclass(frozen=True, kw_only=True)
class Jig(Fixture):
    """A grid-marker jig for all slots of a holder.

    Args:
        holder: The holder that the jig rests on, with its blocks.
        press_grid: The press positions; None for the paper's positions at the scale of the block.
        marks: ``default`` for holes at corners and centre and cross hairs elsewhere, for a nozzle of 0.4 mm; ``all``
            for 25 small holes, for resin printers.
        fit: The fit between lips and holder; None for the holder's own clearance, but at least that of ``slip``.
        nozzle_mm: The width of the printer's nozzle, or of a resin printer's pixel. It is the smallest allowed wall
            between markers.

    Raises:
        InputError: A value is not allowed, a press position is outside the block, or markers would merge.
    """

    kind = "jig"
    options = ("jig", *Holder.options)
    asked_by = ("jig",)
    reported = (
        *("holes_per_block", "hole_mm", "lead_in_mm", "cross_hairs_per_block", "press_x_mm", "press_y_mm"),
        *("clearance_per_side_mm", "lip_mm", "air_over_block_mm", "roof_mm", "print_orientation"),
    )

    holder: Holder
    press_grid: PressGrid | None = None
    marks: str = "default"
    fit: str | float | None = None
    nozzle_mm: float = NOZZLE_MM

    @classmethod
    def requested(cls, block: Block, options: Mapping[str, Any]) -> Jig:
        """Return the jig for the holder of a block."""
        names = {"jig": "marks", "nozzle_mm": "nozzle_mm"}
        own = {names[name]: value for name, value in options.items() if name in names}
        return cls(holder=Holder.requested(block, options), **own)

    def __post_init__(self) -> None:
        one_of("jig", self.marks, MARKS)
        require_nozzle(self.nozzle_mm)
        if self.fit is not None:
            clearance_mm(self.fit)
        self.grid.require_on(self.holder.block)
        size = (len(self.grid.x_mm), len(self.grid.y_mm))
        if size != (PER_SIDE, PER_SIDE):
            expected = f"must be {PER_SIDE} x {PER_SIDE} positions, because the jig has marks for this grid only"
            raise InputError("press_grid", f"{size[0]} x {size[1]}", expected)
        self._check_markers()
        self._check_plate()

    def _check_markers(self) -> None:
        """Check that no markers merge."""
        lead, nozzle, scale = self._marker.lead_in_mm, self.nozzle_mm, self.holder.block.scale
        distance = self._min_hole_distance_mm
        if distance - lead < nozzle - ROUNDING_MM:
            min_scale = math.ceil(scale * (lead + nozzle) / distance * 1000.0 - 1e-6) / 1000.0
            raise InputError(
                "jig",
                self.marks,
                f"the markers would merge, because holes {distance:.4g} mm apart with lead-ins of {lead:g} mm leave a "
                f"wall of {distance - lead:.4g} mm, which is thinner than the nozzle ({nozzle:g} mm); use a scale of "
                f"at least {min_scale:g}",
            )
        wall = self._marker_walls["wall between markers"]
        if wall < nozzle - 1e-6:
            x, y = self.grid.spacing_mm
            raise InputError(
                "jig",
                self.marks,
                f"the markers would merge, because at press positions {x:.4g} x {y:.4g} mm apart the thinnest wall "
                f"between marks is {wall:.4g} mm, which is thinner than the nozzle ({nozzle:g} mm); use a larger scale "
                "or a finer nozzle",
            )

    def _check_plate(self) -> None:
        walls = dict(self.seat.walls_mm)
        roof = {name: walls.pop(name) for name in ("roof", "roof below the marks")}
        require_walls("roof", ROOF_MM, roof, MIN_FLOOR_MM)
        require_walls("nozzle", self.nozzle_mm, walls, min_bearing_wall_mm(self.nozzle_mm))
        short = min(self.seat.lip_lengths_mm)
        if short < MIN_LIP_LENGTH_MM:
            raise InputError(
                "size",
                mm(*self.holder.block.size_mm),
                f"a lip of the jig would be {short:.4g} mm long between the corners for the screws; it must be at "
                f"least {MIN_LIP_LENGTH_MM:g} mm long, so make a larger block",
            )
        lost = outside_mm2(self._grooves_in_holder, self.seat.outline(), EDGE_MM)
        if lost > 1e-6:
            raise InputError(
                "press grid",
                self._presses,
                f"{lost:.4g} mm^2 of the jig's numerals and lines would be outside the plate or within {EDGE_MM:g} mm "
                "of its edge; use a holder with a wider margin",
            )

    @property
    def grid(self) -> PressGrid:
        """The press positions in the block frame."""
        return self.press_grid or PressGrid.paper(self.holder.block.scale)

    @property
    def _marker(self) -> _Marker:
        return _MARKERS[self.marks]

    @property
    def holes_mm(self) -> Floats:
        """The press positions with a hole, in the block frame, shape (5, 2) or (25, 2), in mm."""
        return np.asarray(self.grid.positions_mm[list(self._marker.positions)])

    @property
    def cross_hairs_mm(self) -> Floats:
        """The press positions with a cross hair, in the block frame, shape (20, 2) or (0, 2), in mm."""
        return np.delete(self.grid.positions_mm, list(self._marker.positions), axis=0)

    @property
    def _min_hole_distance_mm(self) -> float:
        points = self.holes_mm
        apart = np.linalg.norm(points[:, None] - points[None, :], axis=2)
        return float(apart[np.triu_indices(len(points), 1)].min())

    @property
    def _keep_off_mm(self) -> float:
        """The smallest distance of a hair's edge from the axis of a hole: lead-in radius plus nozzle width, in mm."""
        return self._marker.lead_in_mm / 2.0 + self.nozzle_mm

    @cached_property
    def grooves(self) -> tuple[shapely.Polygon, ...]:
        """The engraved grooves for one block, in the block frame."""
        strokes = hairs(self.grid, self.holes_mm, self._keep_off_mm, self.nozzle_mm)
        strokes += numerals(self.grid, self._keep_off_mm)
        return merged(strokes + datum_lines(self.holder.block.size_mm))

    @cached_property
    def _grooves_in_holder(self) -> tuple[shapely.Polygon, ...]:
        return tuple(
            shapely.transform(groove, place.to_holder)
            for place in self.holder.block_placements()
            for groove in self.grooves
        )

    @cached_property
    def _marker_walls(self) -> Mapping[str, float]:
        grooves = self._grooves_in_holder
        radius = self._marker.lead_in_mm / 2.0
        axes = shapely.points([bore.at_mm for bore in self.bores])
        to_holes = shapely.distance(np.array(grooves, dtype=object)[:, None], axes) - radius
        lead_ins = self._min_hole_distance_mm - 2.0 * radius
        return {
            # The value is rounded to a nanometre, because grooves are merged on a grid of 1e-8 mm.
            "wall between markers": round(min(lead_ins, float(to_holes.min()), min_gap_mm(grooves)), 6),
            "wall inside a numeral": COUNTER_MM,
        }

    @property
    def clearance_mm(self) -> tuple[float, float]:
        """The clearance per side between lips and holder along x and y if the jig is in the middle, in mm."""
        if self.fit is not None:
            return (clearance_mm(self.fit),) * 2
        x, y = self.holder.clearance_mm
        return (max(x, FITS["slip"]), max(y, FITS["slip"]))

    @property
    def datum_shift_mm(self) -> tuple[float, float]:
        """The distance along x and y of a marker from its position if block and jig are pushed to one corner, in mm."""
        (jx, jy), (bx, by) = self.clearance_mm, self.holder.clearance_mm
        return (jx - bx, jy - by)

    @cached_property
    def seat(self) -> Seat:
        """The jig without its markers."""
        return Seat(holder=self.holder, clearance_mm=self.clearance_mm)

    @property
    def bores(self) -> tuple[Bore, ...]:
        """The marker holes in the order of the slots, in the holder frame."""
        marker = self._marker
        return tuple(
            Bore(at_mm=(float(x), float(y)), diameter_mm=marker.hole_mm, lead_in_mm=marker.lead_in_mm)
            for place in self.holder.block_placements()
            for x, y in place.to_holder(self.holes_mm)
        )

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """The size of the bounding box in the orientation of the file, in mm."""
        return (*self.seat.outer.size_mm, self.seat.roof_mm[1] - self.seat.bottom_mm)

    @property
    def drilled(self) -> tuple[tuple[Bore, float], ...]:
        """The through holes: the marker holes of all slots."""
        return tuple((bore, ROOF_MM) for bore in self.bores)

    @property
    def recessed(self) -> tuple[tuple[Bore, float], ...]:
        """The round recesses over discs and rings."""
        if not self.seat.has_outlined_recesses:
            return ()
        depth, wider = self.seat.recess_depth_mm, 2.0 * RECESS_MM
        return tuple(
            (Bore(at_mm=bore.at_mm, diameter_mm=bore.diameter_mm + wider), depth) for bore, _ in self.holder.recessed
        )

    @property
    def walls_mm(self) -> Mapping[str, float]:
        """The name and the thickness of each wall, in mm."""
        return {**self.seat.walls_mm, **self._marker_walls}

    @property
    def name(self) -> str:
        """The stem of the file names: ``jig_paper_x1``, then all values that are not the default."""
        parts = ["jig", self.holder.stem]
        if self.marks != "default":
            parts.append(self.marks)
        scale = self.holder.block.scale
        if self.grid == PressGrid.paper(scale, "1mm"):
            parts.append("1mm")
        elif self.grid != PressGrid.paper(scale):
            parts.append(
                "press" + "_".join("x".join(map(decimal, places)) for places in (self.grid.x_mm, self.grid.y_mm))
            )
        if self.fit is not None:
            parts.append(f"seat{decimal(clearance_mm(self.fit))}")
        if self.nozzle_mm != NOZZLE_MM:
            parts.append(f"nozzle{decimal(self.nozzle_mm)}")
        return "_".join(parts)

    @property
    def title(self) -> str:
        """A description in one line."""
        return f"Grid-marker jig for presses at {self._presses} of each block"

    @property
    def _presses(self) -> str:
        (x0, x1), (y0, y1) = ((places[0], places[-1]) for places in (self.grid.x_mm, self.grid.y_mm))
        return f"x {x0:g} to {x1:g}, y {y0:g} to {y1:g} mm"

    @property
    def volume_mm3(self) -> float:
        """The volume of arms, lips and roof without holes and marks, in mm^3."""
        marks = self.holder.slots * float(sum(groove.area for groove in self.grooves)) * DEPTH_MM
        return self.seat.volume_mm3 - sum(bore.volume_mm3(ROOF_MM) for bore in self.bores) - marks

    @property
    def from_print(self) -> Floats:
        """The matrix (4, 4) from the file's frame to the holder frame, in mm: a half turn about x and a translation."""
        (x0, _), (_, y1), top = self.seat.outer.low, self.seat.outer.high, self.seat.roof_mm[1]
        matrix = np.diag([1.0, -1.0, -1.0, 1.0])
        matrix[:3, 3] = (x0, y1, top)
        return matrix

    @cached_property
    def solid_as_printed(self) -> TopoDS_Solid:
        """The Open CASCADE solid in the orientation of the file, with the marked face on the bed."""
        from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
        from OCP.TopoDS import TopoDS

        to_print = location(np.asarray(np.linalg.inv(self.from_print), dtype=np.float64)).Transformation()
        return TopoDS.Solid_s(BRepBuilderAPI_Transform(self.solid_in_use, to_print, True).Shape())

    @cached_property
    def solid_in_use(self) -> TopoDS_Solid:
        """The Open CASCADE solid in its place of use on the holder, in the holder frame."""
        seat, (ceiling, top) = self.seat, self.seat.roof_mm
        plate = prism(seat.outline(), [], (seat.bottom_mm, top))
        tools = [box(seat.inner, (seat.bottom_mm - 1.0, seat.rest_mm))]
        over = (seat.rest_mm - 1.0, ceiling)
        if seat.has_outlined_recesses:
            tools += [pocket_tool(self.holder, place, RECESS_MM, over) for place in self.holder.block_placements()]
        else:
            tools += [box(recess, over) for recess in seat.recesses]
        tools += [bore.solid((ceiling, top)) for bore in self.bores]
        return engraved(one_solid(cut(plate, tools), "jig"), top, self._grooves_in_holder, DEPTH_MM)

    def spec(self) -> dict[str, Any]:
        """Return all values that define the jig, and notes for the user, as plain JSON values."""
        marker = self._marker
        near = self.crossings_cut_short
        notes = [
            f"the jig rests only on the holder's rim, {AIR_MM:g} mm above the blocks; its corners leave room for the "
            "heads of the screws",
            "push block and jig towards the edges X0 and Y0: both move by their clearance, and then each marker is "
            f"{mm(*tidied(self.datum_shift_mm))} (x, y of the holder) short of its position",
            "rows and columns are numbered from 1 to 5, beginning at low y and low x",
        ]
        if near:
            notes.append(
                f"at {near} of the {len(self.cross_hairs_mm)} cross hairs a hole is so near that the lines end before "
                "they cross; to find these positions, look along the lines of their row and column"
            )
        return {
            "holder": self.holder.name,
            "marks": self.marks,
            "press_x_mm": list(self.grid.x_mm),
            "press_y_mm": list(self.grid.y_mm),
            "hole_mm": marker.hole_mm,
            "lead_in_mm": marker.lead_in_mm,
            "holes_per_block": len(marker.positions),
            "holes_at_mm": [list(bore.at_mm) for bore in self.bores],
            "holes_frame": "holder",
            "cross_hairs_per_block": len(self.cross_hairs_mm),
            "clearance_per_side_mm": self.clearance_mm,
            "datum_shift_mm": self.datum_shift_mm,
            "rest_plane_mm": self.seat.rest_mm,
            "air_over_block_mm": AIR_MM,
            "recess_depth_mm": self.seat.recess_depth_mm,
            "roof_mm": ROOF_MM,
            "lip_mm": (LIP_MM, self.seat.lip_depth_mm),
            "mark_depth_mm": DEPTH_MM,
            "walls_mm": dict(self.walls_mm),
            "nozzle_mm": self.nozzle_mm,
            "print_orientation": "as in the file: upside down, with the marked face on the bed, without supports",
            "notes": notes,
        }

    @property
    def crossings_cut_short(self) -> int:
        """The number of cross hairs without a groove at the crossing point, because a hole is too near."""
        at_crossings = shapely.contains_xy(np.array(self.grooves, dtype=object)[:, None], *self.cross_hairs_mm.T)
        return int(np.count_nonzero(~at_crossings.any(axis=0)))
