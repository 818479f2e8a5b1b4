"""Conformance checks of a stage: units, blocking, limits, a stop in the middle of a move, and recovery."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from tacbench_cad.extensions.conformance.checks import SLACK_S, Checks, DriverCheck, check_close, check_interface
from tacbench_cad.lab.rig import RESULTS, Clock, Limits, RigError
from tacbench_cad.lab.study import Point
from tacbench_cad.util.errors import InputError, one_line

#: The allowed difference between a target and the reported position, in mm.
NEAR_MM = 0.05
#: The smallest move of a search, in mm, and the allowed error of its position.
SMALL_MM, SMALL_ERROR_MM = 0.02, 0.0101
#: The speed of the moves in mm/s.
SPEED_MM_S = 5.0
#: The number of attempts to stop in the middle of a move.
ATTEMPTS = 3
#: The speed of the move that is stopped, in mm/s.
STOPPED_MM_S = 1.0
#: A move may take this many times its distance divided by its speed, in addition to a delay in real time.
SLOWNESS = 3.0
#: The distance from the limits that is kept, in mm.
MARGIN_MM = 0.5
#: The factors by which a position in mm differs from one in another unit.
LENGTH_UNITS = {"metres": 0.001, "centimetres": 0.1, "inches": 1.0 / 25.4, "micrometres": 1000.0}


def check_stage(
    stage: Any, limits_mm: Limits, clock: Clock, *, distance_mm: float = 5.0, beyond_mm: Point | None = None
) -> Sequence[DriverCheck]:
    """Check a stage. It is homed, and moves by ``distance_mm`` along each axis.

    Args:
        stage: The open stage, without limits of its own in this program; it is closed at the end.
        limits_mm: The space in which it may move.
        clock: The rig's time.
        distance_mm: The length of the moves.
        beyond_mm: A position that the device itself must refuse; None if its refusal is not tested.

    Raises:
        InputError: The limits are too narrow.
    """
    for axis, (low, high) in zip("xyz", limits_mm, strict=True):
        if high - low < 2.0 * (distance_mm + MARGIN_MM):
            allowed = f"must be at least {2.0 * (distance_mm + MARGIN_MM):g} mm apart"
            raise InputError(f"limits_mm {axis}", [low, high], allowed)
    checks = Checks()
    if check_interface(checks, "stage", stage):
        kit = _Kit(checks, stage, limits_mm, clock, distance_mm)
        if kit.home("home"):
            with checks.step("move"):
                kit.moves()
            with checks.step("small move"):
                kit.small_move()
            kit.beyond(beyond_mm)
            kit.stop()
        with suppress(Exception):
            stage.stop()
        check_close(checks, "stage", stage)
    with suppress(Exception):
        stage.close()
    return checks.results


class _Kit:
    """The checks of one stage."""

    def __init__(self, checks: Checks, stage: Any, limits_mm: Limits, clock: Clock, distance_mm: float) -> None:
        self.checks, self.stage, self.clock = checks, stage, clock
        self.limits_mm, self.distance_mm = limits_mm, distance_mm
        self._attempts = 0

    def at(self) -> Point:
        position: Point = RESULTS["stage"]["position"](self.stage.position())
        return position

    def home(self, name: str) -> bool:
        """Home the stage and bring it inside of the limits."""
        with self.checks.step(name):
            self.stage.home()
            at = self.at()
            inside = tuple(
                min(max(value, low + MARGIN_MM), high - MARGIN_MM)
                for value, (low, high) in zip(at, self.limits_mm, strict=True)
            )
            if inside != at:
                self._moved(inside, 4.0 * SPEED_MM_S)
            self.checks.passed(name, "at x {:.3f}, y {:.3f}, z {:.3f} mm".format(*at))
        return self.checks.results[-1].result == "passed"

    def moves(self) -> None:
        """Move along each axis and back; look at direction, unit, speed and the end of the move."""
        waits: list[str] = []
        units: list[str] = []
        slow: list[str] = []
        took: list[float] = []
        ratio = 1.0
        for axis in range(3):
            start = self.at()
            target = self._target(start, axis, self.distance_mm)
            began_s = self.clock.now_s()
            result = self._moved(target, SPEED_MM_S)
            took_s = self.clock.now_s() - began_s
            took.append(took_s)
            least_s = abs(target[axis] - start[axis]) / SPEED_MM_S
            end = self.at()
            if took_s < 0.8 * least_s:
                waits.append(f"{'xyz'[axis]} after {took_s:.2f} of {least_s:.2f} s")
                end = self._rest(least_s)
            if (took_s - SLOWNESS * least_s) / self.clock.speed > SLACK_S:
                slow.append(f"{'xyz'[axis]} {took_s:.1f} instead of {least_s:.1f} s")
                break
            change = [b - a for a, b in zip(start, end, strict=True)]
            ratio = change[axis] / (target[axis] - start[axis])
            off = max(abs(b - a) for a, b in zip(target, end, strict=True))
            if off > NEAR_MM:
                units.append("{} by {:+.3f}, {:+.3f}, {:+.3f}".format("xyz"[axis], *change))
            elif math.dist(result, end) > NEAR_MM:
                waits.append(f"{'xyz'[axis]} returned another position than position()")
        unit = next((name for name, factor in LENGTH_UNITS.items() if abs(ratio / factor - 1.0) < 0.02), "")
        hint = f"; are these {unit}?" if unit else ""
        self.checks.passed("move", f"{max(took):.2f} s for {self.distance_mm:g} mm at {SPEED_MM_S:g} mm/s")
        bad = f"moves of {self.distance_mm:g} mm changed the reported position: {'; '.join(units)}{hint}"
        self.checks.require("unit", not units, "", bad)
        bad = f"move() returned before the stage had time to arrive: {'; '.join(waits)}"
        self.checks.require("blocking", not waits, "", bad)
        self.checks.require("speed", not slow, "", f"too slow, are these mm/min? {'; '.join(slow)}")

    def small_move(self) -> None:
        """Move by a step of the search; look at its accuracy and at the time of a move and of a question."""
        target = self._target(self.at(), 2, SMALL_MM)
        began_s = time.monotonic()
        end = self._moved(target, SPEED_MM_S)
        moved_s = time.monotonic() - began_s
        error_mm = abs(end[2] - target[2])
        shown = f"{SMALL_MM:g} mm with an error of {error_mm:.4f} mm"
        self.checks.require("small move", error_mm <= SMALL_ERROR_MM, shown, shown)
        began_s = time.monotonic()
        self.at()
        asked_s = time.monotonic() - began_s
        shown = f"small move {1000 * moved_s:.0f} ms, position() {1000 * asked_s:.0f} ms"
        self.checks.require("timing", moved_s <= SLACK_S and asked_s <= SLACK_S / 4.0, shown, shown)

    def beyond(self, target: Point | None) -> None:
        """Ask for a position that the device must refuse."""
        if target is None:
            self.checks.not_tested("limits", "needs a position beyond the device's own limits; name it with --beyond")
            return
        what = "a move to {:g}, {:g}, {:g}".format(*target)
        self.checks.refused("limits", lambda: self.stage.move(target, 4.0 * SPEED_MM_S), what)
        self.home("recovery")

    def stop(self) -> None:
        """Stop in the middle of a move, look at where the stage stands, and use it again."""
        # On a computer under heavy load, the stop may come when the move has ended.
        ready = False
        with self.checks.step("stop"):
            while not self._stop_in_time():
                self.stage.home()
            ready = True
        if ready and self.home("recovery"):
            with self.checks.step("recovery"):
                self._moved(self._target(self.at(), 0, 1.0), SPEED_MM_S)

    def _stop_in_time(self) -> bool:
        """Stop in the middle of a move. Return False, without a result, if the stop came too late.

        After the last attempt, a stop that came too late is a failed check.
        """
        self._attempts += 1
        start = self.at()
        target = self._target(start, 0, self.distance_mm)
        least_s = abs(target[0] - start[0]) / STOPPED_MM_S
        began_s, stopped_s = time.monotonic(), math.inf

        def stop() -> None:
            nonlocal stopped_s
            stopped_s = time.monotonic()
            self.stage.stop()

        try:
            with _later(0.4 * least_s / self.clock.speed, stop):
                self.stage.move(target, STOPPED_MM_S)
        except RigError as error:
            late_s = max(time.monotonic() - stopped_s, 0.0)
            shown = f"move() raised {type(error).__name__} {1000 * late_s:.0f} ms after stop()"
            # The position may be unknown after a stop, and then it must be refused.
            with suppress(RigError):
                self.clock.sleep(least_s)
                if math.dist(self.at(), target) <= NEAR_MM:
                    shown = ""
            self.checks.require("stop", shown != "" and late_s <= SLACK_S, shown, "the stage moved on to the target")
        except Exception as error:
            raised = f"raised {type(error).__name__} instead of a RigError: {one_line(error, 80)}"
            self.checks.failed("stop", f"move() after stop(): {raised}")
        else:
            due_s = began_s + least_s / self.clock.speed
            if (
                stopped_s > began_s + 0.8 * (due_s - began_s)
                and time.monotonic() >= due_s
                and self._attempts < ATTEMPTS
            ):
                return False
            self.checks.failed("stop", "move() ended at its target as if stop() had not been called")
        return True

    def _moved(self, target: Any, speed_mm_s: float) -> Point:
        position: Point = RESULTS["stage"]["move"](self.stage.move(target, speed_mm_s))
        return position

    def _rest(self, least_s: float) -> Point:
        """Return the position after the time that the move needs, once it no longer changes."""
        self.clock.sleep(2.0 * least_s)
        return self.at()

    def _target(self, start: Point, axis: int, distance_mm: float) -> Point:
        """Return a target inside of the limits, along one axis; upwards if there is room."""
        _, high = self.limits_mm[axis]
        step = distance_mm if start[axis] + distance_mm <= high else -distance_mm
        x, y, z = (value + (step if i == axis else 0.0) for i, value in enumerate(start))
        return (x, y, z)


@contextmanager
def _later(seconds: float, call: Callable[[], None]) -> Iterator[None]:
    """Call a function during the body, in a signal handler if there are signals, as Ctrl-C does."""
    if not hasattr(signal, "setitimer") or threading.current_thread() is not threading.main_thread():
        timer = threading.Timer(seconds, call)
        timer.start()
        try:
            yield
        finally:
            timer.cancel()
        return
    before = signal.signal(signal.SIGALRM, lambda *_: call())
    signal.setitimer(signal.ITIMER_REAL, max(seconds, 1e-3))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
