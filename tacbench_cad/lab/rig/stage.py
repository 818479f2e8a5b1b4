"""The interface of a stage: three axes that move to a target and report their position."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from tacbench_cad.lab.rig.errors import OutOfRangeError
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import InputError

#: The lowest and the highest position of each axis, in mm.
Limits = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


class Device(Protocol):
    """The common part of stages, gauges and sensors. They can be closed, and are context managers."""

    def close(self) -> None:
        """Close the device. Never raises; a second call has no effect."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Closing(Device):
    """A base class that makes a context manager of any class, with a ``close`` that has nothing to do."""

    def close(self) -> None:
        """See :class:`Device`."""
        return


@runtime_checkable
class Stage(Device, Protocol):
    """A three-axis stage, in mm of its own frame, with z upwards.

    A driver opens its device when it is created: the device is then connected and identified. :meth:`home` is separate.

    A driver can have the optional method ``report_to(receive)``. During every later move, it then calls ``receive``
    with each position that its device reports. Without it, the positions during a slide are computed from the time.

    Attributes:
        identity: Driver, firmware with version, and port, for people and for ``run.json``.
        simulated: The simulated part, or an empty text.
    """

    identity: str
    simulated: str

    def home(self) -> None:
        """Find the end stops, z first and upwards. Afterwards the position is known."""

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Move to a position in a straight line and wait until the stage reports that it has arrived.

        Args:
            target_mm: The target x, y and z in mm of the stage's frame.
            speed_mm_s: The speed along the line, in mm/s.

        Returns:
            The reported position in mm.

        Raises:
            RigError: One of its subclasses: alarm, reset, silence, unplugged, not arrived.
        """

    def position(self) -> Point:
        """Return the reported position in mm."""

    def stop(self) -> None:
        """Stop all motion at once. Signal handlers may call this during another call. Never raises."""


def inner(stage: Stage) -> Stage:
    """Return the stage behind its limits, which has the optional methods."""
    return stage.stage if isinstance(stage, LimitedStage) else stage


def home_again(stage: Stage) -> Point | None:
    """Home a stage, and return the error that its position had before.

    A stage can have the optional method ``home_offset_mm()``, which measures the error at the end stops and homes.

    Returns:
        The true position minus the reported position in mm; None if the stage cannot measure it.

    Raises:
        RigError: The stage failed.
    """
    measure = getattr(stage, "home_offset_mm", None)
    if measure is None:
        stage.home()
        return None
    offset = measure()
    if offset is None:
        return None
    x, y, z = (float(value) for value in offset)
    return (x, y, z)


def measures_offset(stage: Stage) -> bool:
    """Return whether a stage has the optional method ``home_offset_mm()``."""
    return hasattr(inner(stage), "home_offset_mm")


def no_report(at: Point) -> None:
    """Ignore a position that a stage reports during a motion."""


class LimitedStage(Closing):
    """A stage with limits. It refuses targets beyond them before any command is sent.

    Args:
        stage: The stage.
        limits_mm: The lowest and highest x, y, z.

    Attributes:
        lock: Held during every call of the stage but ``stop`` and ``close``, so that only one thread uses it at a time.
        moving_mm: Returns an estimate of the position during a motion that another thread records; None otherwise.
    """

    def __init__(self, stage: Stage, limits_mm: Limits) -> None:
        self.stage = stage
        self.limits_mm = limits_mm
        self.identity = stage.identity
        self.simulated = stage.simulated
        self.lock = threading.RLock()
        self.moving_mm: Callable[[], Point] | None = None

    def home(self) -> None:
        """See :class:`Stage`."""
        with self.lock:
            self.stage.home()

    def home_offset_mm(self) -> Point | None:
        """See :func:`home_again`."""
        with self.lock:
            return home_again(self.stage)

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """See :class:`Stage`.

        Raises:
            OutOfRangeError: The target is beyond a limit. No command was sent.
            InputError: The speed is not positive.
        """
        self._require_within(target_mm)
        if not speed_mm_s > 0.0:
            raise InputError("speed_mm_s", speed_mm_s, "must be above 0")
        with self.lock:
            return self.stage.move(target_mm, speed_mm_s)

    def position(self) -> Point:
        """See :class:`Stage`."""
        with self.lock:
            return self.stage.position()

    def followed_mm(self) -> Point:
        """Return the position, for a device that follows the stage. Another thread may call this during a motion."""
        return self.position() if self.moving_mm is None else self.moving_mm()

    def stop(self) -> None:
        """See :class:`Stage`."""
        self.stage.stop()

    def close(self) -> None:
        """See :class:`Stage`."""
        self.stage.close()

    def _require_within(self, target_mm: Point) -> None:
        for axis, value, (low, high) in zip("xyz", target_mm, self.limits_mm, strict=True):
            # This comparison also refuses a NaN.
            if not low <= value <= high:
                raise OutOfRangeError(
                    f"stage {axis} = {value:.4f} mm: must be from {low:g} to {high:g} mm, its limits; nothing was sent"
                )
