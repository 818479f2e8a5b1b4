"""Protection of sensor and block: limits on every move, and the lift after a failure.

In the press loop only the carriage moves the stage. It uses the work frame, where z = 0 is the block's highest point.
"""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from tacbench_cad.lab.rig.errors import ContactError, NoAnswerError, OutOfRangeError, PositionLostError, RigError
from tacbench_cad.lab.rig.stage import LimitedStage, Stage, home_again
from tacbench_cad.lab.study.spec import HolderRim, Point, Protocol, WorkFrame, plus
from tacbench_cad.util.text import counted

#: The allowed distance of a reported height below the depth limit, in mm, for firmware that rounds to micrometres.
ROUNDING_MM = 0.002
#: The time, in s, for which the lift is tried again if the stage does not answer: its firmware may only stand still.
RETRY_S = 60.0
#: The pause between two attempts, in s.
RETRY_PAUSE_S = 1.0
#: The longest wait for a device after a signal, in s.
DEVICE_S = 10.0


def travel_height_mm(protocol: Protocol, holder: HolderRim) -> float:
    """Return the height of travel in the work frame: the clearance above the block and the rim, in mm."""
    return protocol.limits.clearance_mm + max(0.0, -holder.rim_mm)


class RunInterruptedError(KeyboardInterrupt):
    """A signal ended a run, which can be resumed.

    Attributes:
        signal: ``SIGINT``, ``SIGTERM`` or ``SIGHUP``.
        lifted: Whether the sensor is lifted off the block; None if this is unknown, because no block was pressed yet.
        gave_up: The call of a device that did not return and was given up; empty if there is none.
        saved: The number of saved presses of the study.
        planned: The number of presses of the study.
    """

    def __init__(self, signal: str) -> None:
        super().__init__(signal)
        self.signal, self.gave_up = signal, ""
        self.lifted: bool | None = True
        self.saved = self.planned = 0

    def __str__(self) -> str:
        saved = f"{self.saved} of {counted(self.planned, 'press')} are saved"
        if self.gave_up:
            saved += f"; gave up {self.gave_up}, which did not return"
        if getattr(self, "__notes__", ()):
            # The note says what became of the stage, whose homing was interrupted.
            return saved
        if self.lifted is None:
            return f"{saved}; look whether the sensor is lifted" if self.gave_up else saved
        sensor = "the sensor is lifted" if self.lifted else "the sensor was NOT lifted: lift it by hand"
        return f"{sensor}; {saved}"


def undisturbed(say: Callable[[str], None]) -> Callable[[str], None]:
    """Return a function that passes a message on. An error of the receiver must not prevent the lift."""

    def tell(message: str) -> None:
        with contextlib.suppress(Exception):
            say(message)

    return tell


@dataclass(eq=False)
class Carriage:
    """The stage in the work frame of one block.

    Args:
        stage: The stage.
        frame: The block's work frame in the stage's coordinates.
        protocol: The protocol with clearance and depth limit.
        holder: The rim of the holder, over which the sensor travels.
        travel_mm_s: The speed at the travel height, on the way to it, and down through free air, in mm/s.
        approach_mm_s: The speed of every step near the block and in contact, in mm/s.
        may_home: Whether a stage that lost its position may be homed to lift the sensor, since homing moves upwards
            first.

    Attributes:
        noticed: Set when the thread of the run has noticed a signal or an error, and goes to its end by itself.
        rescued: Set when another thread has tried to lift the sensor.
        lifted: Whether the sensor was lifted at the end, or by the last retreat.
        position_kept: Whether the stage has neither failed nor been homed since the first press that no stored check
            has followed. Only then can a check say something about these presses.
    """

    stage: Stage
    frame: WorkFrame
    protocol: Protocol
    holder: HolderRim
    travel_mm_s: float = 20.0
    approach_mm_s: float = 2.0
    may_home: bool = False

    def __post_init__(self) -> None:
        self.travel_mm = travel_height_mm(self.protocol, self.holder)
        self.lowest_mm = -self.protocol.limits.depth_limit_mm
        #: The position that the stage reports, and the height that was last requested. They differ for a stage with
        #: coarse steps; steps smaller than its own add up only in the requested height.
        self.at: Point = self.frame.to_work(self.stage.position())
        self.aim_mm = self.at[2]
        self._interrupted, self._interruptions = "", itertools.count()
        self._lock = self.stage.lock if isinstance(self.stage, LimitedStage) else threading.RLock()
        self._owner = threading.get_ident()
        self._moving = self.lifted = False
        self.position_kept = True
        #: The threads that use the stage and that retreat.
        self._user: int | None = None
        self._retreating: int | None = None
        self.noticed, self.rescued = threading.Event(), threading.Event()

    def interrupt(self, reason: str) -> None:
        """Stop at once and leave the loop at its next move or frame. Signal handlers may call this method.

        A retreat that has begun is not interrupted.
        """
        self._interrupted = self._interrupted or reason
        if next(self._interruptions) == 0:
            self.halt()

    def go_on(self) -> None:
        """Allow motion again after an interruption."""
        self._interrupted, self._interruptions = "", itertools.count()
        self.noticed.clear()

    def check(self) -> None:
        """Leave the loop if a signal came.

        Raises:
            RunInterruptedError: A signal came.
        """
        if self._interrupted and self._retreating != threading.get_ident():
            if threading.get_ident() == self._owner:
                self.noticed.set()
            raise RunInterruptedError(self._interrupted)

    @property
    def is_in_use(self) -> bool:
        """Whether the thread of the run uses the stage at this moment."""
        return self._user == self._owner

    def over(self, x_mm: float, y_mm: float) -> None:
        """Move over a position of the block: up to the travel height, then sideways, then down to the travel height.

        The sideways move uses the travel height of the start or of the end, whichever is higher, since the slots of a
        tray may differ in height.

        Raises:
            RigError: The stage failed.
        """
        self.lift()
        self._go((x_mm, y_mm, max(self.travel_mm, self.at[2])), self.travel_mm_s)
        if self.at[2] > self.travel_mm + ROUNDING_MM:
            self._go((x_mm, y_mm, self.travel_mm), self.travel_mm_s)

    def lift(self) -> None:
        """Move straight up to the travel height, unless the sensor is already there or higher.

        Raises:
            RigError: The stage failed.
        """
        self.check()
        self._rise()

    def _rise(self) -> None:
        with self._alone():
            x, y, z = self.at = self.frame.to_work(self.stage.position())
        self.aim_mm = z
        if z < self.travel_mm - ROUNDING_MM:
            self._go((x, y, self.travel_mm), self.travel_mm_s)

    def to_height(self, z_mm: float, *, fast: bool = False) -> float:
        """Move straight up or down to a height of the work frame.

        Args:
            z_mm: The height.
            fast: Move at the travel speed instead of the approach speed.

        Returns:
            The height that the stage reports.

        Raises:
            OutOfRangeError: The height is below the depth limit, or the stage reports a height below it.
            RigError: The stage failed.
        """
        if not z_mm >= self.lowest_mm:
            raise OutOfRangeError(
                f"z = {z_mm:.3f} mm is below the depth limit, {self.lowest_mm:g} mm; check the height of the origin "
                "and that the gauge measures the sensor's force"
            )
        x, y, _ = self.at
        self._go((x, y, z_mm), self.travel_mm_s if fast else self.approach_mm_s)
        if self.at[2] < self.lowest_mm - ROUNDING_MM:
            raise OutOfRangeError(
                f"the stage reports z = {self.at[2]:.3f} mm, below the depth limit {self.lowest_mm:g} mm"
            )
        return self.at[2]

    def slide(self, end_mm: Point, speed_mm_s: float, begin: Callable[[], None]) -> None:
        """Move in contact along a straight line of the work frame.

        Args:
            end_mm: The end of the line.
            speed_mm_s: The speed.
            begin: Called when the move is about to begin and can already be stopped with :meth:`halt`.

        Raises:
            RigError: The stage failed or was stopped.
        """
        self._go(end_mm, speed_mm_s, begin)

    def halt(self) -> None:
        """Stop a move at once. Another thread than the one that moves the stage may call this method. Never raises."""
        if self._moving and not self._retreating:
            self.stage.stop()

    def home_again(self) -> Point | None:
        """Home the stage; see :func:`tacbench_cad.lab.rig.stage.home_again`.

        The caller sets ``position_kept`` once it has stored the result.

        Returns:
            The true position minus the reported position before, in mm of the work frame; None if it is unknown.

        Raises:
            RigError: The stage failed.
        """
        with self._in_motion():
            self.position_kept = False
            offset = home_again(self.stage)
            self.at = self.frame.to_work(self.stage.position())
        self.aim_mm = self.at[2]
        self.check()
        if offset is None:
            return None
        return self.frame.to_work(plus(self.frame.origin_mm, offset))

    def retreat(self, *, slipped: bool = False, say: Callable[[str], None] = lambda message: None) -> str:
        """Lift the sensor after a failure, if the stage still answers.

        A stage that is locked or lost its position cannot move to a height. It is homed instead if that is allowed,
        since homing begins upwards.

        Args:
            slipped: Whether a motor may have slipped. The reported height then proves nothing, so the stage is homed,
                or lifted by a clearance more.
            say: Receives a message if the stage does not answer and the lift is tried again.

        Returns:
            The problem, or an empty text once the sensor is lifted.
        """
        # The lift is tried twice, since the first attempt may receive the rest of the exchange that failed.
        home = [self._home_and_rise] if self.may_home else []
        ways = [*home, self._lift_more, self._rise] if slipped else [self._rise, self._rise, *home]
        self.lifted = False
        say, until, again = undisturbed(say), time.monotonic() + RETRY_S, False
        try:
            with self._retreat():
                while failed := _first_of(ways):
                    # A firmware that stands still may answer again. Meanwhile, drivers refuse an unknown position.
                    answers = [error for error in failed if not isinstance(error, PositionLostError)]
                    if not (answers and isinstance(answers[-1], NoAnswerError)) or time.monotonic() > until:
                        return f"the sensor was not lifted ({failed[-1]}): lift it by hand"
                    if not again:
                        say(f"the stage does not answer; trying to lift the sensor for {RETRY_S:g} s")
                    again = True
                    time.sleep(RETRY_PAUSE_S)
        except RigError as error:
            return f"the sensor was not lifted ({error}): lift it by hand"
        self.lifted = True
        return ""

    def rescue(self) -> str:
        """Lift the sensor in another thread than that of the run, unless that one goes to its end by itself.

        Returns:
            The problem, or an empty text.
        """
        try:
            with self._alone():
                return "" if self.noticed.is_set() else self.retreat()
        except RigError as error:
            return f"the sensor was not lifted ({error}): lift it by hand"
        finally:
            self.rescued.set()

    @contextlib.contextmanager
    def safely(self, say: Callable[[str], None]) -> Iterator[None]:
        """Lift the sensor after the body, also after an error.

        Args:
            say: Receives messages about the lift after an error.
        """
        try:
            yield
            self.lift()
            self.lifted = True
        except BaseException as error:
            self.noticed.set()
            say = undisturbed(say)
            if text := self.retreat(slipped=isinstance(error, ContactError), say=say):
                say(text)
            if isinstance(error, RunInterruptedError):
                error.lifted = self.lifted
            raise

    def _home_and_rise(self) -> None:
        """Home the stage. Homing an arm does not move it, so the sensor is lifted afterwards."""
        self.position_kept = False
        self.stage.home()
        self._rise()

    def _lift_more(self) -> None:
        """Lift by a clearance above the travel height."""
        x, y, z = self.at = self.frame.to_work(self.stage.position())
        self._go((x, y, max(z, self.travel_mm) + self.protocol.limits.clearance_mm), self.travel_mm_s)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Use the stage while no other thread does.

        Raises:
            RigError: Another thread uses the stage for too long, or the stage failed.
            RunInterruptedError: The stage failed because a signal came.
        """
        # Another thread may try again and again to lift the sensor.
        if not self._lock.acquire(timeout=DEVICE_S if self._retreating is None else RETRY_S + DEVICE_S):
            raise NoAnswerError("the stage does not return from an earlier call")
        before, self._user = self._user, threading.get_ident()
        try:
            yield
        except RigError:
            # A call that a signal interrupted ends in some error of the driver. The signal is the cause.
            self.check()
            self.position_kept = False
            raise
        finally:
            self._user = before
            self._lock.release()

    @contextlib.contextmanager
    def _retreat(self) -> Iterator[None]:
        with self._alone():
            before, self._retreating = self._retreating, threading.get_ident()
            try:
                yield
            finally:
                self._retreating = before

    @contextlib.contextmanager
    def _in_motion(self) -> Iterator[None]:
        with self._alone():
            # A signal from now on stops the stage.
            self._moving = True
            try:
                self.check()
                yield
            finally:
                self._moving = False

    def _go(self, target_mm: Point, speed_mm_s: float, begin: Callable[[], None] = lambda: None) -> None:
        with self._in_motion():
            begin()
            reported = self.stage.move(self.frame.to_stage(target_mm), speed_mm_s)
        self.at, self.aim_mm = self.frame.to_work(reported), target_mm[2]
        self.check()


def _first_of(ways: Sequence[Callable[[], None]]) -> list[RigError]:
    """Lift in the first way that succeeds; return the errors if none does."""
    errors: list[RigError] = []
    for way in ways:
        try:
            way()
        except RigError as error:
            errors.append(error)
        else:
            return []
    return errors
