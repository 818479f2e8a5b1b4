"""A stage run by GRBL 1.1 or grblHAL.

Frame: the stage's millimetres are GRBL's machine coordinates (``G53``, ``MPos``), which homing sets from the end
stops. Work offsets (``G54`` to ``G59``, ``G92``) are neither used nor changed, so that a taught origin stays valid
after the power was off, once the stage is homed again. With the firmware's default settings all coordinates are 0 at
the homing corner and negative elsewhere.

Trust: a move is done when the firmware reports ``Idle`` at the target; an ``ok`` proves nothing. The firmware counts
motor steps: it cannot see a motor slip. A reset, an alarm or a long silence makes the position unknown, and every
move is refused until ``home()`` has succeeded. GRBL homes z first, upwards, so homing is also what lifts the sensor
then. Without ``home`` at opening, the count that the firmware has kept is believed, unless opening the port reset it.

``stop()`` sends ``!`` (feed hold), which keeps the position; the next call waits until the carriage stands and leaves
the hold with Ctrl-X. While homing it sends Ctrl-X, since ``!`` is not obeyed there.

One line is under way at a time, so the firmware's 128-byte buffer cannot overflow. Protocol:
https://github.com/gnea/grbl/wiki.
"""

from __future__ import annotations

import math
import time
from typing import Unpack

from tacbench_cad.lab.rig import grbl_replies as replies
from tacbench_cad.lab.rig.errors import AlarmError, NoAnswerError, NotThereError, PositionLostError, ProtocolError
from tacbench_cad.lab.rig.grbl_link import ANSWER_S, ASK, HOLD, RESET, GrblLink
from tacbench_cad.lab.rig.grbl_replies import Status
from tacbench_cad.lab.rig.serial_stage import SerialOptions, SerialStage, confirmed, duration_s, is_near, place_text
from tacbench_cad.lab.study.spec import Point

#: Speed of the line, in baud.
BAUD = 115200
#: Pause between two status reports while the carriage moves, in rig time.
POLL_S = 0.03
#: A carriage that stands elsewhere than it was sent for so long will not start any more.
STANDING_S = 0.3
#: How far from the straight line to its target a carriage may be reported.
ASIDE_MM = 0.05
#: How often a line that was refused as unreadable, and nothing done, is sent again at most.
RESENDS = 5
#: How often homing is begun again, where the order to home was not taken.
HOMINGS = 4
#: Number of the error by which GRBL says that homing is not enabled.
NO_HOMING = 5


class GrblStage(SerialStage[GrblLink]):
    """A three-axis stage behind GRBL. See :class:`tacbench_cad.lab.rig.stage.Stage` and the module's text.

    Args:
        port: Path, name or pyserial URL.
        tolerance_mm: How far from its target a move may end; None: half a motor step and the report's rounding.
        options: See :class:`~tacbench_cad.lab.rig.serial_stage.SerialOptions`.

    Attributes:
        settings: The firmware's numbered settings.

    Raises:
        InputError: The port cannot be opened.
        NoAnswerError: Nothing answers.
        ProtocolError: Something else than GRBL 1.1 answers, or its reports are in inches.
    """

    def __init__(self, port: str, *, tolerance_mm: float | None = None, **options: Unpack[SerialOptions]) -> None:
        super().__init__(port, GrblLink, (BAUD,), options)
        self._stopping = self._homing = False
        with self._opening():
            self._link.greet()
            self.identity = f"grbl: {self._link.firmware} at {port}"
            self.settings = replies.settings(self._link.ask("$$"))
            if self.settings.get(13, 0.0) != 0.0:
                raise ProtocolError(f"{self._link.name}: reports inches; send it $13=0")
            self._tolerance_mm = tuple(tolerance_mm or self._resolution(axis) for axis in range(3))
            self._look_around()

    def home(self) -> None:
        """Find the end stops, z first and upwards (GRBL's own order); afterwards the position is known.

        Works from every state: a reset comes first. An ``ok`` alone is not believed: ``Home`` must have been
        reported, or the carriage must stand at the ends of its travel. An order that was garbled is given again.

        Raises:
            AlarmError: An end stop was not found, or homing was stopped.
            ProtocolError: Homing is not enabled in the firmware (``$22=0``).
            RigError: Lost, silent or reset.
        """
        self._stopping, self._homing = False, True
        seen: bool | None = None
        try:
            for _ in range(HOMINGS):
                self._link.reset()
                self._link.lost = "homing was not finished"
                if not self._stopping:
                    seen = self._wait_for_homing()
                if self._stopping or seen is not None:
                    break
        finally:
            self._homing = False
        if self._stopping:
            raise AlarmError(f"{self._link.name}: homing was stopped on request")
        if seen is None:
            raise ProtocolError(f"{self._link.name}: does not understand the order to home; look at the cable")
        # The answer to the last question may be on its way; it must not be taken for that to the next one.
        for _ in range(20):
            if self._link.next(0.05) is None:
                break
        at = self._standing("Idle", failed="does not come to rest")
        if not seen and not self._at_ends(at):
            raise PositionLostError(f"{self._link.name}: said ok to homing, but has not homed; home first")
        self._line.torn = False
        self._link.lost = ""
        self._last = at

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Go there in a straight line; done when ``Idle`` at the target is reported.

        Every report on the way must lie on the straight line: a line garbled on its way to the firmware (which has
        no checksums) shows as a carriage going elsewhere, and is stopped.

        Raises:
            AlarmError: The firmware is locked, or was locked on the way.
            PositionLostError: It was reset, now or before; home first.
            OutOfRangeError: The firmware's own limits refuse the target.
            NotThereError: Stopped on request, held, stuck, or arrived elsewhere.
            NoAnswerError: Silent.
            DeviceLostError: Unplugged.
        """
        start = self.position()
        with self._moving():
            self._last = self._follow(start, target_mm, speed_mm_s)
        return self._last

    def position(self) -> Point:
        """The reported machine position in mm, once a stop (if any) has come to rest.

        Raises:
            PositionLostError: It is unknown: reset, alarm, or never homed.
            RigError: Lost or silent.
        """
        self._link.require_known()
        if self._stopping or self._line.torn:
            self._leave_hold()
        at = confirmed(self._reported, lambda at: self._last is None or self._there(at, self._last))
        if at is None:
            raise ProtocolError(f"{self._link.name}: reports another place each time it is asked")
        # What a reset leaves behind, should its banner have been lost on the way.
        if at == (0.0, 0.0, 0.0) and self._last is not None and math.dist(at, self._last) > ASIDE_MM:
            raise self._link.reset_noticed("reports 0, 0, 0 although it was left elsewhere")
        self._last = at
        return at

    def stop(self) -> None:
        """Stop all motion at once; from a signal handler too. Never raises."""
        self._stopping = True
        self._line.write_now(RESET if self._homing else HOLD)

    def _reported(self) -> Point:
        report = self._link.status()
        self._link.not_locked(report)
        return self._machine(report)

    def _machine(self, report: Status) -> Point:
        at = self._link.machine(report)
        assert at is not None, "status() waits for a position"
        return at

    def _resolution(self, axis: int) -> float:
        """Half a motor step and the rounding of reports, in mm."""
        steps_per_mm = self.settings.get(100 + axis, 0.0)
        return 0.5 / steps_per_mm + 0.0015 if steps_per_mm > 0.0 else 0.01

    @property
    def _rates_mm_s(self) -> tuple[float, ...]:
        return tuple(self.settings.get(110 + axis, 0.0) / 60.0 for axis in range(3))

    def _there(self, at: Point, target: Point) -> bool:
        return is_near(at, target, self._tolerance_mm)

    def _follow(self, start: Point, target: Point, speed_mm_s: float) -> Point:
        """Send a move and watch it to its end."""
        name, line = self._link.name, self._line
        x, y, z = target
        command = f"G21G90G94G53G1X{x:.4f}Y{y:.4f}Z{z:.4f}F{max(60.0 * speed_mm_s, 0.1):.3f}"
        line.write(command.encode("ascii") + b"\n")
        begun = heard = progress = time.monotonic()
        give_up = begun + self._timeout_s + 2.0 * duration_s(start, target, speed_mm_s, self._rates_mm_s)
        closest, aside, accepted, refusals = math.dist(start, target), 0, False, 0
        standing: tuple[Point, float] | None = None
        ask_at = begun
        while True:
            now = time.monotonic()
            if now >= ask_at:
                line.write(ASK)
                ask_at = now + ANSWER_S
            got = self._link.next(max(ask_at - now, 0.0))
            now = time.monotonic()
            if self._stopping:
                raise NotThereError(f"{name}: was stopped on request on its way to {place_text(target)}")
            if now - heard > self._timeout_s:
                raise self._link.silence()
            if isinstance(got, str):
                if replies.is_unreadable(got) and refusals < RESENDS:
                    # A disturbance may last: a longer pause each time.
                    time.sleep(0.01 * 2.0**refusals)
                    line.write(command.encode("ascii") + b"\n")
                    accepted, refusals = False, refusals + 1
                    continue
                self._link.refused(got, command)
                accepted = accepted or got == "ok"
            if not isinstance(got, Status) or (at := self._link.machine(got)) is None:
                continue
            heard, ask_at = now, now + POLL_S / self._clock.speed
            self._link.not_locked(got)
            if got.state == "Hold":
                self._stopping = True
                raise NotThereError(f"{name}: was put on hold at {place_text(at)} (its button?)")
            # A single report may be damaged; two in a row are believed.
            aside = aside + 1 if _is_aside(at, start, target) else 0
            if aside >= 2:
                self.stop()
                raise NotThereError(f"{name}: went to {place_text(at)} on its way to {place_text(target)}; stopped")
            if got.state != "Idle":
                standing = None
                if math.dist(at, target) < closest - min(self._tolerance_mm):
                    closest, progress = math.dist(at, target), now
                if now - progress > self._timeout_s or now > give_up:
                    self.stop()
                    raise NotThereError(
                        f"{name}: stays at {place_text(at)} on its way to {place_text(target)}; stopped"
                    )
                continue
            standing = standing if standing and standing[0] == at else (at, now)
            stood_s = now - standing[1]
            if self._there(at, target) and (accepted or stood_s >= STANDING_S):
                return at
            if stood_s >= (STANDING_S if accepted else self._timeout_s):
                why = "ended" if accepted else "did not take the move and stands"
                raise NotThereError(f"{name}: {why} at {place_text(at)} instead of {place_text(target)}")

    def _wait_for_homing(self) -> bool | None:
        """Send ``$H`` and wait for its end; whether ``Home`` was reported, or None if the order was not taken.

        An ``ok`` may be that of a piece of a garbled line: without ``Home`` two reports must follow it.
        """
        seen, acknowledged, standing = False, False, 0
        self._line.write(b"$H\n")
        self._clock.sleep(0.05)
        until = time.monotonic() + self._home_timeout_s
        ask_at = time.monotonic()
        while (now := time.monotonic()) < until:
            # The answers come late, but one of them tells that it was homing indeed.
            if now >= ask_at:
                self._line.write(ASK)
                ask_at = now + (POLL_S if acknowledged else 0.5)
            got = self._link.next(max(ask_at - now, 0.0))
            if got == "ok":
                if seen:
                    return True
                acknowledged, standing, ask_at = True, 0, now
            elif isinstance(got, Status):
                seen = seen or got.state == "Home"
                # It answers at once only if it is not homing; the first answer may be from before the order.
                standing += got.state in ("Idle", "Alarm")
                if standing >= 2:
                    return seen if got.state == "Idle" and (seen or acknowledged) else None
            elif got is not None:
                if replies.error(got) not in (None, NO_HOMING):
                    return None
                self._link.refused(got, "$H")
        raise NoAnswerError(f"{self._link.name}: homing did not end within {self._home_timeout_s:g} s")

    def _leave_hold(self) -> None:
        """After :meth:`stop`: wait until the carriage stands, then leave the hold without losing the position."""
        before = self._standing("Idle", "Hold", failed="does not stop")
        self._stopping = False
        self._link.reset()
        if math.dist(self._reported(), before) > ASIDE_MM:
            raise self._link.reset_noticed("lost its position when a hold was left")
        self._line.torn = False

    def _standing(self, *states: str, failed: str) -> Point:
        """Position once the carriage stands in one of some states; a hold that is waited for is asked for again."""
        until = time.monotonic() + self._timeout_s
        again = time.monotonic() + ANSWER_S
        while True:
            report = self._link.status()
            self._link.not_locked(report)
            if report.state in states and (report.state != "Hold" or report.detail == 0):
                return self._machine(report)
            now = time.monotonic()
            if now >= until:
                raise NotThereError(f"{self._link.name}: {failed}; state {report.state}")
            if "Hold" in states and now >= again:
                self._line.write_now(HOLD)
                again = now + ANSWER_S
            self._clock.sleep(POLL_S)

    def _at_ends(self, at: Point) -> bool:
        """Whether every coordinate lies a homing's pull-off from an end of the travel."""
        near = 2.0 * self.settings.get(27, 1.0) + 0.1
        ends = [(0.0, self.settings.get(130 + axis, 0.0)) for axis in range(3)]
        return all(min(abs(abs(a) - end) for end in pair) <= near for a, pair in zip(at, ends, strict=True))

    def _look_around(self) -> None:
        """What state the stage was found in."""
        report = self._link.status()
        if report.state == "Alarm":
            self._link.lost = self._link.lost or "it is locked and was not homed"
        elif report.state in ("Run", "Jog", "Hold", "Home"):
            # Left moving by a program that was killed.
            self.stop()


def _is_aside(at: Point, start: Point, target: Point) -> bool:
    """Whether a place lies off the straight line from start to target."""
    way = [b - a for a, b in zip(start, target, strict=True)]
    off = [b - a for a, b in zip(start, at, strict=True)]
    length2 = sum(a * a for a in way)
    fraction = sum(a * b for a, b in zip(way, off, strict=True)) / length2 if length2 > 0.0 else 0.0
    fraction = min(max(fraction, 0.0), 1.0)
    return math.dist(off, [fraction * a for a in way]) > ASIDE_MM
