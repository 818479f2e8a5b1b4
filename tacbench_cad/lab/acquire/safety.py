"""What keeps sensor and block unharmed: bounds on every move, the lift after any failure, and signals.

The carriage is the only thing in the press loop that moves the stage. It works in the work frame, where z = 0 is the
block's highest point.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FrameType
from typing import Any

from tacbench_cad.lab.rig.errors import DepthLimitError, RigError
from tacbench_cad.lab.rig.reach import travel_height_mm
from tacbench_cad.lab.rig.stage import Stage
from tacbench_cad.lab.study.spec import HolderRim, Point, Protocol, WorkFrame
from tacbench_cad.util.text import counted

#: How far below the depth limit a reported height may lie: the rounding of firmware that reports micrometres.
ROUNDING_MM = 0.002


class RunInterruptedError(KeyboardInterrupt):
    """A signal ended a run, which can be resumed.

    Attributes:
        signal: ``SIGINT``, ``SIGTERM`` or ``SIGHUP``.
        lifted: Whether the sensor is lifted off the block.
        saved: Presses of the study that are on the disk.
        planned: Presses that it will have.
    """

    def __init__(self, signal: str) -> None:
        super().__init__(signal)
        self.signal, self.lifted = signal, True
        self.saved = self.planned = 0

    def __str__(self) -> str:
        sensor = "the sensor is lifted" if self.lifted else "the sensor was NOT lifted: lift it by hand"
        return f"{sensor}; {self.saved} of {counted(self.planned, 'press')} are saved"


@dataclass(eq=False)
class Carriage:
    """The stage in the work frame of one block.

    Args:
        stage: The stage.
        frame: The block's work frame in the stage's.
        protocol: Clearance and depth limit.
        holder: The rim that is travelled over.
        travel_mm_s: Speed at and to the travel height.
        approach_mm_s: Speed of every step downwards.
        may_home: Whether a stage that lost its position may be homed to lift the sensor: homing goes upwards first.
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
        self.lowest_mm = -self.protocol.depth_limit_mm
        #: Where the stage reports the sensor, and the height that it was last sent to: a stage with coarse steps
        #: does not report what it was sent to, and steps that are smaller than its own add up only in the latter.
        self.at: Point = self.frame.to_work(self.stage.position())
        self.aim_mm = self.at[2]
        self._moving = self._retreating = False
        self._interrupted = ""

    def interrupt(self, reason: str) -> None:
        """Stop at once; the loop is left at its next move or frame. Made for signal handlers.

        A retreat that is under way is not disturbed.
        """
        self._interrupted = self._interrupted or reason
        if self._moving and not self._retreating:
            self.stage.stop()

    def check(self) -> None:
        """Leave the loop if a signal came.

        Raises:
            RunInterruptedError: It did.
        """
        if self._interrupted and not self._retreating:
            raise RunInterruptedError(self._interrupted)

    def over(self, x_mm: float, y_mm: float) -> None:
        """Go above a place of the block: up to the travel height first, then sideways, then down to it from above.

        Sideways goes at the height of the start or of the end, whichever is higher: the slots of a tray need not be
        level.

        Raises:
            RigError: The stage failed.
        """
        self.lift()
        self._go((x_mm, y_mm, max(self.travel_mm, self.at[2])), self.travel_mm_s)
        if self.at[2] > self.travel_mm + ROUNDING_MM:
            self._go((x_mm, y_mm, self.travel_mm), self.travel_mm_s)

    def lift(self) -> None:
        """Go straight up to the travel height, if the sensor is not there or higher.

        Raises:
            RigError: The stage failed.
        """
        x, y, z = self.at = self.frame.to_work(self.stage.position())
        self.aim_mm = z
        if z < self.travel_mm - ROUNDING_MM:
            self._go((x, y, self.travel_mm), self.travel_mm_s)

    def to_height(self, z_mm: float) -> float:
        """Go straight up or down to a height of the work frame.

        Returns:
            The height that the stage reports.

        Raises:
            DepthLimitError: It lies below the depth limit; nothing was sent. Or the stage went there by itself.
            RigError: The stage failed.
        """
        if not z_mm >= self.lowest_mm:
            raise DepthLimitError(
                f"z = {z_mm:.3f} mm lies below the depth limit, {self.lowest_mm:g} mm; is the origin's height right, "
                "and does the gauge feel the sensor?"
            )
        x, y, _ = self.at
        self._go((x, y, z_mm), self.approach_mm_s)
        if self.at[2] < self.lowest_mm - ROUNDING_MM:
            raise DepthLimitError(f"the stage reports z = {self.at[2]:.3f} mm, below the limit {self.lowest_mm:g} mm")
        return self.at[2]

    def retreat(self) -> str:
        """Lift the sensor after a failure, if the stage still answers.

        A stage that is locked or lost its position cannot be sent to a height; where it may be homed it is, since
        homing begins upwards.

        Returns:
            What went wrong, or an empty text once the sensor is lifted.
        """
        self._retreating = True
        # A second try: the first one may find the rest of the exchange that failed.
        ways = [self.lift, self.lift, *([self.stage.home] if self.may_home else [])]
        failed = ""
        try:
            for way in ways:
                try:
                    way()
                except RigError as error:
                    failed = f"the sensor was not lifted ({error}): lift it by hand"
                else:
                    return ""
            return failed
        finally:
            self._retreating = False

    @contextlib.contextmanager
    def safely(self, say: Callable[[str], None]) -> Iterator[None]:
        """Whatever ends the body, the sensor is lifted after it.

        Args:
            say: Is told where the lift failed.
        """
        try:
            yield
            self.lift()
        except BaseException as error:
            failed = self.retreat()
            if failed:
                say(failed)
            if isinstance(error, RunInterruptedError):
                error.lifted = not failed
            raise

    def _go(self, target_mm: Point, speed_mm_s: float) -> None:
        self.check()
        self._moving = True
        try:
            reported = self.stage.move(self.frame.to_stage(target_mm), speed_mm_s)
        except RigError:
            # A move that a signal cut short ends in some error of the driver: the signal is the reason.
            self.check()
            raise
        finally:
            self._moving = False
        self.at, self.aim_mm = self.frame.to_work(reported), target_mm[2]
        self.check()


class Signals:
    """Turns SIGINT, SIGTERM and SIGHUP into an orderly end.

    While a block is pressed they go to the carriage, which stops; at any other time (a question to the user, devices
    being opened) they raise :class:`RunInterruptedError` at once. Outside of the main thread nothing is caught.
    """

    def __init__(self) -> None:
        self._carriage: Carriage | None = None
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> Signals:
        if threading.current_thread() is threading.main_thread():
            names = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
            for number in (getattr(signal, name) for name in names):
                self._previous[number] = signal.signal(number, self._caught)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._previous.clear()

    @contextlib.contextmanager
    def sent_to(self, carriage: Carriage) -> Iterator[None]:
        """Give the signals to a carriage while the body runs."""
        self._carriage = carriage
        try:
            yield
        finally:
            self._carriage = None

    def _caught(self, number: int, _: FrameType | None) -> None:
        name = signal.Signals(number).name
        if self._carriage is None:
            raise RunInterruptedError(name)
        self._carriage.interrupt(name)
