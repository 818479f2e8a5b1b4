"""Reading of G-code as beads: straight pieces of plastic with a cross-section, a height and a role.

The cross-section of a bead follows from the amount of filament: ``area = E pi/4 d^2 / length``, or ``E / length`` if E
is a volume (``M200``). The reader follows absolute and relative positions and extrusion (G90, G91, M82, M83), G92 and
arcs (G2, G3). Only M82 and M83 set the mode of E, because firmwares differ in what G90 and G91 do to E, and slicers
write both. The reader ignores M221, which calibrates the flow of a particular extruder.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

import numpy as np

from tacbench_cad.extensions.slicing.dialects import Role, SlicerDialect, dialect_of
from tacbench_cad.util.errors import InputError, require_between
from tacbench_cad.util.types import Bools, Floats
from tacbench_cad.util.untrusted import read_bytes, require_within

#: The largest distance between an arc and its chords, in mm.
CHORD_MM = 0.005
#: The diameter of the filament if neither the file nor the user states it, in mm.
USUAL_FILAMENT_MM = 1.75
#: The largest number of characters in a line, and of beads (including the chords of arcs) in a file.
MAX_LINE, MAX_BEADS = 1_000_000, 10_000_000
#: The largest coordinate or radius, in mm, and the largest amount of filament in one move, in mm or mm^3.
MAX_MM, MAX_FILAMENT = 1e4, 1e6
#: The smallest and the largest height of a layer or a bead, in mm.
MIN_LAYER_MM, MAX_LAYER_MM = 0.009, 5.0

_WORD = re.compile(r"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_FILAMENT = re.compile(r"^;\s*filament_diameter\s*[=:]\s*([\d.]+)")
_HEIGHT = re.compile(r"^;\s*(?:LAYER_)?HEIGHT\s*:\s*([\d.]+)\s*$")
_COMMENT_OF_FEATURE = re.compile(r"^;(TYPE:| FEATURE: )(.+)$")


@dataclass(frozen=True, eq=False)
class Beads:
    """The beads of a part in the order of the file, in the printer's coordinates.

    Args:
        start_mm: The start points, shape (n, 2).
        end_mm: The end points, shape (n, 2).
        top_mm: The z coordinates of the tops, which are those of the nozzle; shape (n,).
        height_mm: The heights, shape (n,).
        area_mm2: The cross-sections, shape (n,).
        wall: Whether a bead is part of an outer wall, shape (n,).
    """

    start_mm: Floats
    end_mm: Floats
    top_mm: Floats
    height_mm: Floats
    area_mm2: Floats
    wall: Bools

    def __len__(self) -> int:
        return len(self.top_mm)

    @property
    def width_mm(self) -> Floats:
        """The width of each bead, shape (n,), in mm.

        The cross-section is a rectangle with round ends: ``area = (width - height) height + pi/4 height^2``. If a bead
        is too thin for this shape, its cross-section is a circle.
        """
        round_mm2 = math.pi / 4.0 * self.height_mm**2
        flat = (self.area_mm2 - round_mm2) / self.height_mm
        return np.where(flat >= 0.0, flat + self.height_mm, np.sqrt(4.0 / math.pi * self.area_mm2))


@dataclass(frozen=True, eq=False)
class Sliced:
    """The content of a G-code file.

    Args:
        path: The file.
        dialect: The name of the dialect.
        beads: The beads of the part.
        layer_tops_mm: The z coordinates of the tops of the part's layers, ascending; shape (m,).
        floor_mm: The z coordinate of the part's underside, which is above 0 on a raft.
        filament_mm: The diameter of the filament.
        filament_assumed: Whether the diameter is assumed, because neither the file nor the user states it.
        left_out: The features that do not belong to the part, with the number of their moves.
        unknown: The features that are unknown for this dialect. They count as features of the part.
    """

    path: Path
    dialect: str
    beads: Beads
    layer_tops_mm: Floats
    floor_mm: float
    filament_mm: float
    filament_assumed: bool
    left_out: dict[str, int]
    unknown: tuple[str, ...]

    @property
    def layer_mm(self) -> float:
        """The median of the layer heights, in mm."""
        steps = np.diff(self.layer_tops_mm)
        return float(np.median(steps)) if len(steps) else float(self.layer_tops_mm[0] - self.floor_mm)


def read_gcode(path: Path, filament_mm: float | None = None) -> Sliced:
    """Read the beads of a sliced part.

    Args:
        path: A file by PrusaSlicer, Cura, Bambu Studio or OrcaSlicer.
        filament_mm: The diameter of the filament; None for the diameter that the file states, or 1.75 mm.

    Raises:
        InputError: The file cannot be read, is empty or binary, is in an unknown dialect, contains an invalid number,
            or extrudes nothing.
    """
    if filament_mm is not None:
        require_between("filament", filament_mm, 0.5, 5.0, " mm")
    lines = _lines(path)
    dialect = dialect_of({feature[1] + feature[2] for line in lines if (feature := _COMMENT_OF_FEATURE.match(line))})
    if dialect is None:
        raise InputError(
            "file",
            str(path),
            "is in an unknown dialect: it has no comments with the features of PrusaSlicer, Cura, Bambu Studio or "
            "OrcaSlicer; slice the block with one of them",
        )
    machine = _Machine(path=path, dialect=dialect)
    for machine.number, line in enumerate(lines, start=1):
        if line.startswith(";"):
            machine.comment(line)
        else:
            machine.command(line.partition(";")[0])
    stated = machine.stated_filament
    diameter_mm = filament_mm or stated or USUAL_FILAMENT_MM
    return machine.result(diameter_mm, assumed=filament_mm is None and stated is None and not machine.volumetric)


def _lines(path: Path) -> list[str]:
    content = read_bytes(path, kind="gcode")
    if not content.strip():
        raise InputError("file", str(path), "is empty; give a G-code file")
    if content.startswith(b"PK\x03\x04"):
        raise InputError("file", str(path), "is a ZIP archive; extract the plain .gcode file from it")
    if content.startswith(b"GCDE") or b"\x00" in content:
        raise InputError("file", str(path), "is binary; turn off binary G-code in the slicer")
    lines = [line.rstrip() for line in content.decode("utf-8", errors="replace").splitlines()]
    longest = max(range(len(lines)), key=lambda i: len(lines[i]))
    if len(lines[longest]) > MAX_LINE:
        allowed = f"has {len(lines[longest]):,} characters; a line may have at most {MAX_LINE:,}"
        raise InputError(f"{path}: line {longest + 1}", None, allowed)
    return lines


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:  # two decimal points
        return 0.0


@dataclass
class _Machine:
    """The state of a printer that executes G-code, and the beads so far."""

    path: Path
    dialect: SlicerDialect
    #: The number of the present line.
    number: int = 0
    place: dict[str, float] = field(default_factory=lambda: dict.fromkeys("XYZE", 0.0))
    #: The difference between the printer's own coordinates and those that G92 has set.
    offset: dict[str, float] = field(default_factory=lambda: dict.fromkeys("XYZ", 0.0))
    absolute: bool = True
    absolute_e: bool = True
    volumetric: bool = False
    extruded: bool = False
    role: Role = "other"
    feature: str = "before the first feature"
    stated_height: float = 0.0
    stated_filament: float | None = None
    #: Nine numbers for each bead; see :meth:`_move`.
    rows: array[float] = field(default_factory=lambda: array("d"))
    chords: int = 0
    left_out: dict[str, int] = field(default_factory=dict)
    unknown: dict[str, None] = field(default_factory=dict)

    @property
    def where(self) -> str:
        """The file and the present line, for messages."""
        return f"{self.path}: line {self.number}"

    def comment(self, line: str) -> None:
        """Read a comment that may state a feature, a layer height or the diameter of the filament."""
        feature = _COMMENT_OF_FEATURE.match(line)
        if feature is not None and feature[1] == self.dialect.feature:
            self.feature = feature[2]
            role = self.dialect.roles.get(self.feature.lower())
            if role is None:
                self.unknown[self.feature] = None
            self.role = role or "part"
            return
        if height := _HEIGHT.match(line):
            self.stated_height = _number(height[1])
            if not (self.stated_height == 0.0 or MIN_LAYER_MM <= self.stated_height <= MAX_LAYER_MM):
                allowed = f"a layer height must be from {MIN_LAYER_MM:g} to {MAX_LAYER_MM:g} mm"
                raise InputError(self.where, line, allowed)
        elif diameter := _FILAMENT.match(line):
            self.stated_filament = _number(diameter[1])
            if not 0.5 <= self.stated_filament <= 5.0:
                raise InputError(self.where, diameter[1], "the diameter of a filament must be from 0.5 to 5 mm")

    def command(self, text: str) -> None:
        """Execute a line without its comment."""
        text = text.partition("*")[0].strip()
        if not text:
            return
        words = [(letter.upper(), float(value)) for letter, value in _WORD.findall(text)]
        if words and words[0][0] == "N":
            words = words[1:]
        if not words or words[0][0] not in "GM":
            return
        code = f"{words[0][0]}{words[0][1]:g}"
        if code in ("G0", "G1", "G2", "G3", "G92") and (rest := _WORD.sub("", text).strip()):
            raise InputError(self.where, text, f"{rest!r} is not a letter followed by a number")
        values = dict(words[1:])
        for letter, value in values.items():
            if not abs(value) <= (MAX_FILAMENT if letter == "E" else MAX_MM) and letter in "XYZEIJR":
                self._refuse_far(letter, value)
        if code in ("G0", "G1"):
            self._move([self._target(values)], values)
        elif code in ("G2", "G3"):
            self._move(list(self._arc(values, clockwise=code == "G2")), values)
        elif code == "G92":
            self._set(values)
        elif code in ("G90", "G91"):
            self.absolute = code == "G90"
        elif code in ("M82", "M83"):
            self.absolute_e = code == "M82"
        elif code == "M200":
            self.volumetric = values.get("D", 0.0) > 0.0 and values.get("S", 1.0) != 0.0
        elif code in ("G20", "G18", "G19"):
            what = "inches (G20)" if code == "G20" else f"arcs in another plane than XY ({code})"
            raise InputError(self.where, text, f"{what} are not supported; use G21 and G17, as slicers do")

    def _refuse_far(self, letter: str, value: float) -> NoReturn:
        limit = f"{MAX_FILAMENT:,.0f}" if letter == "E" else f"{MAX_MM:,.0f} mm"
        raise InputError(self.where, f"{letter}{value:.6g}", f"must be from -{limit} to {limit}")

    def _target(self, values: dict[str, float]) -> tuple[float, float, float]:
        x, y, z = (
            values.get(axis, self.place[axis] if self.absolute else 0.0) + (0.0 if self.absolute else self.place[axis])
            for axis in "XYZ"
        )
        for axis, value in zip("XYZ", (x, y, z), strict=True):
            if not abs(value) <= MAX_MM:
                self._refuse_far(axis, value)
        return x, y, z

    def _set(self, values: dict[str, float]) -> None:
        for axis in values.keys() & set("XYZ"):
            self.offset[axis] += self.place[axis] - values[axis]
            self.place[axis] = values[axis]
        if "E" in values:
            self.place["E"] = values["E"]

    def _arc(self, values: dict[str, float], *, clockwise: bool) -> Iterator[tuple[float, float, float]]:
        """Yield points along an arc, with its end but without its start."""
        x0, y0, z0 = (self.place[axis] for axis in "XYZ")
        x1, y1, z1 = self._target(values)
        if "R" in values:
            radius, chord = values["R"], math.hypot(x1 - x0, y1 - y0)
            if chord == 0.0 or chord > 2.0 * abs(radius) + 1e-3:
                raise InputError(self.where, radius, "an arc with this radius R cannot connect the two points")
            away = math.sqrt(max(0.0, radius * radius - chord * chord / 4.0))
            side = away if clockwise == (radius < 0.0) else -away
            centre = ((x0 + x1) / 2.0 - side * (y1 - y0) / chord, (y0 + y1) / 2.0 + side * (x1 - x0) / chord)
        elif "I" in values or "J" in values:
            centre = (x0 + values.get("I", 0.0), y0 + values.get("J", 0.0))
        else:
            raise InputError(self.where, None, "an arc needs I and J, or R")
        radius = math.hypot(x0 - centre[0], y0 - centre[1])
        begin = math.atan2(y0 - centre[1], x0 - centre[0])
        turn = math.atan2(y1 - centre[1], x1 - centre[0]) - begin
        turn = turn % (2.0 * math.pi) or 2.0 * math.pi  # a full circle if the end is the start
        if clockwise:
            turn = turn - 2.0 * math.pi or -2.0 * math.pi
        step = 2.0 * math.acos(max(0.0, 1.0 - CHORD_MM / radius)) if radius > CHORD_MM else math.pi
        count = max(1, math.ceil(abs(turn) / step))
        self.chords += count
        self._require_few()
        for i in range(1, count):
            angle = begin + turn * i / count
            fraction = i / count
            yield centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle), z0 + fraction * (z1 - z0)
        yield x1, y1, z1

    def _require_few(self) -> None:
        require_within("file", self.chords + len(self.rows) // 9, MAX_BEADS, "beads", self.where)

    def _move(self, points: list[tuple[float, float, float]], values: dict[str, float]) -> None:
        filament = 0.0
        if "E" in values:
            filament = values["E"] - self.place["E"] if self.absolute_e else values["E"]
            self.place["E"] += filament
        begin = (self.place["X"], self.place["Y"], self.place["Z"])
        self.place["X"], self.place["Y"], self.place["Z"] = points[-1]
        if filament <= 0.0:
            return
        path = [begin, *points]
        lengths = [math.dist(a[:2], b[:2]) for a, b in pairwise(path)]
        total = sum(lengths)
        if total < 1e-6:
            return  # the printer pushes the filament forward after a retraction
        self.extruded = True
        if self.role == "other":
            self.left_out[self.feature] = self.left_out.get(self.feature, 0) + 1
            return
        dx, dy, dz = (self.offset[axis] for axis in "XYZ")
        per_mm, wall = filament / total, float(self.role == "wall")
        volume = float(self.volumetric)
        for (a, b), length in zip(pairwise(path), lengths, strict=True):
            if length > 1e-6:
                if abs(a[2] - b[2]) > 1e-3:
                    raise InputError(
                        "file",
                        str(self.path),
                        "has no layers, because z changes during extrusion; turn off spiral vase in the slicer",
                    )
                row = (a[0] + dx, a[1] + dy, b[0] + dx, b[1] + dy, b[2] + dz, self.stated_height, per_mm, wall, volume)
                self.rows.extend(row)
        self._require_few()

    def result(self, filament_mm: float, *, assumed: bool) -> Sliced:
        """Return the content of the file. All lines must have been read."""
        if not self.rows:
            names = ", ".join(self.left_out)
            what = f"extrudes only features outside the part ({names})" if self.extruded else "extrudes nothing"
            raise InputError("file", str(self.path), f"{what}; give the G-code of a sliced block")
        table = np.array(self.rows).reshape(-1, 9)
        tops = np.unique(np.round(table[:, 4], 3))
        if tops[0] <= 0.0:
            raise InputError("file", str(self.path), f"prints at z = {tops[0]:g} mm; z must be above 0")
        steps = np.diff(tops, prepend=0.0)
        usual = float(np.median(steps[1:])) if len(steps) > 1 else float(steps[0])
        if not MIN_LAYER_MM <= usual <= MAX_LAYER_MM:
            allowed = f"layers must be from {MIN_LAYER_MM:g} to {MAX_LAYER_MM:g} mm high"
            raise InputError("file", str(self.path), f"prints layers of {usual:.3g} mm; {allowed}")
        stated = table[:, 5] > 0.0
        lowest = np.round(table[:, 4], 3) == tops[0]
        if (lowest & stated).any():
            steps[0] = float(np.median(table[lowest & stated, 5]))
            floor = float(tops[0] - steps[0])
        elif steps[0] > 2.5 * usual:
            # The part is on a raft. Cura prints its first layer too low, so the floor follows from the upper layers.
            steps[steps < 0.5 * usual] = steps[0] = usual
            order = np.unique(np.round(table[:, 4], 3), return_index=True)[1].argsort()
            floor = float(np.median(tops[order] - usual * np.arange(1, len(tops) + 1)))
        else:
            floor = 0.0
        layer = steps[np.searchsorted(tops, np.round(table[:, 4], 3))]
        per_unit = np.where(table[:, 8] > 0.0, 1.0, math.pi / 4.0 * filament_mm**2)
        beads = Beads(
            start_mm=table[:, 0:2],
            end_mm=table[:, 2:4],
            top_mm=table[:, 4],
            height_mm=np.where(stated, table[:, 5], layer),
            area_mm2=table[:, 6] * per_unit,
            wall=table[:, 7] > 0.0,
        )
        return Sliced(
            path=self.path,
            dialect=self.dialect.name,
            beads=beads,
            layer_tops_mm=tops,
            floor_mm=max(0.0, floor),
            filament_mm=filament_mm,
            filament_assumed=assumed,
            left_out=self.left_out,
            unknown=tuple(self.unknown),
        )
