"""A stage controlled by GRBL 1.1 or grblHAL.

Frame: the stage's coordinates are GRBL's machine coordinates (``G53``, ``MPos``), which homing derives from the end
stops. Work offsets (``G54`` to ``G59``, ``G92``) are neither used nor changed, so a taught origin stays valid after the
power was off, once the stage has been homed again. With the firmware's default settings all coordinates are 0 at the
homing corner and negative elsewhere.

Proof of a move: a move is finished when the firmware reports ``Idle`` at the target; an ``ok`` proves nothing. The
firmware counts motor steps and cannot detect lost steps. After a reset, an alarm or a long silence the position is
unknown, and every move is refused until ``home()`` has succeeded. GRBL homes z first, upwards, so homing also lifts
the sensor. Without ``home`` at opening, the driver trusts the position that the firmware has kept, unless opening the
port reset it.

``stop()`` sends ``!`` (feed hold), which keeps the position. The next call waits until the carriage stands still and
leaves the hold with Ctrl-X. While homing it sends Ctrl-X, since GRBL ignores ``!`` there.

Only one line is sent at a time, so the firmware's 128-byte buffer cannot overflow. The protocol is described at
https://github.com/gnea/grbl/wiki.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Unpack

from tacbench_cad.lab.rig import grbl_replies as replies
from tacbench_cad.lab.rig import switches
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    DeviceLostError,
    NoAnswerError,
    PositionLostError,
    RigError,
)
from tacbench_cad.lab.rig.firmware_settings import FirmwareSetting, grbl_settings
from tacbench_cad.lab.rig.grbl_link import ANSWER_S, HOLD, RESET, GrblLink
from tacbench_cad.lab.rig.grbl_machine import ASIDE_MM, GrblMachine, is_aside
from tacbench_cad.lab.rig.grbl_replies import Status
from tacbench_cad.lab.rig.serial_stage import (
    STILL_HOMING,
    SerialOptions,
    SerialStage,
    confirmed,
    is_near,
    place_text,
)
from tacbench_cad.lab.rig.stage import Limits
from tacbench_cad.lab.study.spec import Point, StageSettings, plus

#: The baud rate of the port.
BAUD = 115200
#: The pause between two status reports while the carriage moves, and after the expected end of the move, in s of rig
#: time.
POLL_S, END_POLL_S = 0.03, 0.005
#: The time after the expected end of a move, in s of rig time, for which the reports come faster.
END_S = 0.3
#: A carriage that stands still this long, in s, away from its target will probably not continue.
STANDING_S = 0.3
#: The largest number of repetitions of a line that the firmware could not read and did not execute.
RESENDS = 5
#: The largest number of attempts to home, if the firmware does not accept the command.
HOMINGS = 4
#: The number of GRBL's error for homing that is not enabled.
NO_HOMING = 5
#: The settings that stop moves at the ends of the travel: soft limits and end stops.
LIMITS = (20, 21)


class GrblStage(SerialStage[GrblLink]):
    """A three-axis stage with GRBL. See :class:`tacbench_cad.lab.rig.stage.Stage` and the module's description.

    Args:
        port: The path, name or pyserial URL of the port.
        tolerance_mm: The allowed distance of a coordinate from its target, in mm; None for half a motor step plus the
            rounding of the report.
        checks_settings: Whether settings with which the sensor must not press are refused, and the limits that a
            killed program left switched off are switched on again. Otherwise, the settings are only read.
        options: See :class:`~tacbench_cad.lab.rig.serial_stage.SerialOptions`.

    Attributes:
        settings: The firmware's numbered settings.

    Raises:
        InputError: The port cannot be opened.
        NoAnswerError: The device does not answer.
        RigError: The device is not GRBL 1.1, reports inches, or switches its motors off at rest.
    """

    def __init__(
        self,
        port: str,
        *,
        tolerance_mm: float | None = None,
        checks_settings: bool = True,
        **options: Unpack[SerialOptions],
    ) -> None:
        super().__init__(port, GrblLink, (BAUD,), options)
        self._stopping = self._homing = self._homing_sent = False
        self._switches = switches.SwitchCheck()
        with self._opening():
            self._link.greet()
            self.identity = f"grbl: {self._link.firmware} at {port}"
            self._look_around()
            self.settings = self._restored_settings() if checks_settings else self._link.settings()
            self._machine = GrblMachine(name=self._link.name, settings=self.settings, options=self._link.options)
            if checks_settings:
                self._machine.require_pressable()
            self._tolerance_mm = tuple(tolerance_mm or self._machine.resolution_mm(axis) for axis in range(3))

    def home(self) -> None:
        """Find the end stops, z first and upwards (GRBL's own order). Afterwards the position is known.

        Homing works in every state, since it begins with a reset. An ``ok`` alone proves nothing: the firmware must
        have reported ``Home``, or the carriage must stand at the ends of its travel. A garbled command is repeated.

        Raises:
            AlarmError: An end stop was not found or stays closed, or homing was stopped.
            RigError: Homing is not enabled in the firmware (``$22=0``).
            RigError: The device is gone or silent, or was reset.
        """
        self._stopping = False
        home_reported: bool | None = None
        # The time to answer while homing says nothing about the time to answer later.
        usual_answer_s = self._link.answer_s
        with self._stoppable_homing():
            for _ in range(HOMINGS):
                self._link.reset()
                self._link.lost = "homing was not completed"
                self._require_free_switch(2.0 * self._machine.pull_off_mm, lambda: "Z" in self._link.status().pins)
                if not self._stopping:
                    home_reported = self._wait_for_homing()
                if self._stopping or home_reported is not None:
                    break
        if self._stopping:
            raise AlarmError(f"{self._link.name}: homing was stopped on request")
        if home_reported is None:
            raise RigError(f"{self._link.name}: does not understand the homing command; check the cable")
        self._link.answer_s = usual_answer_s
        # A late answer to the last question must not count as the answer to the next one.
        for _ in range(20):
            if self._link.next(0.05) is None:
                break
        at = self._standing("Idle", failed="does not come to rest")
        if not home_reported and not self._machine.is_at_ends(at):
            raise PositionLostError(f"{self._link.name}: answered ok to homing but did not home; home it first")
        self._line.torn = False
        self._link.lost = ""
        self._last = self._home_mm = at

    def home_offset_mm(self) -> Point | None:
        """Measure how wrong the position is, and home. See :func:`tacbench_cad.lab.rig.stage.home_again`.

        The carriage moves to the place where homing ended, and from there to each switch in small steps. Homing has
        found the switch at the pull-off distance (``$27``). The firmware's own limits (``$20``, ``$21``) forbid this,
        so they are switched off meanwhile, with a mark in its memory. If this program is killed, the next one finds the
        mark and switches them on again. The end of a report names the closed switches (``Pn:``).

        Raises:
            RigError: The device is gone or silent, was reset, or homing failed.
        """
        return self._switches.compare(self._offset_at_switches, self.home)

    def _offset_at_switches(self) -> Point | None:
        if self._home_mm is None or self._link.lost:
            return None
        limits = [number for number in LIMITS if self.settings.get(number)]
        # If the program is killed, the next one finds the mark and switches the limits on again.
        self._link.mark(limits)
        try:
            for number in limits:
                self._link.set(number, 0.0)
            return self._search_switches(self._home_mm)
        finally:
            with suppress(RigError):
                if self._stopping:
                    self._leave_hold()
                self._switch_on({number: self.settings[number] for number in limits})

    def _search_switches(self, home_mm: Point) -> Point:
        x, y, z = (-1 if self._machine.homes_downwards(axis) else 1 for axis in range(3))
        off_mm = self._machine.pull_off_mm
        switch_mm = plus(home_mm, (x * off_mm, y * off_mm, z * off_mm))
        return switches.offsets_at_switches(
            self.position(),
            home_mm,
            switch_mm,
            (x, y, z),
            self.move,
            lambda axis: "XYZ"[axis] in self._link.status().pins,
        )

    def _switch_on(self, limits: Mapping[int, float]) -> None:
        """Switch the firmware's own limits on again, and remove the mark."""
        for number, value in limits.items():
            self._link.set(number, value)
        self._link.mark(())

    def _restored_settings(self) -> dict[int, float]:
        """Read the settings, after switching on the limits that a killed program left switched off."""
        if self._link.marked:
            self._switch_on({number: 1.0 for number in LIMITS if number in self._link.marked})
        return self._link.settings()

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move to a position in a straight line. The move is finished when ``Idle`` at the target is reported.

        Every report during the move must lie on the straight line. A line that was garbled on its way to the firmware,
        which has no checksums, shows as a carriage that moves elsewhere; the driver then stops it.

        Raises:
            AlarmError: The firmware is locked, or an alarm locked it during the move.
            PositionLostError: The firmware was reset, during the move or before; home it first.
            OutOfRangeError: The target is beyond the firmware's own limits.
            RigError: The move was stopped on request, put on hold, stuck, or ended at another position.
            NoAnswerError: The device is silent.
            DeviceLostError: The device is unplugged.
        """
        start = self.position()
        with self._moving():
            self._last = self._follow(start, target_mm, speed_mm_s)
        return self._last

    def position(self) -> Point:
        """Return the reported machine position in mm. After a stop, wait until the carriage stands still.

        Raises:
            PositionLostError: The position is unknown: reset, alarm, or never homed.
            RigError: The device is gone or silent.
        """
        self._link.require_known()
        if self._stopping or self._line.torn:
            self._leave_hold()
        at = confirmed(self._reported, lambda at: self._last is None or self._there(at, self._last))
        if at is None:
            raise RigError(f"{self._link.name}: reports another position each time")
        # A reset leaves this position. Its banner may have been lost.
        if at == (0.0, 0.0, 0.0) and self._last is not None and math.dist(at, self._last) > ASIDE_MM:
            raise self._link.reset_noticed("reports 0, 0, 0 although it should be elsewhere")
        self._last = at
        return at

    def stop(self) -> None:
        """Stop all motion at once. Signal handlers may call this method. Never raises."""
        self._stopping = True
        self._line.write_now(RESET if self._homing else HOLD)

    def checked_settings(self, stage: StageSettings | None = None) -> tuple[FirmwareSetting, ...]:
        """Compare the firmware's settings with those of a press rig, and with a study's ``[stage]`` if given."""
        return grbl_settings(self.settings, counts_from_switch=self._machine.counts_from_switch, stage=stage)

    def kept_limits_mm(self, limits_mm: Limits) -> Limits:
        """Return the limits of a study file, shortened so that no end stop is reached.

        Raises:
            InputError: The limits reach beyond the travel at which the firmware stops.
        """
        return self._machine.kept_limits_mm(limits_mm)

    @contextmanager
    def _stoppable_homing(self) -> Iterator[None]:
        """Stop homing if the body is interrupted. GRBL would go on even after this program has ended."""
        self._homing, self._homing_sent = True, False
        try:
            yield
        except (DeviceLostError, NoAnswerError) as error:
            self._line.write_now(RESET)
            if not self._homing_sent:
                raise
            raise type(error)(f"{error}; {STILL_HOMING}") from None
        except RigError:
            raise
        except BaseException as error:
            stopped = False
            with suppress(RigError):
                self._link.reset()
                stopped = True
            error.add_note("homing was stopped, so the position is unknown" if stopped else STILL_HOMING)
            raise
        finally:
            self._homing = False

    def _reported(self) -> Point:
        report = self._link.status()
        self._link.not_locked(report)
        return self._place(report)

    def _place(self, report: Status) -> Point:
        assert report.machine_mm is not None, "status() refuses work coordinates"
        return report.machine_mm

    def _there(self, at: Point, target: Point) -> bool:
        return is_near(at, target, self._tolerance_mm)

    def _follow(self, start: Point, target: Point, speed_mm_s: float) -> Point:
        """Send a move and watch it until its end."""
        name, line, link = self._link.name, self._line, self._link
        x, y, z = target
        command = f"G21G90G94G53G1X{x:.4f}Y{y:.4f}Z{z:.4f}F{max(60.0 * speed_mm_s, 0.1):.3f}"
        line.write(command.encode("ascii") + b"\n")
        start_s = reported_s = progress = line.now_s()
        travel_s = self._machine.travel_s(start, target, speed_mm_s) / self._clock.speed
        give_up = start_s + self._timeout_s + 2.0 * travel_s * self._clock.speed
        closest, aside, accepted, refusals, foreign = math.dist(start, target), 0, False, 0, 0
        standing: tuple[Point, float] | None = None
        synchronising = False
        ask_at = start_s
        while True:
            now = line.now_s()
            if now >= ask_at:
                link.request()
                ask_at = now + link.answer_s
            answer = link.next(max(ask_at - now, 0.0))
            now = line.now_s()
            if self._stopping:
                raise RigError(f"{name}: the move to {place_text(target)} was stopped on request")
            if now - reported_s > self._timeout_s:
                raise self._link.silence()
            if isinstance(answer, str):
                if replies.is_unreadable(answer) and refusals < RESENDS:
                    # A disturbance may last longer, so the pause increases each time.
                    time.sleep(0.01 * 2.0**refusals)
                    # After an error, grblHAL refuses everything until an empty line, which has its own ok.
                    line.write(b"\n" + command.encode("ascii") + b"\n")
                    accepted, refusals, foreign = False, refusals + 1, foreign + 1
                    start_s = line.now_s()
                    continue
                link.refused(answer, command)
                if answer == "ok":
                    # Until now, the carriage may have stood because the firmware was slow.
                    accepted, foreign, standing = accepted or not foreign, max(foreign - 1, 0), None
            if not isinstance(answer, Status) or (at := answer.machine_mm) is None:
                continue
            reported_s, ask_at = now, self._next_poll_s(now, start_s + travel_s)
            link.not_locked(answer)
            if answer.state == "Hold":
                self._stopping = True
                raise RigError(f"{name}: was put on hold at {place_text(at)}, perhaps by its button")
            # A single report may be damaged, so two consecutive reports are needed.
            aside = aside + 1 if is_aside(at, start, target) else 0
            if aside >= 2:
                self.stop()
                raise RigError(
                    f"{name}: moved to {place_text(at)}, off the line to {place_text(target)}, and was stopped"
                )
            if not aside:
                self._report(at)
            if answer.state != "Idle":
                standing = None
                if math.dist(at, target) < closest - min(self._tolerance_mm):
                    closest, progress = math.dist(at, target), now
                if now - progress > self._timeout_s or now > give_up:
                    self.stop()
                    raise RigError(
                        f"{name}: stays at {place_text(at)} on its way to {place_text(target)} and was stopped"
                    )
                continue
            standing = standing if standing and standing[0] == at else (at, now)
            stood_s = now - standing[1]
            if self._there(at, target) and (accepted or stood_s >= STANDING_S):
                return at
            if accepted and stood_s >= STANDING_S and not synchronising:
                # A slow firmware may not have begun the move. It acknowledges a dwell after all motion.
                line.write(b"\nG4P0\n")
                synchronising, foreign = True, 2
            if stood_s >= (STANDING_S if accepted and not foreign else self._timeout_s):
                why = "the move ended" if accepted else "the firmware did not accept the move and stands"
                raise RigError(f"{name}: {why} at {place_text(at)} instead of {place_text(target)}")

    def _next_poll_s(self, now_s: float, end_s: float) -> float:
        """Return the time of the next status request: at intervals, at the expected end of a move, and often after it.

        Args:
            now_s: The time of the last report.
            end_s: The expected end of the move.
        """
        poll_s, end_poll_s, late_s = (seconds / self._clock.speed for seconds in (POLL_S, END_POLL_S, END_S))
        if now_s > end_s + late_s:
            return now_s + poll_s
        return now_s + min(poll_s, max(end_s - now_s, end_poll_s))

    def _wait_for_homing(self) -> bool | None:
        """Send ``$H`` and wait for the end of homing.

        An ``ok`` may belong to a piece of a garbled line. Without ``Home``, two more reports must follow it.

        Returns:
            Whether ``Home`` was reported; None if the firmware did not accept the command.
        """
        home_reported, acknowledged, standing = False, False, 0
        self._line.write(b"$H\n")
        self._homing_sent = True
        self._clock.sleep(0.05)
        until = self._line.now_s() + self._home_timeout_s
        ask_at = self._line.now_s()
        while (now := self._line.now_s()) < until:
            # The answers come late, but one of them shows that the firmware is homing.
            if now >= ask_at:
                self._link.request()
                ask_at = now + (max(POLL_S, self._link.answer_s / 4.0) if acknowledged else 0.5)
            answer = self._link.next(max(ask_at - now, 0.0))
            if answer == "ok":
                if home_reported:
                    return True
                acknowledged, standing, ask_at = True, 0, now
            elif isinstance(answer, Status):
                home_reported = home_reported or answer.state == "Home"
                # The firmware answers at once only if it is not homing. The first answer may be older than the command.
                # A slow firmware may answer several times before it reads the command.
                standing += answer.state in ("Idle", "Alarm")
                if standing >= (2 if acknowledged else 4):
                    return home_reported if answer.state == "Idle" and (home_reported or acknowledged) else None
            elif answer is not None:
                if replies.error(answer) not in (None, NO_HOMING):
                    return None
                self._link.refused(answer, "$H")
        raise NoAnswerError(f"{self._link.name}: homing did not end within {self._home_timeout_s:g} s")

    def _leave_hold(self) -> None:
        """Wait after :meth:`stop` until the carriage stands still, and leave the hold without losing the position."""
        before = self._standing("Idle", "Hold", failed="does not stop")
        self._stopping = False
        self._link.reset()
        if math.dist(self._reported(), before) > ASIDE_MM:
            raise self._link.reset_noticed("lost its position at the end of a hold")
        self._line.torn = False

    def _standing(self, *states: str, failed: str) -> Point:
        """Return the position once the carriage stands still in an allowed state; request a hold again if needed."""
        until = self._line.now_s() + self._timeout_s
        again = self._line.now_s() + ANSWER_S
        while True:
            report = self._link.status()
            self._link.not_locked(report)
            if report.state in states and (report.state != "Hold" or report.detail == 0):
                return self._place(report)
            now = self._line.now_s()
            if now >= until:
                raise RigError(f"{self._link.name}: {failed}; its state is {report.state}")
            if "Hold" in states and now >= again:
                self._line.write_now(HOLD)
                again = now + ANSWER_S
            self._clock.sleep(POLL_S)

    def _look_around(self) -> None:
        """Check the state of the stage when it is opened."""
        report = self._link.status()
        if report.state == "Alarm":
            self._link.lost = self._link.lost or "the firmware is locked and the stage was not homed"
        elif report.state in ("Run", "Jog", "Hold"):
            # A program that was killed left the carriage moving.
            self.stop()
            self._leave_hold()
        elif report.state in ("Home", "Sleep"):
            self._link.reset()
            self._link.lost = f"the firmware was in state {report.state}"
