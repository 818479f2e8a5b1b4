"""What the drivers of stages behind a serial port share, whichever firmware answers there."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Iterator
from typing import Generic, TypedDict, TypeVar

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.errors import PositionLostError, RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.stage import Closing
from tacbench_cad.lab.study.spec import Point

T = TypeVar("T")

#: How often an unexpected position is asked for again.
REPORTS = 4


class Link:
    """A line to a firmware, and whether the firmware still knows where the carriage is.

    Args:
        line: The open port.
        timeout_s: Longest silence that is waited through, in real seconds.

    Attributes:
        line: As given.
        timeout_s: As given.
        name: What is at the other end, for the messages.
        lost: Why the position of the carriage is unknown; empty while it is known.
        firmware: Name and version of the firmware; empty until it has answered.
    """

    def __init__(self, line: Line, timeout_s: float) -> None:
        self.line, self.timeout_s = line, timeout_s
        self.name = f"stage at {line.port}"
        self.lost = self.firmware = ""

    def require_known(self) -> None:
        """Refuse a move from an unknown position.

        Raises:
            PositionLostError: The position is unknown.
        """
        if self.lost:
            raise PositionLostError(f"{self.name}: the position is unknown: {self.lost}; home first")

    def reset_noticed(self, how: str) -> PositionLostError:
        """The error for a reset that came from elsewhere."""
        self.lost = "the firmware was reset (button, power dip or disturbance)"
        return PositionLostError(f"{self.name}: {how}: the position of the carriage is unknown; home first")


L = TypeVar("L", bound=Link)


class SerialOptions(TypedDict, total=False):
    """What every driver of a stage behind a serial port takes beside the port.

    Args:
        clock: Time of the rig; real time by default.
        baud: Symbols per second; the firmware's usual ones by default.
        timeout_s: Longest silence that is waited through, in real seconds; 10 by default.
        home_timeout_s: Longest homing (of Marlin: of one axis or two), in real seconds; 120 by default.
        simulated: What of it is simulated.
    """

    clock: Clock
    baud: int | None
    timeout_s: float
    home_timeout_s: float
    simulated: str


class SerialStage(Closing, Generic[L]):
    """A stage behind a serial port.

    Args:
        port: Path, name or pyserial URL.
        link: Makes the link of the firmware.
        bauds: The usual symbols per second.
        options: See :class:`SerialOptions`.
    """

    def __init__(
        self, port: str, link: Callable[[Line, float], L], bauds: tuple[int, ...], options: SerialOptions
    ) -> None:
        self.simulated = options.get("simulated", "")
        self._clock = options.get("clock", Clock())
        self._timeout_s = options.get("timeout_s", 10.0)
        self._home_timeout_s = options.get("home_timeout_s", 120.0)
        baud = options.get("baud")
        self._bauds = (baud,) if baud else bauds
        self._last: Point | None = None
        self._line = Line(port, baud=self._bauds[0], what="stage", write_timeout_s=min(self._timeout_s, 2.0))
        self._link = link(self._line, self._timeout_s)

    def stop(self) -> None:
        """See :class:`tacbench_cad.lab.rig.stage.Stage`."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the port. Never raises; a second call does nothing."""
        self._line.close()

    @contextlib.contextmanager
    def _opening(self) -> Iterator[None]:
        """Let go of the port if the body fails."""
        try:
            yield
        except BaseException:
            self.close()
            raise

    @contextlib.contextmanager
    def _moving(self) -> Iterator[None]:
        """Stop if the body is interrupted: no carriage must be left moving that nobody watches."""
        try:
            yield
        except RigError:
            raise
        except BaseException:
            self.stop()
            raise


def confirmed(read: Callable[[], T], is_expected: Callable[[T], bool]) -> T | None:
    """A report that is expected, or that comes twice in a row, since a single one may be damaged.

    Args:
        read: Asks for a report.
        is_expected: Whether a report is believed at once.

    Returns:
        The report, or None where each one was another.
    """
    report = read()
    for _ in range(REPORTS):
        if is_expected(report):
            return report
        before, report = report, read()
        if report == before:
            return report
    return None


def duration_s(start: Point, target: Point, speed_mm_s: float, rates_mm_s: Iterable[float]) -> float:
    """Longest time of a move, by its speed and by each axis's own greatest rate (0: not known)."""
    seconds = math.dist(start, target) / speed_mm_s
    for a, b, rate in zip(start, target, rates_mm_s, strict=True):
        if rate > 0.0:
            seconds = max(seconds, abs(b - a) / rate)
    return seconds


def is_near(at: Point, target: Point, tolerance_mm: Iterable[float]) -> bool:
    """Whether each coordinate lies within its tolerance."""
    return all(abs(a - b) <= near for a, b, near in zip(at, target, tolerance_mm, strict=True))


def place_text(at: Point) -> str:
    """A place for a message."""
    return "x {:.3f}, y {:.3f}, z {:.3f} mm".format(*at)
