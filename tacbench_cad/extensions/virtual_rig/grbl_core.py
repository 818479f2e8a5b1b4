"""GRBL without its lines: real-time bytes, holds, alarms, resets and status reports."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

from tacbench_cad.extensions.virtual_rig.base import Firmware, Program, earliest
from tacbench_cad.extensions.virtual_rig.grbl_gcode import Modal
from tacbench_cad.extensions.virtual_rig.grbl_memory import GRBL, FirmwareDialect, Memory, triple
from tacbench_cad.extensions.virtual_rig.machine import Stroke, VirtualCarriage
from tacbench_cad.lab.study import Point, minus, plus

#: The number of lines in the planner, and the largest number of characters in a line.
PLANNER_LINES = 15
_LINE_SIGNS = 79
#: The time by which the step generator works ahead, in s. The reported speed is later than now, and Idle comes late.
_AHEAD_S = 0.05
_TAIL_S = 0.01
#: The time to parse a line, in s.
_LINE_S = 0.001


class GrblCore(Firmware):
    """GRBL without the interpretation of its lines.

    Args:
        carriage: The carriage. Its axes define the machine frame, with the origin at the homing switches' side
            (``[OPT:VZ``: compiled with HOMING_FORCE_SET_ORIGIN).
        settings: ``$`` settings that differ from :data:`tacbench_cad.extensions.virtual_rig.grbl_memory.SETTINGS`.
        boot_s: The time from a reset to the banner, in s; None for the dialect's own.
        dialect: GRBL itself, or a descendant.
        quiet_limits: Whether a closed end stop resets GRBL at once, so that only ``[MSG:Check Limits]`` after the
            banner reports it, without ``ALARM:1``.
    """

    baud = 115200

    def __init__(
        self,
        carriage: VirtualCarriage,
        *,
        settings: Mapping[int, float] | None = None,
        boot_s: float | None = None,
        dialect: FirmwareDialect = GRBL,
        quiet_limits: bool = False,
    ) -> None:
        self.quiet_limits = quiet_limits
        self.dialect = dialect
        self.rx_bytes = dialect.rx_bytes
        self.settings = Memory(carriage.axes, settings or {})
        self._fresh = bool(dialect.fresh_memory)
        super().__init__(carriage, boot_s=dialect.boot_s if boot_s is None else boot_s)

    def _alarm(self) -> None:
        """Close an end stop (touched, or by electrical noise): ALARM:1. It has no effect while GRBL boots."""
        if self._listening:
            self._limit_hit()

    def _limit_hit(self) -> None:
        if not self.quiet_limits:
            self._run(self._critical(1))
            return
        self.carriage.halt(self.now_s)
        self.state = "Alarm"
        self._run(self._restart(late_ok=False, pause_s=0.0))

    # Memory

    def _forget(self) -> None:
        self.state = "Alarm" if self.settings[22] else "Idle"
        self._forget_line()
        self._since_report = {"WCO": 0, "Ov": 1}

    def _forget_line(self) -> None:
        """Reset the state that every reset clears, soft or hard."""
        self.modal = Modal()
        self._shift: Point = (0.0, 0.0, 0.0)
        self._held: list[Stroke] = []
        self._deaf = False
        self._in_line = False
        self._critical_alarm = False
        self._status_s: float | None = None
        self._idle_s: float | None = None
        self._motors_off_s: float | None = None
        self._last_error = 0
        self._position = self.carriage.counted(self.now_s)
        self._homing = None
        self._rx.clear()

    # The receive interrupt

    def _arrived(self, byte: int) -> None:
        if byte == 0x18:
            self._soft_reset()
        elif byte == ord("?"):
            # In an alarm that waits for a reset, GRBL accepts status requests but never answers them.
            lost = self._critical_alarm and not self.dialect.status_in_alarm
            if self._status_s is None and not lost:
                self._status_s = self.now_s + self.dialect.status_s
        elif byte == ord("!"):
            self._feed_hold()
        elif byte == ord("~"):
            self._cycle_start()
        elif byte == 0x85:
            if self.state == "Jog":
                self._cancel_jog()
        elif byte < 0x80:
            super()._arrived(byte)

    def _soft_reset(self) -> None:
        if self._critical_alarm:
            if not self._deaf:
                self._run(self._restart(late_ok=self._in_line, pause_s=0.0))
        elif self._homing is not None:
            self._abort(6)
        elif self._deaf:
            return
        elif self.dialect.abort_alarm and (self.carriage.moving or self.state in ("Run", "Jog")):
            self._abort(3)
        else:
            self.carriage.halt(self.now_s)
            self._run(self._restart(late_ok=False, pause_s=0.0))

    def _abort(self, code: int) -> None:
        """Stop the motors, report the alarm, and restart. A waiting line still gets its ``ok``."""
        self.carriage.halt(self.now_s)
        self.state = "Alarm"
        self._send(f"ALARM:{code}\r\n")
        self._run(self._restart(late_ok=self._in_line, pause_s=self.dialect.alarm_pause_s))

    def _feed_hold(self) -> None:
        if self.state == "Jog":
            self._cancel_jog()
        elif self.state in ("Idle", "Run"):
            self.state = "Hold"
            self._hold_strokes()

    def _hold_strokes(self) -> None:
        self._held = self.carriage.slow_down(self.now_s)

    def _cycle_start(self) -> None:
        if self.state != "Hold" or self.carriage.moving:
            return
        held, self._held = self._held, []
        for stroke in held:
            self.carriage.go(stroke.end, stroke.peak_mm_s, stroke.acceleration_mm_s2, self.now_s)
        self.state = "Run" if self.carriage.moving else "Idle"

    def _cancel_jog(self) -> None:
        self.carriage.slow_down(self.now_s)
        self._position = self.carriage.planned
        if not self.carriage.moving:
            self._stopped()

    # Events

    def _timer_s(self) -> float | None:
        return earliest(None if self._deaf else self._status_s, self._idle_s, self._motors_off_s)

    def _timers(self) -> None:
        if self._idle_s is not None and self.now_s >= self._idle_s:
            self._idle_s = None
            if self.state in ("Run", "Jog") and not self.carriage.moving:
                self.state = "Idle"
                if self.settings[1] < 255:
                    self._motors_off_s = self.now_s + self.settings[1] / 1000.0
        if self._motors_off_s is not None and self.now_s >= self._motors_off_s:
            self._motors_off_s = None
            self.motors_off += 1
        if self._status_s is not None and self.now_s >= self._status_s and not self._deaf:
            self._report()

    def _stopped(self) -> None:
        if self.state in ("Run", "Jog"):
            self._idle_s = self.now_s + _TAIL_S

    def _end_stop(self, axis: int) -> None:
        if self._homing is not None:
            super()._end_stop(axis)
        elif self.settings[21]:
            self._limit_hit()

    # The programs

    def _main(self) -> Program:
        if self._fresh:
            self._fresh = False
            self._send(self.dialect.fresh_memory + "\r\n")
        yield from self._loop()

    def _restart(self, *, late_ok: bool, pause_s: float) -> Program:
        self._deaf = True
        yield pause_s
        if late_ok:
            self._send("ok\r\n")
        if self.state not in ("Alarm", "Home"):
            self.state = "Idle"
        self._forget_line()
        yield 0.002
        yield from self._loop()

    def _critical(self, code: int) -> Program:
        """Handle ALARM:1 or 2: everything stops until Ctrl-X."""
        self.carriage.halt(self.now_s)
        self.state = "Alarm"
        self._critical_alarm = self._deaf = True
        self._send(f"ALARM:{code}\r\n")
        yield self.dialect.alarm_pause_s
        self._send("[MSG:Reset to continue]\r\n")
        self._status_s = None
        self._deaf = False
        yield lambda: False

    def _loop(self) -> Program:
        self._send(f"\r\n{self.dialect.banner}\r\n")
        if self.settings[21] and self.carriage.pressed(self.now_s):
            self.state = "Alarm"
            self._send("[MSG:Check Limits]\r\n")
        if self.state == "Alarm":
            self._send("[MSG:'$H'|'$X' to unlock]\r\n")
        line, too_long, comment = "", False, ""
        while True:
            yield lambda: bool(self._rx)
            sign = chr(self._rx.pop(0))
            if sign in "\r\n":
                self._in_line = True
                yield _LINE_S
                yield from self._execute(line, too_long)
                self._in_line = False
                line, too_long, comment = "", False, ""
            elif comment:
                comment = "" if comment == "(" and sign == ")" else comment
            elif sign in "(;":
                comment = sign
            elif sign > " " and sign != "/":
                too_long = too_long or len(line) >= _LINE_SIGNS
                line += sign.upper() if not too_long else ""

    @abstractmethod
    def _execute(self, line: str, too_long: bool) -> Program:
        """Execute a line and answer it.

        Args:
            line: The line without blanks and comments, upper case.
            too_long: Whether it was longer than GRBL's buffer.
        """

    # Status

    def _report(self) -> None:
        self._status_s = None
        state = self.state
        if state == "Hold":
            state = "Hold:1" if self.carriage.moving else "Hold:0"
        offset = self.settings.offsets[self.modal.system_index]
        work = plus(offset, self._shift)
        machine = bool(int(self.settings[10]) & 1)
        fields = [state, f"MPos:{triple(self.reported)}" if machine else f"WPos:{triple(minus(self.reported, work))}"]
        if int(self.settings[10]) & 2 or self.dialect.buffer_field:
            room = PLANNER_LINES - self.carriage.queued - len(self._held)
            fields.append(f"Bf:{max(0, room)},{self.rx_bytes - len(self._rx)}")
        fields.append(f"FS:{self.carriage.speed_mm_s(self.now_s + _AHEAD_S) * 60.0:.0f},0")
        closed = "".join("XYZ"[i] for i in self.carriage.pressed(self.now_s))
        if closed:
            fields.append(f"Pn:{closed}")
        fields += self._now_and_then(work)
        self._send(f"<{'|'.join(fields)}{self.dialect.more_fields}>\r\n")

    def _now_and_then(self, work: Point) -> list[str]:
        """Return the fields of every tenth report (every thirtieth in motion): first offsets, then overrides."""
        fields: list[str] = []
        for name, text in (("WCO", f"WCO:{triple(work)}"), ("Ov", "Ov:100,100,100")):
            if self._since_report[name] > 0:
                self._since_report[name] -= 1
                continue
            if name == "Ov" and fields:
                self._since_report[name] = 1
                continue
            self._since_report[name] = 29 if self.state in ("Run", "Hold", "Jog", "Home") else 9
            fields.append(text)
        return fields
