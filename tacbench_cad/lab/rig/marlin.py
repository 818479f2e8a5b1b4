"""A stage controlled by Marlin 2: a converted 3D printer.

Frame: the stage's coordinates are Marlin's own coordinates after homing (``G28``), including the home offsets that the
firmware stores. The driver never sends ``G92``, so a taught origin stays valid after the power was off, once the stage
has been homed again.

Proof of a move: ``ok`` only means that a move was queued, and ``M114`` reports the end of the queue. A move is finished
when ``M400`` was acknowledged (all motion has ended) and a later ``M114`` reports the target, since soft end stops
change a target without a message. If the build reports motor steps (``Count``), they must agree too, and they give the
position with the motors' resolution. The steps are counted, so a slipping motor is not detected. After a reset, a halt
or a lost answer the position is unknown, and every move is refused until ``home()`` has succeeded.

Short moves: Marlin withholds a move of fewer than 6 motor steps (``MIN_STEPS_PER_SEGMENT``) until later moves add up to
more. It acknowledges the move, but the carriage stays. The driver therefore makes such a move by a detour: up, by at
least 0.03 mm, and down again to the target. It never goes below the target. At the upper end of z, where soft end stops
allow no lift, the detour goes sideways in x.

Delay: Marlin waits 0.1 s before it starts a move from rest, unless three moves are planned. The driver therefore sends
a move in three parts if each part has enough motor steps. The parts lie on one straight line, so Marlin does not stop
between them.

Idle motors: Marlin switches the motors off after some time without motion, usually 120 s. The z axis can then drop
unnoticed. The driver switches this off with ``M84 S0``.

Homing: the end stops that ``M119`` lists show the direction in which z is homed. With an end stop at the top, z is
homed first and upwards. With one only at the bottom (as usual on a printer), z is homed downwards: the driver first
raises the sensor by ``home_lift_mm``, then homes x, y and z. Nothing may be below the sensor at that corner.

``stop()`` sends ``M410``. Motion ends without deceleration. About a second of silence follows, and Marlin would execute
lines sent during it twice, so the next call waits until it is over. After a stop during homing the position is unknown,
and most builds halt. If an exception (Ctrl-C) interrupts homing, the driver sends ``M410``, then ``M112``, and adds a
note to the exception that says whether the firmware has stopped.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from typing import Unpack

from tacbench_cad.lab.rig import marlin_replies as replies
from tacbench_cad.lab.rig import switches
from tacbench_cad.lab.rig.errors import (
    AlarmError,
    DeviceLostError,
    NoAnswerError,
    RigError,
)
from tacbench_cad.lab.rig.firmware_settings import FirmwareSetting, marlin_settings
from tacbench_cad.lab.rig.marlin_link import BAUDS, MarlinLink
from tacbench_cad.lab.rig.marlin_replies import MarlinPosition
from tacbench_cad.lab.rig.serial_stage import (
    STILL_HOMING,
    SerialOptions,
    SerialStage,
    confirmed,
    duration_s,
    is_near,
    place_text,
)
from tacbench_cad.lab.study.spec import Point, StageSettings

#: The largest rounding error of a position from ``M114``, plus a little for the rounding of the target, in mm.
ROUNDING_MM = 0.0055
#: The speed of the lift before homing, in mm/s.
LIFT_MM_S = 5.0
#: The smallest number of motor steps in a part of a move: one more than Marlin's usual limit, since both ends of a part
#: are rounded to whole steps.
PART_STEPS = 7
#: The smallest length of a detour in mm. Answers to ``M114``, with two decimals, can show whether it was possible.
DETOUR_MM = 0.03
#: The distance below the upper end of z, in mm, from which a closed end stop is faulty.
SWITCH_MM = 1.0


class MarlinStage(SerialStage[MarlinLink]):
    """A three-axis stage with Marlin 2. See :class:`tacbench_cad.lab.rig.stage.Stage` and the module's description.

    Args:
        port: The path, name or pyserial URL of the port.
        home_lift_mm: The lift before homing in mm, if z is homed downwards.
        options: See :class:`~tacbench_cad.lab.rig.serial_stage.SerialOptions`. The clock is not used, since Marlin
            itself reports the end of motion. Without a baud rate, the driver tries the two common ones.

    Raises:
        InputError: The port cannot be opened.
        NoAnswerError: The device does not answer.
        RigError: The device is not Marlin 2.
    """

    def __init__(self, port: str, *, home_lift_mm: float = 5.0, **options: Unpack[SerialOptions]) -> None:
        super().__init__(port, MarlinLink, BAUDS, options)
        self._home_lift_mm = home_lift_mm
        self._steps_per_mm: Point | None = None
        self._rates_mm_s: Point | None = None
        self._counts = self._settled = False
        self._highest_mm = -math.inf
        self._switches = switches.SwitchCheck()
        with self._opening():
            self._link.greet(self._bauds)
            self.identity = f"marlin: {self._link.firmware} at {port}"
            self._prepare()
            place = self._place()
            self._counts = self._counted(place) is not None
            if not any(place.planned_mm) and not self._link.lost:
                self._link.lost = "its counters are at 0, as after power-on"

    def home(self) -> None:
        """Find the end stops, in the order that the module's description gives. Afterwards the position is known.

        Homing works in every state in which the firmware answers.

        Raises:
            AlarmError: The firmware halted (an end stop was not found), or homing was stopped.
            RigError: The device is gone or silent, or was reset.
        """
        self._link.resume(may_reset=True)
        self._link.lost = "homing was not completed"
        self._link.greet(())
        self._prepare()
        # A program that was killed while it measured the position has left the soft end stops off.
        self._link.command("M211 S1")
        stops = self._link.command("M119")
        self._require_free_switch(SWITCH_MM, lambda: any("z_max: TRIGGERED" in line for line in stops))
        with self._stoppable_homing():
            rise = ("G91", f"G1 Z{self._home_lift_mm:.3f} F{60.0 * LIFT_MM_S:.0f}", "G90")
            z_first = any(line.startswith("z_max") for line in stops)
            order = ("G28 Z", "G28 X", "G28 Y") if z_first else (*rise, "G28 X", "G28 Y", "G28 Z")
            for command in (*order, "M400"):
                self._require(command, self._home_timeout_s)
        place = self._place()
        counted = self._counted(place)
        self._counts = counted is not None
        self._link.lost = ""
        self._home_mm = self._settle_at(counted or place.planned_mm)

    def home_offset_mm(self) -> Point | None:
        """Measure how wrong the position is, and home. See :func:`tacbench_cad.lab.rig.stage.home_again`.

        The carriage moves to the place where homing found the switches, as homing does, and from there to each switch
        in small steps. The soft end stops forbid this, so they are switched off meanwhile (``M211``). ``M119`` reports
        the closed switches.

        Raises:
            RigError: The device is gone or silent, was reset, or homing failed.
        """
        return self._switches.compare(self._offset_at_switches, self.home)

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move to a position in a straight line. The end is proved by ``M400`` and ``M114``.

        Raises:
            AlarmError: The firmware halted.
            PositionLostError: The firmware was reset, during the move or before; home it first.
            RigError: The move was stopped on request, limited by a soft end stop, or interrupted.
            NoAnswerError: The device is silent.
            RigError: Lines were garbled too often.
            DeviceLostError: The device is unplugged.
        """
        start = self._start()
        with self._moving():
            self._settled = False
            self._send(start, target_mm, speed_mm_s)
            seconds = duration_s(start, target_mm, speed_mm_s, self._rates_mm_s or (0.0,) * 3)
            self._link.command("M400", within_s=seconds, limit_s=4.0 * (self._timeout_s + seconds) + 10.0)
            # The motion has just ended. Where the carriage was on its way is unknown.
            self._report(target_mm)
            at = self._at(target_mm)
        if not is_near(at, target_mm, self._tolerance_mm()):
            # The carriage may now stand at an end stop, which homing must not take for a stuck switch.
            self._last = at
            raise RigError(
                f"{self._link.name}: stands at {place_text(at)} instead of {place_text(target_mm)}; "
                "the firmware's soft end stops limited the move, it was interrupted, or the build withholds moves of "
                f"{PART_STEPS} motor steps (MIN_STEPS_PER_SEGMENT)"
            )
        return self._settle_at(at)

    def position(self) -> Point:
        """Return the reported position in mm after all motion has ended.

        Raises:
            PositionLostError: The position is unknown: reset, halted, or never homed.
            RigError: The device is gone or silent.
        """
        self._link.require_known()
        if self._link.stopping or self._line.torn or self._link.unsure:
            self._link.resume()
            self._prepare()
            self._link.command("M400", limit_s=4.0 * self._timeout_s)
        at = self._at(self._last)
        # A reset leaves this position. Its banner may have been lost.
        if not any(at) and self._last is not None and math.dist(at, self._last) > 2.0 * ROUNDING_MM:
            raise self._link.reset_noticed("reports 0, 0, 0 although it should be elsewhere")
        return self._settle_at(at)

    def checked_settings(self, stage: StageSettings | None = None) -> tuple[FirmwareSetting, ...]:
        """Compare the firmware's settings with those of a press rig, and with a study's ``[stage]`` if given."""
        return marlin_settings(
            steps_per_mm=self._steps_per_mm,
            speeds_mm_s=self._rates_mm_s,
            soft_end_stops=replies.soft_end_stops(self._link.command("M211")),
            stage=stage,
        )

    def stop(self) -> None:
        """Stop all motion at once. Signal handlers may call this method. Never raises."""
        self._link.stop()

    def _offset_at_switches(self) -> Point | None:
        if self._home_mm is None or self._link.lost:
            return None
        towards = replies.homing_directions(self._link.command("M119"))
        if towards is None or any(replies.unknown(line) is not None for line in self._link.command("M211 S0")):
            return None
        highest_mm = self._highest_mm
        try:
            return self._search_switches(self._home_mm, towards)
        finally:
            self._highest_mm = highest_mm
            with contextlib.suppress(RigError):
                self._link.command("M211 S1")

    def _search_switches(self, home_mm: Point, towards: tuple[int, int, int]) -> Point:
        x, y, z = self.position()
        if towards[2] < 0:
            z += self._home_lift_mm
            self.move((x, y, z), switches.WAY_MM_S)
        rest_x, rest_y, rest_z = (at - way * switches.FRONT_MM for at, way in zip(home_mm, towards, strict=True))
        # Marlin withholds very short moves, so there is no fine search.
        return switches.offsets_at_switches(
            (x, y, z),
            (rest_x, rest_y, rest_z),
            home_mm,
            towards,
            self.move,
            lambda axis: "xyz"[axis] in replies.closed_switches(self._link.command("M119")),
            fine_mm=switches.COARSE_MM,
        )

    @contextlib.contextmanager
    def _stoppable_homing(self) -> Iterator[None]:
        """Stop homing if the body is interrupted. Marlin would go on even after this program has ended."""
        try:
            yield
        except (DeviceLostError, NoAnswerError) as error:
            self.stop()
            # A command that could not be sent does not move the carriage.
            if self._line.torn:
                raise
            raise type(error)(f"{error}; {STILL_HOMING}") from None
        except RigError as error:
            if type(error) is RigError and self._link.stopping:
                raise AlarmError(f"{self._link.name}: homing was stopped on request") from None
            raise
        except BaseException as error:
            error.add_note(self._link.stop_homing())
            raise

    def _start(self) -> Point:
        """Return the position at rest. It is read only if the last move failed; a reset shows in the line numbers."""
        self._link.require_known()
        clean = self._settled and not (self._link.stopping or self._line.torn or self._link.unsure)
        return self._last if clean and self._last is not None else self.position()

    def _settle_at(self, at: Point) -> Point:
        """Store a position at rest, and return it."""
        self._last, self._settled = at, True
        self._highest_mm = max(self._highest_mm, at[2])
        return at

    def _send(self, start: Point, target: Point, speed_mm_s: float) -> None:
        """Send a move, in parts that the firmware neither withholds nor delays if possible."""
        parts = [target]
        if self._steps_per_mm is not None:
            steps = max(
                abs(round(b * per_mm) - round(a * per_mm))
                for a, b, per_mm in zip(start, target, self._steps_per_mm, strict=True)
            )
            if 0 < steps < PART_STEPS:
                parts = [_between(self._detour(start, target, speed_mm_s), target, 0.5), target]
            elif steps >= 3 * PART_STEPS:
                parts = [_between(start, target, 1.0 / 3.0), _between(start, target, 2.0 / 3.0), target]
        for part in parts:
            self._go(part, speed_mm_s)

    def _detour(self, start: Point, target: Point, speed_mm_s: float) -> Point:
        """Send the first part of a detour, and return its end: above the target, or beside it at the upper end of z."""
        assert self._steps_per_mm is not None
        aside_mm, _, lift_mm = (max(2.0 * PART_STEPS / per_mm, DETOUR_MM) for per_mm in self._steps_per_mm)
        x, y, z = start[0], start[1], max(start[2], target[2])
        above: Point = (x, y, z + lift_mm)
        self._go(above, speed_mm_s)
        # Soft end stops limit a target without a message.
        if above[2] <= self._highest_mm or self._is_planned(above):
            return above
        for beside in ((x + aside_mm, y, z), (x - aside_mm, y, z)):
            self._go(beside, speed_mm_s)
            if self._is_planned(beside):
                break
        return beside

    def _is_planned(self, target: Point) -> bool:
        """Return whether the firmware accepted a target without limiting it."""
        return is_near(self._place().planned_mm, target, (ROUNDING_MM,) * 3)

    def _go(self, target: Point, speed_mm_s: float) -> None:
        x, y, z = target
        self._require(f"G1 X{x:.4f} Y{y:.4f} Z{z:.4f} F{max(60.0 * speed_mm_s, 0.1):.3f}")

    def _prepare(self) -> None:
        """Set the modes that a reset clears (mm, absolute, no reports, motors on), and read the axes' limits."""
        self._require("G90")
        self._require("M84 S0")
        # Some builds do not know these commands. They then have no such mode to switch off.
        for command in ("G21", "M154 S0", "M155 S0"):
            self._link.command(command)
        lines = [line for command in ("M92", "M203") for line in self._link.command(command)]
        per_axis = dict(numbers for line in lines if (numbers := replies.per_axis(line)))
        self._steps_per_mm, self._rates_mm_s = per_axis.get("M92"), per_axis.get("M203")

    def _require(self, command: str, limit_s: float | None = None) -> list[str]:
        """Send a command that the firmware must know, and return the lines of its answer."""
        lines = self._link.command(command, limit_s=limit_s)
        if any(replies.unknown(line) is not None for line in lines):
            raise RigError(f"{self._link.name}: does not know {command}; it sent {lines[-1]!r}")
        return lines

    def _place(self) -> MarlinPosition:
        lines = self._link.command("M114", expecting=lambda line: replies.place(line) is not None)
        return next(place for line in reversed(lines) if (place := replies.place(line)))

    def _at(self, expected: Point | None) -> Point:
        """Return the position at rest, from the motors' steps if they have agreed with the coordinates before.

        An unexpected position must be reported twice, since a report may be damaged.
        """
        place = confirmed(
            self._place,
            lambda place: expected is not None and math.dist(place.planned_mm, expected) <= 2.0 * ROUNDING_MM,
        )
        if place is None:
            raise RigError(f"{self._link.name}: reports another position each time although it does not move")
        counted = self._counted(place)
        if self._counts and counted is None:
            raise RigError(
                f"{self._link.name}: its motors are not at its planned position, {place_text(place.planned_mm)}; "
                "the motion was interrupted"
            )
        return counted or place.planned_mm

    def _counted(self, place: MarlinPosition) -> Point | None:
        """Return the position from motor steps; None if they are not reported or differ from the planned position."""
        if place.steps is None or self._steps_per_mm is None or not all(self._steps_per_mm):
            return None
        x, y, z = (count / per_mm for count, per_mm in zip(place.steps, self._steps_per_mm, strict=True))
        for counted, planned, per_mm in zip((x, y, z), place.planned_mm, self._steps_per_mm, strict=True):
            if abs(counted - planned) > ROUNDING_MM + 1.0 / per_mm:
                return None
        return (x, y, z)

    def _tolerance_mm(self) -> Point:
        if not self._counts or self._steps_per_mm is None:
            return (ROUNDING_MM,) * 3
        x, y, z = (0.5 / per_mm + 0.0005 for per_mm in self._steps_per_mm)
        return (x, y, z)


def _between(start: Point, end: Point, fraction: float) -> Point:
    """Return a point on the straight line from start to end."""
    x, y, z = (a + (b - a) * fraction for a, b in zip(start, end, strict=True))
    return (x, y, z)
