"""GRBL 1.1h as a state machine, including the traits that cause errors in hosts.

Not included are arcs, probing, check and sleep modes, and overrides of feed and spindle (their bytes are accepted and
ignored). Motion stops between lines, without look-ahead over corners.
"""

from __future__ import annotations

from tacbench_cad.extensions.virtual_rig.base import Program
from tacbench_cad.extensions.virtual_rig.grbl_core import PLANNER_LINES, GrblCore
from tacbench_cad.extensions.virtual_rig.grbl_gcode import GcodeBlock, GcodeError, parse
from tacbench_cad.extensions.virtual_rig.machine import Stroke, along_path, replaced
from tacbench_cad.lab.study import Point


class Grbl(GrblCore):
    """GRBL 1.1h. The arguments are those of its base class."""

    def _execute(self, line: str, too_long: bool) -> Program:
        before, self._last_error = self._last_error, 0
        try:
            if too_long:
                raise GcodeError(11)
            if line.startswith("$"):
                yield from self._system(line)
            elif line:
                if self.state in ("Alarm", "Jog"):
                    raise GcodeError(9)
                if before and self.dialect.refuses_after_error:
                    raise GcodeError(before)
                yield from self._gcode(parse(line, self.modal))
        except GcodeError as error:
            self._last_error = error.code
            self._send(f"error:{error.code}\r\n")
        else:
            self._send("ok\r\n")

    def _system(self, line: str) -> Program:
        if line.startswith("$J"):
            if self.state not in ("Idle", "Jog"):
                raise GcodeError(8)
            if not line.startswith("$J="):
                raise GcodeError(3)
            yield from self._jog(parse(line[3:], self.modal, jog=True))
        elif line == "$":
            self._send("[HLP:$$ $# $G $I $N $x=val $Nx=line $J=line $SLP $C $X $H ~ ! ? ctrl-x]\r\n")
        elif line == "$G":
            self._send(self.modal.report() + "\r\n")
        elif self.state not in ("Idle", "Alarm"):
            raise GcodeError(8)
        elif line == "$$":
            self._send(self.settings.listed())
        elif line == "$#":
            self._send(self.settings.parameters(self._shift))
        elif line == "$I":
            self._send(f"[VER:{self.dialect.version}:{self.settings.text}]\r\n{self.dialect.options}\r\n")
        elif line.startswith("$I="):
            self.settings.text = line[3:]
        elif line == "$X":
            if self.state == "Alarm":
                self._send("[MSG:Caution: Unlocked]\r\n")
                self.state = "Idle"
        elif line == "$H":
            if not self.settings[22]:
                raise GcodeError(5)
            yield from self._home()
        else:
            self.settings.store(line)

    # Lines of G-code

    def _gcode(self, block: GcodeBlock) -> Program:
        if block.action == "move":
            target = self._target(block)
            if self.settings[20] and not self._within(target):
                yield from self._soft_limit()
                return
            self.modal = block.modal
            yield from self._move(target, None if block.rapid else block.modal.feed_mm_min, "Run")
            return
        self.modal = block.modal
        if block.action in ("dwell", "offset", "pause", "end"):
            yield self._all_done
        if block.action == "dwell":
            yield block.values["P"]
        elif block.action == "offset":
            self._offset(block)
        elif block.action == "clear":
            self._shift = (0.0, 0.0, 0.0)
        elif block.action == "pause":
            self._feed_hold()
        elif block.action == "end":
            self._send("[MSG:Pgm End]\r\n")

    def _jog(self, block: GcodeBlock) -> Program:
        target = self._target(block)
        if self.settings[20] and not self._within(target):
            raise GcodeError(15)
        yield from self._move(target, block.modal.feed_mm_min, "Jog")

    def _move(self, target: Point, feed_mm_min: float | None, state: str) -> Program:
        yield lambda: self.carriage.queued + len(self._held) < PLANNER_LINES
        start, self._position = self._position, target
        if start == target:
            return
        speed = along_path(start, target, [self.settings[110 + i] / 60.0 for i in range(3)])
        if feed_mm_min is not None:
            speed = min(speed, feed_mm_min / 60.0)
        acceleration = along_path(start, target, [self.settings[120 + i] for i in range(3)])
        if self.state == "Hold":
            last = self._held[-1].end if self._held else self.carriage.planned
            self._held.append(
                Stroke(start=last, end=target, peak_mm_s=speed, acceleration_mm_s2=acceleration, begin_s=self.now_s)
            )
        elif self.carriage.go(target, speed, acceleration, self.now_s):
            self.state = state
            self._idle_s = self._motors_off_s = None

    def _soft_limit(self) -> Program:
        """Handle a line beyond the limits: come to rest, then raise ALARM:2."""
        if self.state == "Run":
            self.state = "Hold"
            self._hold_strokes()
        yield self._at_rest
        yield from self._critical(2)

    def _target(self, block: GcodeBlock) -> Point:
        offset = self.settings.offsets[block.modal.system_index]
        target = self._position
        for i, value in block.axes.items():
            if block.modal.distance == "G91" and not block.machine:
                target = replaced(target, i, target[i] + value)
            else:
                target = replaced(target, i, value + (0.0 if block.machine else offset[i] + self._shift[i]))
        return target

    def _within(self, target: Point) -> bool:
        # The comparison uses steps, since a target exactly at the limit is inside.
        return all(
            axis.stepped(axis.low_mm) <= axis.stepped(value) <= axis.stepped(axis.high_mm)
            for axis, value in zip(self.carriage.axes, target, strict=True)
        )

    def _offset(self, block: GcodeBlock) -> None:
        index = int(block.values.get("P", 0.0)) - 1
        index = block.modal.system_index if index < 0 else index
        base = self._shift if "G92" in block.values else self.settings.offsets[index]
        other = self.settings.offsets[index] if "G92" in block.values else self._shift
        point = base
        for i, value in block.axes.items():
            point = replaced(point, i, value if block.values.get("L") == 2.0 else self._position[i] - other[i] - value)
        if "G92" in block.values:
            self._shift = point
        else:
            self.settings.offsets[index] = point

    def _all_done(self) -> bool:
        return self._at_rest() and not self._held and self.state != "Hold"

    # Homing

    def _home(self) -> Program:
        self.state, self._deaf = "Home", True
        for i in (2, 0, 1):
            axis = self.carriage.axes[i]
            self._homing = i
            pull_off, acceleration = self.settings[27], self.settings[120 + i]
            seek, slow = (min(self.settings[number], self.settings[110 + i]) / 60.0 for number in (25, 24))
            for reach, speed in ((1.5 * axis.travel_mm, seek), (5.0 * pull_off, slow)):
                if i not in self.carriage.pressed(self.now_s):
                    self._shove(i, reach * axis.home, speed, acceleration)
                    yield self._at_rest
                    if i not in self.carriage.pressed(self.now_s):
                        self._abort(9)
                        yield lambda: False
                yield self.settings[26] / 1000.0
                self._shove(i, -pull_off * axis.home, speed, acceleration)
                yield self._at_rest
                if i in self.carriage.pressed(self.now_s):
                    self._abort(8)
                    yield lambda: False
            self._count_axis_as(i, axis.stepped(axis.switch_at_mm - pull_off * axis.home))
        self._homing = None
        self._position = self.carriage.counted(self.now_s)
        if self._status_s is not None:
            self._report()
        self._deaf = False
        self.state = "Idle"
