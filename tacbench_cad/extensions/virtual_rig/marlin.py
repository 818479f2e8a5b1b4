"""Marlin 2.1 as a state machine, including the traits that cause errors in hosts.

Not included are arcs, heaters (``M105`` answers room temperature), bed levelling and inches. Motion stops at corners,
without look-ahead, and between lines that arrive after the motion has begun. Homing moves to the upper end of z first,
as in builds with ``Z_HOME_DIR 1``, since a sensor must not be homed into a block.
"""

from __future__ import annotations

from collections.abc import Sequence

from tacbench_cad.extensions.virtual_rig.base import Program
from tacbench_cad.extensions.virtual_rig.gcode import words
from tacbench_cad.extensions.virtual_rig.machine import along_path, replaced
from tacbench_cad.extensions.virtual_rig.marlin_core import VERSION, MarlinCore
from tacbench_cad.lab.study import Point, minus

#: The number of strokes in the planner.
_PLANNER_STROKES = 15
#: The highest speeds, accelerations and homing speeds by axis, in mm and s.
_PEAK: Point = (100.0, 100.0, 10.0)
_ACCELERATION: Point = (500.0, 500.0, 100.0)
_HOME: Point = (50.0, 50.0, 8.0)
_BUMP_MM = 5.0
#: The steps per mm of the missing extruder: Marlin's default.
_EXTRUDER_STEPS_PER_MM = 500.0
_EXTRUDER_MM_S = 25.0
#: Commands that are accepted without an effect.
_IGNORED = (
    *("G17", "G94", "M17", "M82", "M83", "M104", "M106", "M107"),
    *("M113", "M140", "M155", "M220", "M420"),
)


class Marlin(MarlinCore):
    """Marlin 2.1.2.7. The arguments are those of its base class."""

    def _do(self, line: str) -> Program:
        line_words = words(line.upper().replace(" ", ""), flags=True) or []
        letter, number = line_words[0] if line_words else ("", None)
        if letter not in ("G", "M") or number is None:
            self._unknown(line)
            return
        name, values = f"{letter}{number:g}", dict(line_words[1:])
        if name in ("G0", "G1"):
            yield from self._move(values)
        elif name == "G4":
            yield self._at_rest
            yield max(0.0, (values.get("P") or 0.0) / 1000.0 + (values.get("S") or 0.0))
        elif name == "G28":
            yield from self._home([i for i, letter in enumerate("XYZ") if letter in values] or [0, 1, 2])
        elif name in ("G90", "G91"):
            self._absolute = name == "G90"
        elif name == "G92":
            self._set_position(values)
        elif name == "M400":
            yield self._at_rest
        elif name == "M114":
            self._report()
        elif name == "M115":
            self._identify()
        elif name == "M92" and not values:
            self._axes_as("M92", [axis.steps_per_mm for axis in self.carriage.axes], _EXTRUDER_STEPS_PER_MM)
        elif name == "M203" and not values:
            self._axes_as("M203", _PEAK, _EXTRUDER_MM_S)
        elif name == "M119":
            self._end_stops()
        elif name == "M211":
            self._set_soft_stops(values)
        elif name == "M154":
            # A whole number of seconds from 0 to 255.
            self._auto_every_s = float(min(255, int(max(0.0, values.get("S") or 0.0))))
            self._auto_s = self.now_s + self._auto_every_s if self._auto_every_s > 0.0 else None
        elif name in ("M18", "M84"):
            yield from self._motors_off(values.get("S"))
        elif name == "M105":
            self._send(" T:20.00 /0.00 @:0\n")
        elif name not in (*_IGNORED, "M110", "M410", "M108"):
            self._unknown(line)

    def _unknown(self, line: str) -> None:
        self._send(f'echo:Unknown command: "{line}"\n')

    # Motion

    def _move(self, values: dict[str, float | None]) -> Program:
        feed = values.get("F")
        if feed is not None and feed > 0.0:
            self._feed_mm_s = feed / 60.0
        target = self._planned
        for i, letter in enumerate("XYZ"):
            value = values.get(letter)
            if value is None:
                continue
            value = value if self._absolute else target[i] + value
            if self._homed[i] and self._soft_stops:
                axis, shift = self.carriage.axes[i], self._shift[i]
                # Soft end stops limit a target without a message, and only on axes that are homed.
                value = min(axis.high_mm - shift, max(axis.low_mm - shift, value))
            target = replaced(target, i, value)
        yield lambda: self.carriage.queued + len(self._blocks) < _PLANNER_STROKES
        self._go(target, self._feed_mm_s)

    def _go(self, target: Point, speed_mm_s: float) -> None:
        start, self._planned = self._planned, target
        if start == target:
            return
        speed = min(speed_mm_s, along_path(start, target, _PEAK))
        acceleration = along_path(start, target, _ACCELERATION)
        self._plan(self._native(target), speed, acceleration)

    def _motors_off(self, after_s: float | None) -> Program:
        """Switch the motors off, or set the time without motion after which they are switched off."""
        if after_s is None:
            yield self._at_rest
            self._switch_off()
            return
        self._idle_s = max(0.0, after_s)
        if not self.carriage.moving:
            self._stopped()

    def _set_position(self, values: dict[str, float | None]) -> None:
        native = self._native(self._planned)
        for i, letter in enumerate("XYZ"):
            value = values.get(letter)
            if value is not None:
                self._planned = replaced(self._planned, i, value)
        self._shift = minus(native, self._planned)

    def _home(self, axes: list[int]) -> Program:
        yield self._at_rest
        for i in sorted(axes, key=(2, 0, 1).index):
            axis, speed = self.carriage.axes[i], _HOME[i]
            self._homing = i
            for reach, fraction in ((1.5 * axis.travel_mm, 1.0), (2.0 * _BUMP_MM, 0.25)):
                if i not in self.carriage.pressed(self.now_s):
                    self._shove(i, reach * axis.home, speed * fraction, _ACCELERATION[i])
                    yield self._at_rest
                    if i not in self.carriage.pressed(self.now_s):
                        self._send("echo:Homing Failed\n")
                        self._kill()
                        yield lambda: False
                if fraction == 1.0:
                    self._shove(i, -_BUMP_MM * axis.home, speed, _ACCELERATION[i])
                    yield self._at_rest
            self._count_axis_as(i, axis.stepped(axis.switch_at_mm))
            self._homed[i] = True
            self._shift = replaced(self._shift, i, 0.0)
        self._homing = None
        self._planned = self._logical(self.carriage.counted(self.now_s))
        self._report()

    # Reports

    def _identify(self) -> None:
        self._send(
            f"FIRMWARE_NAME:Marlin {VERSION} (Jan  1 2026 00:00:00) SOURCE_CODE_URL:github.com/MarlinFirmware/Marlin"
            " PROTOCOLVERSION:1.0 MACHINE_TYPE:SIMULATED EXTRUDER_COUNT:1"
            " UUID:cede2a2f-41a2-4748-9b12-c55c62f367ff\n"
            "Cap:SERIAL_XON_XOFF:0\nCap:BINARY_FILE_TRANSFER:0\nCap:EEPROM:0\nCap:AUTOREPORT_POS:1\n"
            f"Cap:EMERGENCY_PARSER:{int(self.emergency_parser)}\nCap:HOST_ACTION_COMMANDS:0\n"
        )

    def _axes_as(self, name: str, axes: Sequence[float], extruder: float) -> None:
        """Send a setting with a value for each axis, in the layout of Marlin 2.1 (2.0 adds ``echo:`` in front)."""
        x, y, z = axes
        self._send(f"  {name} X{x:.2f} Y{y:.2f} Z{z:.2f} E{extruder:.2f}\n")

    def _set_soft_stops(self, values: dict[str, float | None]) -> None:
        """Switch the soft end stops, and report them in the layout of Marlin 2.0, which 2.1 spreads over two lines."""
        if "S" in values:
            self._soft_stops = bool(values["S"])
        ends = [
            "".join(f" {letter}:{end:.2f}" for letter, end in zip("XYZ", limits, strict=True))
            for limits in zip(*((axis.low_mm, axis.high_mm) for axis in self.carriage.axes), strict=True)
        ]
        self._send(f"echo:Soft endstops: {'On' if self._soft_stops else 'Off'}  Min: {ends[0]}   Max: {ends[1]}\n")

    def _end_stops(self) -> None:
        pressed = self.carriage.pressed(self.now_s)
        self._send("Reporting endstop status\n")
        for i, axis in enumerate(self.carriage.axes):
            end = "max" if axis.home > 0 else "min"
            self._send(f"{'xyz'[i]}_{end}: {'TRIGGERED' if i in pressed else 'open'}\n")
