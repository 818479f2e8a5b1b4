"""Teaching of the work frame: a person moves to the markers of the jig, and a frame is fitted to them and stored."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tacbench_cad.lab.rig.errors import OutOfRangeError, RigError
from tacbench_cad.lab.rig.stage import Limits, Stage
from tacbench_cad.lab.study.editing import store_keys
from tacbench_cad.lab.study.spec import Point, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.types import Floats

#: The allowed distance between a taught marker and its place in the fitted frame, in mm. A person centres a pointer in
#: a 1.5 mm hole to about 0.2 mm by eye; a wrong marker is off by at least one grid spacing, 1.25 mm.
TOLERANCE_MM = 0.3
#: The longest step of one typed line, in mm, so that a typing error cannot drive the sensor past the holder.
MAX_STEP_MM = 20.0
#: The longest step downwards, in mm.
MAX_DOWN_MM = 2.0
#: With a gauge, a step downwards is split into pieces of at most this length, in mm. The force is read after each one.
_PIECE_MM = 0.5
#: The lift between two markers, in mm.
LIFT_MM = 5.0
#: The force, in N, above which a step down is undone.
TOUCH_LIMIT_N = 1.0
#: The spacing of the samples in the search for the block's highest point, in mm.
_SAMPLE_MM = 0.05
#: Samples within this height below the highest one count as equally high, in mm; a person cannot feel less.
_EQUAL_MM = 0.01
_STEP = r"([xyz]) ?([+-]?(?:\d+(?:\.\d*)?|\.\d+))(?: |$)"
#: The decimals of the origin in the file: 0.1 micrometres.
_DECIMALS = 4

Ask = Callable[[str], str]
Say = Callable[[str], None]

#: The help text for the person who teaches the frame.
HELP = (
    "x 1.5   move by 1.5 mm along x (y and z likewise; several on one line: x 1 y -0.2)\n"
    f"up      lift by {LIFT_MM:g} mm\n"
    "ok      confirm this position\n"
    "Enter   repeat the last step\n"
    "quit    stop, store nothing"
)


@dataclass(frozen=True, kw_only=True)
class FittedFrame:
    """A work frame that was fitted to the taught markers.

    Args:
        frame: Origin and quarter turns; its z is the mean z of the markers.
        distances_mm: The distance of each taught marker from its place in the frame, in mm.
        turn_deg: The remaining rotation beyond the quarter turns, in degrees, counter-clockwise.
        stretch: The distances between the taught markers divided by those on the jig.
    """

    frame: WorkFrame
    distances_mm: tuple[float, ...]
    turn_deg: float
    stretch: float

    @property
    def worst_mm(self) -> float:
        """The largest distance."""
        return max(self.distances_mm)

    def require_within(self, tolerance_mm: float) -> None:
        """Check that the fit is good enough for pressing.

        Raises:
            CheckFailedError: A marker is further off than the tolerance. The message names the likely cause.
        """
        if self.worst_mm <= tolerance_mm:
            return
        if abs(self.stretch - 1.0) > 0.1:
            reason = (
                f"the taught markers are {self.stretch:.3g} times as far apart as on the jig. Check that these were "
                "the right markers and that the stage's steps per mm are right"
            )
        elif abs(self.turn_deg) > 2.0:
            reason = f"the holder is rotated by {self.turn_deg:.2g} degrees against the stage's axes. Align it"
        else:
            reason = "Check that these were the right markers and that the jig is pushed fully onto the holder"
        raise CheckFailedError(
            f"a marker is {self.worst_mm:.3g} mm away from its place in the fitted frame, more than the tolerance of "
            f"{tolerance_mm:g} mm; nothing is stored: {reason}"
        )


def corner_markers(grid: PressGrid) -> tuple[tuple[int, float, float], ...]:
    """Return the number, x and y of the four corner positions: 1, 5, 21 and 25 of the paper's grid.

    Raises:
        InputError: The grid has only one position, which does not show the rotation of the block.
    """
    if len(grid.positions_mm) < 2:
        allowed = "has only one position, which does not show how the block is turned; align with a larger grid"
        raise InputError("[protocol.positions] grid", None, allowed)
    across = len(grid.x_mm)
    numbers = (1, across, across * (len(grid.y_mm) - 1) + 1, across * len(grid.y_mm))
    places = grid.positions_mm
    return tuple((number, float(places[number - 1][0]), float(places[number - 1][1])) for number in numbers)


def fit_frame(markers_mm: Sequence[tuple[float, float]], taught_mm: Sequence[Point]) -> FittedFrame:
    """Fit the frame whose markers lie closest to the taught positions, by least squares.

    For each of the four quarter turns R, the best origin is the mean of s - R m. The turn with the smallest sum of
    squares is used. The remaining errors are described by the turn and stretch of the best similarity (Umeyama, in the
    plane: with complex m and s relative to their means, ``sum(conj(m) s) / sum(|m|^2)``).

    Args:
        markers_mm: Two or more points in the block's frame.
        taught_mm: The stage's position at each of them.
    """
    m = np.array([complex(x, y) for x, y in markers_mm])
    s = np.array([complex(x, y) for x, y, _ in taught_mm])
    z = float(np.mean([point[2] for point in taught_mm]))

    def distances(turns: int) -> Floats:
        off = s - m * 1j**turns
        return np.asarray(np.abs(off - off.mean()), dtype=np.float64)

    turns = min(range(4), key=lambda quarter: float(np.sum(distances(quarter) ** 2)))
    origin = complex(np.mean(s - m * 1j**turns))
    centred = (m - m.mean()) * 1j**turns
    similarity = complex(np.sum(np.conj(centred) * (s - s.mean())) / np.sum(np.abs(centred) ** 2))
    return FittedFrame(
        frame=WorkFrame(origin_mm=(origin.real, origin.imag, z), quarter_turns=turns),
        distances_mm=tuple(float(distance) for distance in distances(turns)),
        turn_deg=math.degrees(math.atan2(similarity.imag, similarity.real)),
        stretch=abs(similarity),
    )


def highest_point_mm(block: Block) -> tuple[float, float]:
    """Return x and y of a block's highest point, in mm. Of several, it is the one closest to the block's centre."""
    width, depth = block.size_mm
    x = np.linspace(0.0, width, math.ceil(width / _SAMPLE_MM) + 1)
    y = np.linspace(0.0, depth, math.ceil(depth / _SAMPLE_MM) + 1)
    heights = block.height_at(x[None, :], y[:, None])
    if block.region is not None:
        heights = np.where(block.region.distance(x[None, :], y[:, None]) <= 0.0, heights, -np.inf)
    rows, columns = np.nonzero(heights >= heights.max() - _EQUAL_MM)
    best = int(np.argmin((x[columns] - width / 2.0) ** 2 + (y[rows] - depth / 2.0) ** 2))
    return float(x[columns[best]]), float(y[rows[best]])


@dataclass(kw_only=True)
class Teaching:
    """A dialogue in which a person moves the stage with typed lines and confirms positions.

    Args:
        stage: The stage, homed.
        limits_mm: The limits of the stage.
        ask: Shows a prompt and returns the typed line.
        say: Shows a line.
        travel_mm_s: The speed of moves to the next marker, in mm/s.
        approach_mm_s: The speed of every typed step, in mm/s.
        force_n: Reads the contact force if there is a gauge. A step down that presses too hard is then undone.
        may_home: Whether a stage that lost its position may be homed to lift the sensor, since homing moves upwards
            first.
        uninterrupted: Creates a context in which no signal interrupts the lift after an error.
    """

    stage: Stage
    limits_mm: Limits
    ask: Ask
    say: Say
    travel_mm_s: float
    approach_mm_s: float
    force_n: Callable[[], float] | None = None
    may_home: bool = False
    uninterrupted: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext
    #: The reason why the sensor could not be lifted at the end; empty if it is lifted.
    not_lifted: str = field(default="", init=False)

    def frame(self, protocol: Protocol, block: Block, tolerance_mm: float) -> FittedFrame:
        """Teach a frame: four markers for x, y and the turn, then the block's highest point for z.

        The stage is lifted at the end, also after an error, if it still answers.

        Args:
            protocol: The protocol. Its press grid must be that of the jig.
            block: The block in the first slot.
            tolerance_mm: The allowed distance of a marker from its place in the frame, in mm.

        Raises:
            CheckFailedError: The markers do not fit.
            InputError: The person typed "quit".
            RigError: The stage failed.
        """
        try:
            return self._teach(protocol, block, tolerance_mm)
        except BaseException:
            # After any error, the sensor must not stay pressed against the block.
            with self.uninterrupted():
                self._retreat()
            raise

    def _teach(self, protocol: Protocol, block: Block, tolerance_mm: float) -> FittedFrame:
        self.say("Put the jig on. Replace the sensor by a pointer on the same axis. Commands:\n" + HELP)
        markers = corner_markers(protocol.positions.grid)
        taught: list[Point] = []
        for number, x, y in markers:
            if len(taught) >= 2:
                known = [(mx, my) for _, mx, my in markers[: len(taught)]]
                ahead = fit_frame(known, taught).frame.to_stage((x, y, 0.0))
                self._across(ahead[0], ahead[1])
            taught.append(self._jog(f"marker {number} (x {x:g}, y {y:g} mm on the block): centre the pointer on it"))
            self._lift(LIFT_MM)
        fit = fit_frame([(x, y) for _, x, y in markers], taught)
        for (number, _, _), distance in zip(markers, fit.distances_mm, strict=True):
            self.say(f"marker {number}: {distance:.3f} mm away from its fitted position")
        fit.require_within(tolerance_mm)
        self.lift_off()
        self._wait_for_ok("Remove the jig and the pointer, and mount the sensor. Then type ok.")
        x, y = highest_point_mm(block)
        ahead = fit.frame.to_stage((x, y, 0.0))
        self._across(ahead[0], ahead[1])
        z = self._jog("the block's highest point: go down until the sensor just touches it")[2]
        self.lift_off()
        return replace(fit, frame=replace(fit.frame, origin_mm=(*fit.frame.origin_mm[:2], z)))

    def lift_off(self) -> None:
        """Lift the sensor to the upper limit."""
        x, y, _ = self.stage.position()
        self.stage.move((x, y, self.limits_mm[2][1]), self.travel_mm_s)

    def _retreat(self) -> None:
        """Lift the sensor after an error, if the stage still answers."""
        # The lift is tried twice, since the first attempt may receive the rest of the exchange that failed.
        for way in (self.lift_off, self.lift_off, *([self.stage.home] if self.may_home else [])):
            try:
                way()
            except RigError as error:
                self.not_lifted = f"the sensor was NOT lifted ({error}): lift it by hand"
            else:
                self.not_lifted = ""
                return

    def _lift(self, by_mm: float) -> None:
        x, y, z = self.stage.position()
        self.stage.move((x, y, min(z + by_mm, self.limits_mm[2][1])), self.approach_mm_s)

    def _across(self, x: float, y: float) -> None:
        self.stage.move((x, y, self.stage.position()[2]), self.travel_mm_s)

    def _jog(self, what: str) -> Point:
        """Let the person move the stage until they type "ok", and return the stage's position."""
        self.say(what)
        step: Point | None = None
        while True:
            here = x, y, z = self.stage.position()
            force = "" if self.force_n is None else f", {self.force_n():z.3f} N"
            words = self.ask(f"[{x:z.3f} {y:z.3f} {z:z.3f} mm{force}] ").split()
            if words == ["ok"]:
                return here
            if words == ["quit"]:
                raise InputError("align", "quit", "stopped; nothing is stored")
            if words == ["up"]:
                self._lift(LIFT_MM)
                continue
            try:
                step = step if step is not None and not words else parse_step(words)
                self._step(here, step)
            except (InputError, OutOfRangeError) as error:
                self.say(str(error))

    def _step(self, here: Point, step: Point) -> None:
        """Make a step and read the force on the way down. The whole step is undone if it presses too hard."""
        force_n = self.force_n if step[2] < 0.0 else None
        pieces = 1 if force_n is None else math.ceil(-step[2] / _PIECE_MM)
        for piece in range(1, pieces + 1):
            x, y, z = (a + b * piece / pieces for a, b in zip(here, step, strict=True))
            self.stage.move((x, y, z), self.approach_mm_s)
            if force_n is not None and force_n() > TOUCH_LIMIT_N:
                self.stage.move(here, self.approach_mm_s)
                self.say(f"the force exceeded {TOUCH_LIMIT_N:g} N, so the step was undone; take smaller steps")
                return

    def _wait_for_ok(self, prompt: str) -> None:
        while (word := self.ask(prompt + " ").strip()) != "ok":
            if word == "quit":
                raise InputError("align", "quit", "stopped; nothing is stored")


def parse_step(words: Sequence[str]) -> Point:
    """Return the step that a typed line describes: ``x 1 y -0.2`` is (1, -0.2, 0) mm.

    Raises:
        InputError: The line is not a step, or a step is too long.
    """
    line = " ".join(words)
    if not re.fullmatch(f"(?:{_STEP})+", line):
        raise InputError("step", line, "must be x, y or z with a distance in mm, or one of: up, ok, quit")
    step = {"x": 0.0, "y": 0.0, "z": 0.0}
    for axis, text in re.findall(_STEP, line):
        step[axis] += float(text)
    if max(abs(length) for length in step.values()) > MAX_STEP_MM or step["z"] < -MAX_DOWN_MM:
        raise InputError(
            "step", line, f"is too long; the limit is {MAX_STEP_MM:g} mm, and {MAX_DOWN_MM:g} mm downwards"
        )
    return (step["x"], step["y"], step["z"])


def store_frame(path: Path, frame: WorkFrame) -> None:
    """Write the origin and the quarter turns into a study's ``[stage]`` and leave the rest, also comments, unchanged.

    Raises:
        InputError: The file cannot be edited safely. The message contains the lines to write by hand.
    """
    origin = [round(value, _DECIMALS) + 0.0 for value in frame.origin_mm]
    store_keys(path, "stage", {"origin_mm": origin, "quarter_turns": frame.quarter_turns})
