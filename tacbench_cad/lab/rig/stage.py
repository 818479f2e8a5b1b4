"""What a stage is: three axes that go where they are told and say where they are."""

from __future__ import annotations

from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from tacbench_cad.lab.rig.errors import OutOfRangeError
from tacbench_cad.lab.study.spec import Point
from tacbench_cad.util.errors import InputError

Limits = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]


class Device(Protocol):
    """What stages, gauges and sensors share: they are let go of in the end, as context managers too."""

    def close(self) -> None:
        """Let go of the device. Never raises; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class Closing(Device):
    """Makes a context manager of anything with ``close``."""


@runtime_checkable
class Stage(Device, Protocol):
    """A three-axis stage, in mm of its own frame with z upwards.

    A driver opens its device when it is made: it is then connected and identified, and homed if asked to be.

    Attributes:
        identity: Driver, firmware with version, and port, for people and for ``run.json``.
        simulated: What of it is simulated, or an empty text.
    """

    identity: str
    simulated: str

    def home(self) -> None:
        """Find the end stops, z first upwards; afterwards the position is known."""

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """Go there in a straight line and wait until the stage itself reports that it stands there.

        Args:
            target_mm: Where to, x, y and z in mm of the stage's frame.
            speed_mm_s: How fast along the line, in mm/s.

        Returns:
            The reported position in mm.

        Raises:
            RigError: By its subclass: alarm, reset, silence, unplugged, not arrived.
        """

    def position(self) -> Point:
        """The reported position in mm."""

    def stop(self) -> None:
        """Stop all motion at once. May be called from a signal handler, in the middle of another call; never raises."""


class LimitedStage(Closing):
    """A stage that refuses targets beyond its limits before anything is sent.

    Args:
        stage: The stage.
        limits_mm: Lowest and highest x, y, z.
    """

    def __init__(self, stage: Stage, limits_mm: Limits) -> None:
        self.stage = stage
        self.limits_mm = limits_mm
        self.identity = stage.identity
        self.simulated = stage.simulated

    def home(self) -> None:
        """See :class:`Stage`."""
        self.stage.home()

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        """See :class:`Stage`.

        Raises:
            OutOfRangeError: The target lies beyond a limit; nothing was sent.
            InputError: The speed is not positive.
        """
        for axis, value, (low, high) in zip("xyz", target_mm, self.limits_mm, strict=True):
            # Written so that a NaN is refused too.
            if not low <= value <= high:
                raise OutOfRangeError(
                    f"stage {axis} = {value:.4f} mm: beyond its limits, {low:g} to {high:g} mm; nothing was sent"
                )
        if not speed_mm_s > 0.0:
            raise InputError("speed_mm_s", speed_mm_s, "must be above 0")
        return self.stage.move(target_mm, speed_mm_s)

    def position(self) -> Point:
        """See :class:`Stage`."""
        return self.stage.position()

    def stop(self) -> None:
        """See :class:`Stage`."""
        self.stage.stop()

    def close(self) -> None:
        """See :class:`Stage`."""
        self.stage.close()
