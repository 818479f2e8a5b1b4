"""A stage run by Marlin 2: a converted 3D printer.

Frame: the stage's millimetres are Marlin's own coordinates as homing sets them (``G28``), with the home offsets that
are stored in the firmware; ``G92`` is never sent. So a taught origin stays valid after the power was off, once the
stage is homed again.

Trust: ``ok`` says that a move was queued, and ``M114`` where the queue will end. A move is done when ``M400`` has
come through (all motion ended) and ``M114``, asked after it, names the target: soft end stops clamp a target
silently. Where the build reports motor steps (``Count``) these must agree too, and give the position with the
motors' resolution. Motors are counted, not seen: a slipping motor is not noticed. A reset, a halt or a lost answer
makes the position unknown, and every move is refused until ``home()`` has succeeded.

Homing: the end stops that ``M119`` lists tell which way z goes. With one at the top, z is homed first and upwards.
With one at the bottom only (a printer's usual one), homing z goes down: the sensor is first raised by
``home_lift_mm``, x and y are homed, then z; nothing may lie below the sensor at that corner.

``stop()`` sends ``M410``. Motion ends without slowing down, about a second of silence follows, and lines sent in it
would run twice: the next call waits it out. While homing the position is unknown afterwards.
"""

from __future__ import annotations

import math
from typing import Unpack

from tacbench_cad.lab.rig import marlin_replies as replies
from tacbench_cad.lab.rig.errors import AlarmError, NotThereError, ProtocolError
from tacbench_cad.lab.rig.marlin_link import BAUDS, MarlinLink
from tacbench_cad.lab.rig.marlin_replies import Place
from tacbench_cad.lab.rig.serial_stage import SerialOptions, SerialStage, confirmed, duration_s, is_near, place_text
from tacbench_cad.lab.study.spec import Point

#: Half of the last decimal of ``M114``, and a little for the rounding of the target.
ROUNDING_MM = 0.0055
#: Speed of the rise before homing.
LIFT_MM_S = 5.0


class MarlinStage(SerialStage[MarlinLink]):
    """A three-axis stage behind Marlin 2. See :class:`tacbench_cad.lab.rig.stage.Stage` and the module's text.

    Args:
        port: Path, name or pyserial URL.
        home_lift_mm: Rise before homing where z is homed downwards.
        options: See :class:`~tacbench_cad.lab.rig.serial_stage.SerialOptions`. The clock is not used, since Marlin
            itself says when motion has ended; without a baud rate the two common ones are tried.

    Raises:
        InputError: The port cannot be opened.
        NoAnswerError: Nothing answers.
        ProtocolError: Something else than Marlin 2 answers.
    """

    def __init__(self, port: str, *, home_lift_mm: float = 5.0, **options: Unpack[SerialOptions]) -> None:
        super().__init__(port, MarlinLink, BAUDS, options)
        self._home_lift_mm = home_lift_mm
        self._steps_per_mm: Point | None = None
        self._rates_mm_s: Point | None = None
        self._counts = False
        with self._opening():
            self._link.greet(self._bauds)
            self.identity = f"marlin: {self._link.firmware} at {port}"
            self._prepare()
            place = self._place()
            self._counts = self._counted(place) is not None
            if not any(place.planned_mm) and not self._link.lost:
                self._link.lost = "it counts from 0 as after its power came on"

    def home(self) -> None:
        """Find the end stops (see the module's text for the order); afterwards the position is known.

        Works from every state in which the firmware answers.

        Raises:
            AlarmError: The firmware halted (an end stop was not found), or homing was stopped.
            RigError: Lost, silent or reset.
        """
        self._link.resume()
        self._link.greet(())
        self._link.lost = "homing was not finished"
        self._prepare()
        stops = self._link.command("M119")
        try:
            rise = ("G91", f"G1 Z{self._home_lift_mm:.3f} F{60.0 * LIFT_MM_S:.0f}", "G90")
            z_first = any(line.startswith("z_max") for line in stops)
            order = ("G28 Z", "G28 X", "G28 Y") if z_first else (*rise, "G28 X", "G28 Y", "G28 Z")
            for command in (*order, "M400"):
                self._known(command, self._home_timeout_s)
        except NotThereError:
            raise AlarmError(f"{self._link.name}: homing was stopped on request") from None
        place = self._place()
        counted = self._counted(place)
        self._counts = counted is not None
        self._link.lost = ""
        self._last = counted or place.planned_mm

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Go there in a straight line; done when ``M400`` came through and ``M114`` names the target.

        Raises:
            AlarmError: The firmware halted.
            PositionLostError: It was reset, now or before; home first.
            NotThereError: Stopped on request, clamped by a soft end stop, or cut short.
            NoAnswerError: Silent.
            ProtocolError: Lines were garbled time and again.
            DeviceLostError: Unplugged.
        """
        start = self.position()
        x, y, z = target_mm
        with self._moving():
            self._known(f"G1 X{x:.4f} Y{y:.4f} Z{z:.4f} F{max(60.0 * speed_mm_s, 0.1):.3f}")
            seconds = duration_s(start, target_mm, speed_mm_s, self._rates_mm_s or (0.0,) * 3)
            self._link.command("M400", within_s=seconds, limit_s=4.0 * (self._timeout_s + seconds) + 10.0)
            at = self._at(target_mm)
        if not is_near(at, target_mm, self._tolerance_mm()):
            raise NotThereError(
                f"{self._link.name}: stands at {place_text(at)} instead of {place_text(target_mm)}; "
                "clamped by the firmware's soft end stops, or cut short"
            )
        self._last = at
        return at

    def position(self) -> Point:
        """The reported position in mm, once motion has ended.

        Raises:
            PositionLostError: It is unknown: reset, halted, or never homed.
            RigError: Lost or silent.
        """
        self._link.require_known()
        if self._link.stopping or self._line.torn or self._link.unsure:
            self._link.resume()
            self._prepare()
            self._link.command("M400", limit_s=4.0 * self._timeout_s)
        at = self._at(self._last)
        # What a reset leaves behind, should its banner have been lost on the way.
        if not any(at) and self._last is not None and math.dist(at, self._last) > 2.0 * ROUNDING_MM:
            raise self._link.reset_noticed("reports 0, 0, 0 although it was left elsewhere")
        self._last = at
        return at

    def stop(self) -> None:
        """Stop all motion at once; from a signal handler too. Never raises."""
        self._link.stop()

    def _prepare(self) -> None:
        """Modes that a reset forgets: mm, absolute, no reports unasked; and what the axes can do."""
        self._known("G90")
        # Not every build knows these; where they are missing there is nothing to switch.
        for command in ("G21", "M154 S0", "M155 S0"):
            self._link.command(command)
        lines = [line for command in ("M92", "M203") for line in self._link.command(command)]
        per_axis = dict(numbers for line in lines if (numbers := replies.per_axis(line)))
        self._steps_per_mm, self._rates_mm_s = per_axis.get("M92"), per_axis.get("M203")

    def _known(self, command: str, limit_s: float | None = None) -> list[str]:
        """Send a command that the firmware must know."""
        lines = self._link.command(command, limit_s=limit_s)
        if any(replies.unknown(line) is not None for line in lines):
            raise ProtocolError(f"{self._link.name}: does not know {command}; it said {lines[-1]!r}")
        return lines

    def _place(self) -> Place:
        lines = self._link.command("M114", expecting=lambda line: replies.place(line) is not None)
        return next(place for line in reversed(lines) if (place := replies.place(line)))

    def _at(self, expected: Point | None) -> Point:
        """Position at rest; by the motors' steps where they have proved to mean millimetres.

        Another one than expected is believed only when it was reported twice: a report may be damaged.
        """
        place = confirmed(
            self._place,
            lambda place: expected is not None and math.dist(place.planned_mm, expected) <= 2.0 * ROUNDING_MM,
        )
        if place is None:
            raise ProtocolError(f"{self._link.name}: reports another position each time it is asked, at rest")
        counted = self._counted(place)
        if self._counts and counted is None:
            raise NotThereError(
                f"{self._link.name}: its motors are not where its planner says, {place_text(place.planned_mm)}; "
                "motion was cut short"
            )
        return counted or place.planned_mm

    def _counted(self, place: Place) -> Point | None:
        """Position by motor steps; None where they are not told or disagree with the planned position."""
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
