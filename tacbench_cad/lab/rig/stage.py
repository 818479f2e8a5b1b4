"""The interface of a stage: three axes that move to a target and report their position. Some stages can also turn."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Protocol, Self, cast, runtime_checkable

from tacbench_cad.lab.rig.errors import OutOfRangeError
from tacbench_cad.lab.rig.track import StageTrack, TurnTrack
from tacbench_cad.lab.study.rotation import Turn, tilt
from tacbench_cad.lab.study.spec import Angles, Point, StageSettings
from tacbench_cad.util.errors import InputError

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


@runtime_checkable
class RotatingStage(Stage, Protocol):
    """A stage that can also turn the sensor, for instance an arm. These two methods are optional.

    The position of such a stage is that of the sensor's summit, also while the sensor is turned, and ``move`` keeps the
    orientation. Angles are those of :mod:`tacbench_cad.lab.study.rotation`, in the stage's frame: all are 0 while the
    sensor points straight down.

    A driver can have the optional method ``report_turns_to(receive)``. During every later turn, it then calls
    ``receive`` with the angles that its device reports. Without it, the angles are computed from the time.
    """

    def turn(
        self,
        angles_deg: Angles,
        speed_deg_s: float,
        *,
        above_mm: float = 0.0,
        by_mm: Point = (0.0, 0.0, 0.0),
    ) -> Angles:
        """Turn the sensor about a point on its axis, and wait until the stage reports that it has arrived.

        The turn is around one axis and at a constant speed. Meanwhile, the point moves in a straight line. Without
        ``above_mm`` and ``by_mm``, the summit stays at its place. With the radius of a dome as ``above_mm``, the sensor
        turns about the centre of the dome, and a suitable motion of the centre lets the dome roll.

        Args:
            angles_deg: The angles at the end.
            speed_deg_s: The speed of the turn, in degrees/s.
            above_mm: The distance of the point above the summit, along the sensor's axis.
            by_mm: The motion of the point, in mm of the stage's frame.

        Returns:
            The reported angles.

        Raises:
            RigError: One of its subclasses: alarm, reset, silence, unplugged, not arrived.
        """

    def rotation(self) -> Angles:
        """Return the reported angles in degrees."""


def inner(stage: Stage) -> Stage:
    """Return the stage behind its limits, which has the optional methods."""
    return stage.stage if isinstance(stage, LimitedStage) else stage


def can_turn(stage: Stage) -> bool:
    """Return whether a stage has the optional methods of a :class:`RotatingStage`."""
    return all(hasattr(inner(stage), name) for name in ("turn", "rotation"))


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


def no_report(at: Point | Angles) -> None:
    """Ignore a position or angles that a stage reports during a motion."""


@contextmanager
def tracked(stage: Stage, track: StageTrack) -> Iterator[None]:
    """Send what a stage reports while it moves or turns to a track, also for the devices that follow the stage."""
    is_turn = isinstance(track, TurnTrack)
    report_to = getattr(inner(stage), "report_turns_to" if is_turn else "report_to", lambda receive: None)
    if isinstance(stage, LimitedStage):
        stage.track = track
    report_to(track.report_angles if isinstance(track, TurnTrack) else track.report)
    try:
        yield
    finally:
        if isinstance(stage, LimitedStage):
            stage.track = None
        report_to(no_report)


class LimitedStage(Closing):
    """A stage with limits. It refuses targets beyond them before any command is sent.

    Args:
        stage: The stage.
        limits_mm: The lowest and highest x, y, z.
        tilt_limit_deg: The largest angle between the axis of the sensor and the vertical.

    Attributes:
        lock: Held during every call of the stage but ``stop`` and ``close``, so that only one thread uses it at a time.
    """

    def __init__(self, stage: Stage, limits_mm: Limits, tilt_limit_deg: float = StageSettings.tilt_limit_deg) -> None:
        self.stage = stage
        self.limits_mm = limits_mm
        self.tilt_limit_deg = tilt_limit_deg
        self.identity = stage.identity
        self.simulated = stage.simulated
        self.lock = threading.RLock()
        #: The present motion, if it is tracked; see :func:`tracked`.
        self.track: StageTrack | None = None

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
        """Return the position, for a device that follows the stage. During a tracked motion it may be an estimate.

        Another thread may call this method during a tracked motion.
        """
        return self.position() if self.track is None else self.track.now_mm()

    def followed_deg(self) -> Angles:
        """Return the angles as :meth:`followed_mm` returns the position."""
        return self.rotation() if self.track is None else self.track.now_deg()

    @property
    def is_tracked(self) -> bool:
        """Whether a motion is tracked at present."""
        return self.track is not None

    def turn(
        self,
        angles_deg: Angles,
        speed_deg_s: float,
        *,
        above_mm: float = 0.0,
        by_mm: Point = (0.0, 0.0, 0.0),
    ) -> Angles:
        """See :class:`RotatingStage`.

        Raises:
            OutOfRangeError: The end of the turn is beyond a limit. No command was sent.
            InputError: The speed is not positive, or the stage cannot turn the sensor.
        """
        stage = self._rotating
        if not (angle := tilt(angles_deg)) <= self.tilt_limit_deg + 1e-6:
            raise OutOfRangeError(
                f"the sensor would be tilted by {angle:.2f} degrees, beyond tilt_limit_deg = {self.tilt_limit_deg:g} "
                "of the stage; nothing was sent"
            )
        if not speed_deg_s > 0.0:
            raise InputError("speed_deg_s", speed_deg_s, "must be above 0")
        with self.lock:
            turn = Turn(
                summit_mm=stage.position(),
                from_deg=stage.rotation(),
                to_deg=angles_deg,
                above_mm=above_mm,
                by_mm=by_mm,
            )
            self._require_within(turn.at(1.0)[0])
            return stage.turn(angles_deg, speed_deg_s, above_mm=above_mm, by_mm=by_mm)

    def rotation(self) -> Angles:
        """See :class:`RotatingStage`."""
        with self.lock:
            return self._rotating.rotation()

    def stop(self) -> None:
        """See :class:`Stage`."""
        self.stage.stop()

    def close(self) -> None:
        """See :class:`Stage`."""
        self.stage.close()

    @property
    def _rotating(self) -> RotatingStage:
        if not can_turn(self.stage):
            raise InputError("[stage] driver", self.identity, "cannot turn the sensor")
        return cast(RotatingStage, self.stage)

    def _require_within(self, target_mm: Point) -> None:
        for axis, value, (low, high) in zip("xyz", target_mm, self.limits_mm, strict=True):
            # This comparison also refuses a NaN.
            if not low <= value <= high:
                raise OutOfRangeError(
                    f"stage {axis} = {value:.4f} mm: must be from {low:g} to {high:g} mm, its limits; nothing was sent"
                )
