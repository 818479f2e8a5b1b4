"""Teaching the work frame with the jig: markers touched by hand, a frame fitted to them, and stored in the file."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tacbench_cad.lab.rig.errors import OutOfRangeError
from tacbench_cad.lab.rig.stage import Limits, Stage
from tacbench_cad.lab.study.spec import Point, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util import door
from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError
from tacbench_cad.util.files import write_text
from tacbench_cad.util.types import Floats

#: How far a touched marker may lie from where the fitted frame has it, in mm. A pointer is centred in a 1.5 mm hole
#: by eye to about 0.2 mm; a wrong marker is off by a spacing, 1.25 mm or more.
TOLERANCE_MM = 0.3
#: Longest step of one typed line, in mm, so that a slip of the finger ends before the holder.
LONGEST_STEP_MM = 20.0
#: Longest step downwards.
LONGEST_DOWN_MM = 2.0
#: With a gauge a step downwards is made in pieces no longer than this, and the force is looked at after each.
_PIECE_MM = 0.5
#: Lift between two markers, in mm.
LIFT_MM = 5.0
#: Force at which a step down is taken back, in newtons.
TOUCH_LIMIT_N = 1.0
#: Distance of the samples on which the block's highest point is looked for, in mm.
_SAMPLE_MM = 0.05
#: Samples that are so little lower than the highest one count as equally high, in mm: below what a touch can tell.
_EQUAL_MM = 0.01
_STEP = r"([xyz]) ?([+-]?(?:\d+(?:\.\d*)?|\.\d+))(?: |$)"
#: Decimals of the origin in the file: 0.1 micrometres.
_DECIMALS = 4

Ask = Callable[[str], str]
Say = Callable[[str], None]

#: What a person is told who teaches.
HELP = (
    "x 1.5   move by 1.5 mm along x (y and z likewise; several on one line: x 1 y -0.2)\n"
    f"up      lift by {LIFT_MM:g} mm\n"
    "ok      here it is\n"
    "Enter   the last step once more\n"
    "quit    stop, store nothing"
)


@dataclass(frozen=True, kw_only=True)
class FittedFrame:
    """Where the block lies, by the markers touched.

    Args:
        frame: Origin and quarter turns; its z is that of the markers' mean.
        distances_mm: How far each touched marker lies from where the frame has it.
        turn_deg: Turn that is left over beyond the quarter turns, counter-clockwise.
        stretch: Distances between the touched markers over those on the jig.
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
        """Refuse a fit that is too bad to press by.

        Raises:
            CheckFailedError: A marker is further off than the tolerance; the message says what may be wrong.
        """
        if self.worst_mm <= tolerance_mm:
            return
        if abs(self.stretch - 1.0) > 0.1:
            reason = (
                f"the touched markers lie {self.stretch:.3g} times as far apart as on the jig: "
                "were these the markers, and does the stage know its steps per mm?"
            )
        elif abs(self.turn_deg) > 2.0:
            reason = f"the holder lies {self.turn_deg:.2g} degrees askew to the stage's axes: turn it"
        else:
            reason = "were these the markers, and is the jig pushed home?"
        raise CheckFailedError(
            f"a marker lies {self.worst_mm:.3g} mm from where the frame has it, above the tolerance of "
            f"{tolerance_mm:g} mm; nothing is stored: {reason}"
        )


def corner_markers(grid: PressGrid) -> tuple[tuple[int, float, float], ...]:
    """Number, x and y of the four corner positions: 1, 5, 21 and 25 of the paper's grid."""
    across = len(grid.x_mm)
    numbers = (1, across, across * (len(grid.y_mm) - 1) + 1, across * len(grid.y_mm))
    places = grid.positions_mm
    return tuple((number, float(places[number - 1][0]), float(places[number - 1][1])) for number in numbers)


def fit_frame(markers_mm: Sequence[tuple[float, float]], touched_mm: Sequence[Point]) -> FittedFrame:
    """The frame in which the markers lie nearest to where they were touched, by least squares.

    For each of the four quarter turns R the best origin is the mean of s - R m; the turn with the least sum of squares
    is taken. What is left over is told as the turn and stretch of the best similarity (Umeyama, in the plane: with
    complex m, s about their means, ``sum(conj(m) s) / sum(|m|^2)``).

    Args:
        markers_mm: Two or more places in the block's frame.
        touched_mm: The stage's position at each.
    """
    m = np.array([complex(x, y) for x, y in markers_mm])
    s = np.array([complex(x, y) for x, y, _ in touched_mm])
    z = float(np.mean([point[2] for point in touched_mm]))

    def left_over(turns: int) -> Floats:
        off = s - m * 1j**turns
        return np.asarray(np.abs(off - off.mean()), dtype=np.float64)

    turns = min(range(4), key=lambda quarter: float(np.sum(left_over(quarter) ** 2)))
    origin = complex(np.mean(s - m * 1j**turns))
    centred = (m - m.mean()) * 1j**turns
    similarity = complex(np.sum(np.conj(centred) * (s - s.mean())) / np.sum(np.abs(centred) ** 2))
    return FittedFrame(
        frame=WorkFrame(origin_mm=(origin.real, origin.imag, z), quarter_turns=turns),
        distances_mm=tuple(float(distance) for distance in left_over(turns)),
        turn_deg=math.degrees(math.atan2(similarity.imag, similarity.real)),
        stretch=abs(similarity),
    )


def highest_point_mm(block: Block) -> tuple[float, float]:
    """Place (x, y) of a block's highest point, in mm; of several the one nearest to its middle."""
    width, depth = block.size_mm
    x = np.linspace(0.0, width, math.ceil(width / _SAMPLE_MM) + 1)
    y = np.linspace(0.0, depth, math.ceil(depth / _SAMPLE_MM) + 1)
    heights = block.height_at(x[None, :], y[:, None])
    if block.keep is not None:
        heights = np.where(block.keep.excess(x[None, :], y[:, None]) <= 0.0, heights, -np.inf)
    rows, columns = np.nonzero(heights >= heights.max() - _EQUAL_MM)
    best = int(np.argmin((x[columns] - width / 2.0) ** 2 + (y[rows] - depth / 2.0) ** 2))
    return float(x[columns[best]]), float(y[rows[best]])


@dataclass(kw_only=True)
class Teaching:
    """A person at the stage: jogs by typed lines, confirms, and the frame follows.

    Args:
        stage: The stage, homed.
        limits_mm: Its limits.
        ask: Shows a prompt and returns the line that was typed.
        say: Shows a line.
        travel_mm_s: Speed across, high up.
        approach_mm_s: Speed of every typed step.
        force_n: The contact force, if there is a gauge; a step down that presses too hard is taken back.
    """

    stage: Stage
    limits_mm: Limits
    ask: Ask
    say: Say
    travel_mm_s: float
    approach_mm_s: float
    force_n: Callable[[], float] | None = None

    def frame(self, protocol: Protocol, block: Block, tolerance_mm: float) -> FittedFrame:
        """Teach a frame: four markers for x, y and the turn, then the block's highest point for z.

        However it ends, the stage is lifted if it still answers.

        Args:
            protocol: Its press grid is that of the jig.
            block: The block in the first slot.
            tolerance_mm: How far off a marker may be.

        Raises:
            CheckFailedError: The markers do not fit.
            InputError: The person stopped.
            RigError: The stage failed.
        """
        try:
            return self._taught(protocol, block, tolerance_mm)
        except BaseException:
            # Whatever went wrong, nothing must be left pressed against the block.
            with contextlib.suppress(TacbenchError):
                self.lift_off()
            raise

    def _taught(self, protocol: Protocol, block: Block, tolerance_mm: float) -> FittedFrame:
        self.say("Put the jig on, and a pointer in the place of the sensor, on the same axis. Commands:\n" + HELP)
        markers = corner_markers(protocol.grid)
        touched: list[Point] = []
        for number, x, y in markers:
            if len(touched) >= 2:
                known = [(mx, my) for _, mx, my in markers[: len(touched)]]
                ahead = fit_frame(known, touched).frame.to_stage((x, y, 0.0))
                self._across(ahead[0], ahead[1])
            touched.append(self._jog(f"marker {number} (x {x:g}, y {y:g} mm of the block): centre the pointer on it"))
            self._lift(LIFT_MM)
        fit = fit_frame([(x, y) for _, x, y in markers], touched)
        for (number, _, _), distance in zip(markers, fit.distances_mm, strict=True):
            self.say(f"marker {number}: {distance:.3f} mm from where the frame has it")
        fit.require_within(tolerance_mm)
        self.lift_off()
        self._answered("Take the jig and the pointer off and put the sensor on. Then say ok.")
        x, y = highest_point_mm(block)
        ahead = fit.frame.to_stage((x, y, 0.0))
        self._across(ahead[0], ahead[1])
        z = self._jog("the block's highest point: go down until the sensor just touches it")[2]
        self.lift_off()
        return replace(fit, frame=replace(fit.frame, origin_mm=(*fit.frame.origin_mm[:2], z)))

    def lift_off(self) -> None:
        """Lift to the upper limit."""
        x, y, _ = self.stage.position()
        self.stage.move((x, y, self.limits_mm[2][1]), self.travel_mm_s)

    def _lift(self, by_mm: float) -> None:
        x, y, z = self.stage.position()
        self.stage.move((x, y, min(z + by_mm, self.limits_mm[2][1])), self.approach_mm_s)

    def _across(self, x: float, y: float) -> None:
        self.stage.move((x, y, self.stage.position()[2]), self.travel_mm_s)

    def _jog(self, what: str) -> Point:
        """Let the person move until they say ok; where the stage then is."""
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
        """Make a step, looking at the force on the way down; all of it is taken back if it presses too hard."""
        force_n = self.force_n if step[2] < 0.0 else None
        pieces = 1 if force_n is None else math.ceil(-step[2] / _PIECE_MM)
        for piece in range(1, pieces + 1):
            x, y, z = (a + b * piece / pieces for a, b in zip(here, step, strict=True))
            self.stage.move((x, y, z), self.approach_mm_s)
            if force_n is not None and force_n() > TOUCH_LIMIT_N:
                self.stage.move(here, self.approach_mm_s)
                self.say(f"that pressed with more than {TOUCH_LIMIT_N:g} N and was taken back; take smaller steps")
                return

    def _answered(self, prompt: str) -> None:
        while (word := self.ask(prompt + " ").strip()) != "ok":
            if word == "quit":
                raise InputError("align", "quit", "stopped; nothing is stored")


def parse_step(words: Sequence[str]) -> Point:
    """What a typed line asks for: ``x 1 y -0.2`` is (1, -0.2, 0) mm.

    Raises:
        InputError: It is no such line, or a step is too long.
    """
    line = " ".join(words)
    if not re.fullmatch(f"(?:{_STEP})+", line):
        raise InputError("step", line, "type x, y or z and millimetres, up, ok or quit")
    step = {"x": 0.0, "y": 0.0, "z": 0.0}
    for axis, text in re.findall(_STEP, line):
        step[axis] += float(text)
    if max(abs(length) for length in step.values()) > LONGEST_STEP_MM or step["z"] < -LONGEST_DOWN_MM:
        raise InputError(
            "step", line, f"is too long: at most {LONGEST_STEP_MM:g} mm at once, and {LONGEST_DOWN_MM:g} mm down"
        )
    return (step["x"], step["y"], step["z"])


def store_frame(path: Path, frame: WorkFrame) -> None:
    """Write origin and quarter turns into a study's ``[stage]``, leaving all else, comments included, as it is.

    The new text is read again before it is stored: it must say the same as before but for these two keys.

    Raises:
        InputError: The file cannot be edited safely; the message has the lines to write by hand.
    """
    origin = [round(value, _DECIMALS) + 0.0 for value in frame.origin_mm]
    lines = {"origin_mm": repr(origin), "quarter_turns": repr(frame.quarter_turns)}
    by_hand = "write by hand: " + "; ".join(f"{key} = {value}" for key, value in lines.items())
    target = path.resolve()
    try:
        text = door.read_bytes(target, "study", "toml").decode("utf-8")
        expected = door.parse_toml(text, "study", str(path))
        expected["stage"] |= {"origin_mm": origin, "quarter_turns": frame.quarter_turns}
        for key, value in lines.items():
            text = _with_key(text, "stage", key, value)
        same = door.parse_toml(text, "study", str(path)) == expected
    except (InputError, ValueError, KeyError, TypeError):
        same = False
    if not same:
        raise InputError(str(path), None, f"cannot be edited safely; {by_hand}")
    write_text(target, text)


def _with_key(text: str, table: str, key: str, value: str) -> str:
    """The text with a key of a table set; its line's comment stays.

    Raises:
        ValueError: The table has no header of its own line.
    """
    header = re.search(rf"^[ \t]*\[[ \t]*{table}[ \t]*\][ \t]*(?:#[^\r\n]*)?\r?$", text, re.MULTILINE)
    if header is None:
        raise ValueError(table)
    following = re.compile(r"^[ \t]*\[", re.MULTILINE).search(text, header.end())
    end = following.start() if following else len(text)
    # A list may run over several lines, with comments between its numbers.
    old = re.compile(rf"^([ \t]*{key}[ \t]*=[ \t]*)(?:\[(?:[^\]#]|#[^\n]*\n)*\]|[^\s#\[]+)", re.MULTILINE)
    match = old.search(text, header.end(), end)
    if match is not None:
        return text[: match.start()] + match[1] + value + text[match.end() :]
    line_end = "\r\n" if header[0].endswith("\r") else "\n"
    at = header.end() if not header[0].endswith("\r") else header.end() - 1
    return text[:at] + f"{line_end}{key} = {value}" + text[at:]
