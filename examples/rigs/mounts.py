"""Mounts for a first press rig: they join the sensor to a 3D printer or a CNC machine, and the holder to a load cell.

    python examples/rigs/mounts.py [FOLDER]

The script writes STEP, STL and a drawing with dimensions (PDF) of each part, and checks each file. All screw patterns
are values at the beginning of the script. Measure your machine, your sensor and your load cell, and change the values.
"""

import sys
from dataclasses import dataclass
from math import cos, hypot, pi, radians, sin
from pathlib import Path

from build123d import Align, Box, Cylinder, Face, Polyline, Pos, Rot, Vector, extrude
from build123d import Part as Body

from housing import Holder
from tacbench_cad import Block, PrintPart, export
from tacbench_cad.extensions.drawings import save_drawing
from tacbench_cad.extensions.drawings.cuts import Cuts
from tacbench_cad.extensions.drawings.sheet import Dimension, Drawing, DrawingView
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.text import mm, report

#: For each screw: the diameter of its hole, and the diameter and depth of the recess for its head (ISO 273, ISO 4762).
SCREWS = {"M2": (2.4, 4.8, 2.5), "M3": (3.4, 6.5, 3.5), "M4": (4.5, 8.0, 4.5), "M5": (5.5, 9.5, 5.5)}
LOW = (Align.CENTER, Align.CENTER, Align.MIN)


@dataclass(frozen=True)
class Pattern:
    """Screw holes around a middle.

    Args:
        at_mm: The middle of each hole, relative to the middle of the pattern.
        screw: The size of the screws.
    """

    at_mm: tuple[tuple[float, float], ...]
    screw: str

    @classmethod
    def circle(cls, count: int, diameter_mm: float, screw: str) -> "Pattern":
        turns = [radians(360.0 * (k + 0.5) / count) for k in range(count)]
        return cls(tuple((diameter_mm / 2.0 * cos(turn), diameter_mm / 2.0 * sin(turn)) for turn in turns), screw)

    @classmethod
    def rectangle(cls, x_mm: float, y_mm: float, screw: str) -> "Pattern":
        return cls(tuple((x_mm / 2.0 * i, y_mm / 2.0 * j) for i in (-1, 1) for j in (-1, 1)), screw)

    @property
    def hole_mm(self) -> float:
        """The diameter of a hole."""
        return SCREWS[self.screw][0]

    @property
    def reach_mm(self) -> float:
        """The distance of the farthest hole from the middle."""
        return max(hypot(x, y) for x, y in self.at_mm)

    def bores(self, depth_mm: float) -> list[Body]:
        """Return the holes as solids that begin at z = 0."""
        return [Pos(x, y, 0) * Cylinder(self.hole_mm / 2, depth_mm, align=LOW) for x, y in self.at_mm]

    def area_mm2(self) -> float:
        """Return the area of all holes."""
        return len(self.at_mm) * pi * self.hole_mm**2 / 4.0


# Measure these values. The patterns of machines and sensors differ from maker to maker.
#: The carriage of the printer: the screws that hold its hot end.
CARRIAGE = Pattern.rectangle(20.0, 30.0, "M3")
#: The clamp of the CNC machine: the diameter and the height of its spindle.
SPINDLE_MM, SPINDLE_HEIGHT_MM = 44.8, 35.0
#: The sensors: their screws, and the diameter of the opening for the sensor's body or its cable.
SENSORS = {"TacTip": (Pattern.circle(4, 56.0, "M3"), 42.0), "pad": (Pattern.rectangle(52.0, 36.0, "M3"), 12.0)}
#: The round body of a camera or a sensor, held by a ring with three set screws.
CAMERA_MM = 30.0
#: The load cell, a bar: length, width, and the distances of its two holes from each end, with their screws.
CELL_MM, CELL_HOLES_MM, CELL_SCREWS = (80.0, 12.7), (5.0, 20.0), ("M5", "M4")
#: The block that the holder on the load cell is for.
BLOCK = Block.of(1)

#: The distance from a hole's middle to the edge of a part, and the thickness of plates. A bracket of 10 mm in PLA that
#: holds the sensor 45 mm in front of the carriage bends by about 0.01 mm under 5 N.
EDGE_MM, PLATE_MM, REACH_MM = 8.0, 10.0, 45.0
#: The chamfer of the bracket's inner corner, the room between a bar and a plate, and the recess of a set screw.
CHAMFER_MM, GAP_MM, SET_SCREW_MM = 8.0, 3.0, 2.6


def bracket(sensor: str) -> tuple[PrintPart, Drawing]:
    """Return an angle: one leg is screwed onto a printer's carriage, the other holds the sensor below it."""
    pattern, opening = SENSORS[sensor]
    depth = REACH_MM + max(pattern.reach_mm, opening / 2.0) + EDGE_MM
    back_high = max(abs(y) for _, y in CARRIAGE.at_mm) * 2.0 + 2.0 * EDGE_MM
    height = PLATE_MM + CHAMFER_MM + back_high
    width = 2.0 * (max(pattern.reach_mm, CARRIAGE.reach_mm, opening / 2.0) + EDGE_MM)
    side = [
        (0.0, 0.0),
        (depth, 0.0),
        (depth, PLATE_MM),
        (PLATE_MM + CHAMFER_MM, PLATE_MM),
        (PLATE_MM, PLATE_MM + CHAMFER_MM),
        (PLATE_MM, height),
        (0.0, height),
    ]
    # The leg for the sensor lies along x, and the carriage's leg stands at x = 0; both are extruded along z.
    body = extrude(Face(Polyline(*side, close=True).wire()), width, dir=Vector(0, 0, 1))
    middle = Pos(REACH_MM, 0, width / 2.0) * Rot(-90, 0, 0)
    body -= [middle * bore for bore in pattern.bores(PLATE_MM)]
    body -= middle * Cylinder(opening / 2.0, PLATE_MM, align=LOW)
    back = Pos(0, PLATE_MM + CHAMFER_MM + back_high / 2.0, width / 2.0) * Rot(0, 90, 0)
    body -= [back * bore for bore in CARRIAGE.bores(PLATE_MM)]
    area = depth * PLATE_MM + (height - PLATE_MM) * PLATE_MM + CHAMFER_MM**2 / 2.0
    holes = PLATE_MM * (pattern.area_mm2() + CARRIAGE.area_mm2() + pi * opening**2 / 4.0)
    part = PrintPart.of_solid(
        body.solid(),
        name=f"bracket-{sensor.lower()}",
        kind="mount",
        title=f"Bracket on a printer's carriage, for the sensor {sensor}",
        genus=len(pattern.at_mm) + len(CARRIAGE.at_mm) + 1,
        volume_mm3=area * width - holes,
    )
    dimensions = [
        Dimension("leg for the sensor", (0.0, 0.0), (depth, 0.0), "bottom"),
        Dimension("leg for the carriage", (0.0, 0.0), (0.0, height), "left"),
        Dimension("sensor's axis", (0.0, height), (REACH_MM, PLATE_MM), "top"),
        Dimension("thickness", (depth, 0.0), (depth, PLATE_MM), "right"),
    ]
    notes = [
        f"Holes for the sensor: {_listed(pattern)} around the axis; opening {opening:g} mm.",
        f"Holes for the carriage: {_listed(CARRIAGE)}.",
        "Print as drawn, on its side: the layers then carry the load. No supports.",
    ]
    return part, _drawing(part, dimensions, [], notes, at=(REACH_MM, PLATE_MM / 2.0), levels=(width / 2.0,))


def spigot(sensor: str) -> tuple[PrintPart, Drawing]:
    """Return a flange for the sensor with a tube that goes into the spindle clamp of a CNC machine."""
    pattern, opening = SENSORS[sensor]
    inner = min(opening, SPINDLE_MM - 12.0)
    nearest = min(hypot(x, y) for x, y in pattern.at_mm)
    if nearest < SPINDLE_MM / 2.0 + EDGE_MM / 2.0:
        raise InputError(f"the screws of {sensor}", nearest, "must be outside of the spindle's tube; use a bracket")
    radius = pattern.reach_mm + EDGE_MM
    body = Cylinder(radius, PLATE_MM, align=LOW)
    body += Pos(0, 0, PLATE_MM) * Cylinder(SPINDLE_MM / 2.0, SPINDLE_HEIGHT_MM, align=LOW)
    body -= Cylinder(inner / 2.0, PLATE_MM + SPINDLE_HEIGHT_MM, align=LOW)
    body -= pattern.bores(PLATE_MM)
    top = PLATE_MM + SPINDLE_HEIGHT_MM
    volume = pi * (radius**2 * PLATE_MM + SPINDLE_MM**2 / 4.0 * SPINDLE_HEIGHT_MM - inner**2 / 4.0 * top)
    part = PrintPart.of_solid(
        body.solid(),
        name=f"spigot-{sensor.lower()}",
        kind="mount",
        title=f"Spigot in a spindle clamp, for the sensor {sensor}",
        genus=len(pattern.at_mm) + 1,
        volume_mm3=volume - pattern.area_mm2() * PLATE_MM,
    )
    front = [
        Dimension("flange", (0.0, 0.0), (0.0, PLATE_MM), "left"),
        Dimension("height", (2.0 * radius, 0.0), (2.0 * radius, top), "right"),
        Dimension("tube", (radius - SPINDLE_MM / 2.0, top), (radius + SPINDLE_MM / 2.0, top), "top", 0.1),
        Dimension("opening", (radius - inner / 2.0, 0.0), (radius + inner / 2.0, 0.0), "bottom"),
    ]
    plan = [Dimension("flange's diameter", (0.0, radius), (2.0 * radius, radius), "bottom")]
    notes = [f"Holes for the sensor: {_listed(pattern)}.", "Print as drawn, flange down. No supports."]
    return part, _drawing(part, plan, front, notes, at=(radius, radius), levels=(PLATE_MM / 2.0, PLATE_MM + 0.01))


def ring() -> tuple[PrintPart, Drawing]:
    """Return a ring that holds a round camera or sensor with three set screws, on the screws of the first sensor."""
    pattern, _ = SENSORS["TacTip"]
    inner, wall, height = CAMERA_MM + 0.4, 6.0, 14.0
    radius, flange = pattern.reach_mm + EDGE_MM, PLATE_MM / 2.0
    body = Cylinder(radius, flange, align=LOW)
    body += Pos(0, 0, flange) * Cylinder(inner / 2.0 + wall, height, align=LOW)
    body -= Cylinder(inner / 2.0, flange + height, align=LOW)
    body -= pattern.bores(flange)
    across = Pos(0, 0, flange + height / 2.0) * Rot(0, 90, 0)
    body -= [Rot(0, 0, turn) * across * Cylinder(SET_SCREW_MM / 2.0, radius, align=LOW) for turn in (0, 120, 240)]
    part = PrintPart.of_solid(
        body.solid(),
        name="camera-ring",
        kind="mount",
        title=f"Ring for a camera or sensor of {CAMERA_MM:g} mm",
        genus=len(pattern.at_mm) + 4,
    )
    front = [
        Dimension("flange", (0.0, 0.0), (0.0, flange), "left"),
        Dimension("height", (2.0 * radius, 0.0), (2.0 * radius, flange + height), "right"),
        Dimension("opening", (radius - inner / 2.0, 0.0), (radius + inner / 2.0, 0.0), "bottom", 0.2),
    ]
    plan = [Dimension("flange's diameter", (0.0, radius), (2.0 * radius, radius), "bottom")]
    notes = [
        f"Holes: {_listed(pattern)}. Three holes of {SET_SCREW_MM:g} mm for set screws M3, which cut their own thread.",
        "Print as drawn, flange down. No supports.",
    ]
    return part, _drawing(part, plan, front, notes, at=(radius, radius), levels=(flange / 2.0, flange + 0.01))


def cell_plates() -> list[tuple[PrintPart, Drawing]]:
    """Return the two plates of a load cell: the base on the bed below one end, and the table on the other end.

    The table has the holes of the holder's screws. Its middle is above the middle of the bar, where such a bar is least
    sensitive to the place of the force. Between each plate and the bar is a pad, so that the bar can bend.
    """
    holder = Holder(block=BLOCK)
    length, width = CELL_MM
    holder_x, holder_y, _ = holder.size_mm
    size = (max(length, holder_x) + 2.0 * EDGE_MM, max(width + 4.0 * EDGE_MM, holder_y))
    pad = (CELL_HOLES_MM[1] + CELL_HOLES_MM[0], width)
    low = ((size[0] - holder_x) / 2.0, (size[1] - holder_y) / 2.0)
    # The table is printed upside down and turned over its short side, so the holder's screws are mirrored.
    screws = tuple((low[0] + x, size[1] - low[1] - y) for x, y in (bore.at_mm for bore in holder.screws))
    corners = [(x, y) for x in (EDGE_MM, size[0] - EDGE_MM) for y in (EDGE_MM, size[1] - EDGE_MM)]
    plates = []
    for name, screw, others, hole_mm in (
        ("cell-base", CELL_SCREWS[0], corners, SCREWS["M5"][0]),
        ("cell-table", CELL_SCREWS[1], screws, holder.screws[0].diameter_mm),
    ):
        hole, head, recess = SCREWS[screw]
        end = (size[0] - length) / 2.0
        body = Pos(size[0] / 2.0, size[1] / 2.0, 0) * Box(*size, PLATE_MM, align=LOW)
        body += Pos(end + pad[0] / 2.0, size[1] / 2.0, PLATE_MM) * Box(*pad, GAP_MM, align=LOW)
        places = [(end + at, size[1] / 2.0) for at in CELL_HOLES_MM]
        body -= [Pos(*at, 0) * Cylinder(hole / 2.0, PLATE_MM + GAP_MM, align=LOW) for at in places]
        body -= [Pos(*at, 0) * Cylinder(head / 2.0, recess, align=LOW) for at in places]
        body -= [Pos(*at, 0) * Cylinder(hole_mm / 2.0, PLATE_MM, align=LOW) for at in others]
        top = PLATE_MM + GAP_MM
        in_bar = pi / 4.0 * (hole**2 * (top - recess) + head**2 * recess)
        volume = size[0] * size[1] * PLATE_MM + pad[0] * pad[1] * GAP_MM - len(places) * in_bar
        part = PrintPart.of_solid(
            body.solid(),
            name=name,
            kind="mount",
            title=f"Plate between load cell and {'bed' if name == 'cell-base' else 'holder'}",
            genus=len(places) + len(others),
            volume_mm3=volume - len(others) * pi / 4.0 * hole_mm**2 * PLATE_MM,
        )
        plan = [
            Dimension("plate x", (0.0, 0.0), (size[0], 0.0), "bottom"),
            Dimension("plate y", (0.0, 0.0), (0.0, size[1]), "left"),
            Dimension("first hole of the bar", (0.0, size[1]), (places[0][0], size[1] / 2.0), "top"),
            Dimension("second hole of the bar", (0.0, size[1]), (places[1][0], size[1] / 2.0), "top"),
        ]
        front = [
            Dimension("plate", (0.0, 0.0), (0.0, PLATE_MM), "left"),
            Dimension("height", (size[0], 0.0), (end + pad[0], top), "right"),
        ]
        where = "bed" if name == "cell-base" else "holder, with nuts below the table"
        notes = [
            f"Holes for the bar: {len(places)} of {hole:g} mm with recesses of {head:g} x {recess:g} mm for {screw}.",
            f"Holes for the {where}: {len(others)} of {hole_mm:g} mm.",
            "Print as drawn, with the pad up. No supports.",
        ]
        levels = (PLATE_MM - 0.01, top - 0.01)
        plates.append((part, _drawing(part, plan, front, notes, at=places[0], levels=levels)))
    return plates


def _listed(pattern: Pattern) -> str:
    places = ", ".join(f"({x:.2f}, {y:.2f})" for x, y in pattern.at_mm)
    return f"{len(pattern.at_mm)} of {pattern.hole_mm:g} mm for {pattern.screw} at {places} mm"


def _drawing(
    part: PrintPart,
    plan: list[Dimension],
    front: list[Dimension],
    notes: list[str],
    at: tuple[float, float],
    levels: tuple[float, ...],
) -> Drawing:
    """Return a drawing: the plan, and the two sections through a point.

    Args:
        part: The part.
        plan: The dimensions of the plan.
        front: The dimensions of the section seen from the front.
        notes: Further remarks.
        at: The point.
        levels: The heights of the edges in the plan.
    """
    cuts = Cuts(part.mesh[0])
    z = part.size_mm[2]
    side = [Dimension("whole height", (-z, 0.0), (0.0, 0.0), "bottom")]
    return Drawing(
        report=report(part.title, {"name": part.name, "size": mm(*part.size_mm)}),
        facts=("size",),
        plan=DrawingView({"seen": [loop for level in levels for loop in cuts.level(level)]}, plan, cuts=(at[1], at[0])),
        front=DrawingView(cuts.front(at[1]), front),
        side=DrawingView(cuts.right(at[0]), side),
        notes=notes,
    )


parts = [*map(bracket, SENSORS), *map(spigot, SENSORS), ring(), *cell_plates()]

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "mounts")
    folder.mkdir(parents=True, exist_ok=True)
    for part, drawing in parts:
        for ending in ("step", "stl"):
            print(export(part, folder / f"{part.name}.{ending}"))
        save_drawing(drawing, folder / f"{part.name}.pdf")
