"""Test the teaching of the frame: the fit to touched markers, the dialogue with a person, and the edit of the file."""

from __future__ import annotations

import math
import os
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacbench_cad.lab.rig.aligning import (
    FittedFrame,
    Teaching,
    corner_markers,
    fit_frame,
    highest_point_mm,
    parse_step,
    store_frame,
)
from tacbench_cad.lab.rig.errors import PositionLostError
from tacbench_cad.lab.rig.stage import Closing, LimitedStage
from tacbench_cad.lab.study.spec import Point, Protocol, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import PressGrid
from tacbench_cad.util.errors import CheckFailedError, InputError

MARKERS = [(4.0, 18.0), (9.0, 18.0), (4.0, 23.0), (9.0, 23.0)]
LIMITS = ((0.0, 200.0), (0.0, 200.0), (-100.0, 0.0))


class FakeStage(Closing):
    """A stage that arrives at once."""

    identity = "fake"
    simulated = "stage"

    def __init__(self) -> None:
        self.here: Point = (0.0, 0.0, 0.0)
        self.path: list[Point] = []

    def home(self) -> None: ...

    def move(self, target_mm: Point, speed_mm_s: float) -> Point:
        self.here = target_mm
        self.path.append(target_mm)
        return target_mm

    def position(self) -> Point:
        return self.here

    def stop(self) -> None: ...


# --- the fit ---


def test_the_corner_markers_of_the_jig() -> None:
    grid = PressGrid.paper()
    assert [number for number, _, _ in corner_markers(grid)] == [1, 5, 21, 25]
    assert [(x, y) for _, x, y in corner_markers(grid)] == MARKERS
    own = PressGrid(x_mm=(1.0, 2.0, 3.0), y_mm=(5.0, 6.0))
    assert corner_markers(own) == ((1, 1.0, 5.0), (3, 3.0, 5.0), (4, 1.0, 6.0), (6, 3.0, 6.0))
    with pytest.raises(InputError, match="has only one position, which does not show how the block is turned"):
        corner_markers(PressGrid(x_mm=(3.0,), y_mm=(4.0,)))


@given(
    x=st.floats(-200, 200),
    y=st.floats(-200, 200),
    z=st.floats(-100, 100),
    turns=st.integers(0, 3),
)
def test_exact_touches_recover_the_frame(x: float, y: float, z: float, turns: int) -> None:
    frame = WorkFrame(origin_mm=(x, y, z), quarter_turns=turns)
    fit = fit_frame(MARKERS, [frame.to_stage((mx, my, 0.0)) for mx, my in MARKERS])
    assert fit.frame.quarter_turns == turns
    assert fit.frame.origin_mm == pytest.approx((x, y, z), abs=1e-9)
    assert fit.worst_mm < 1e-9
    assert fit.turn_deg == pytest.approx(0.0, abs=1e-6) and fit.stretch == pytest.approx(1.0)


@pytest.mark.parametrize("turns", range(4))
@pytest.mark.parametrize("seed", range(5))
def test_noisy_touches_are_averaged(turns: int, seed: int) -> None:
    frame = WorkFrame(origin_mm=(80.0, 90.0, -60.0), quarter_turns=turns)
    off = np.random.default_rng(seed).normal(0.0, 0.1, (4, 2))
    touched = [
        (p[0] + dx, p[1] + dy, p[2])
        for p, (dx, dy) in zip((frame.to_stage((x, y, 0.0)) for x, y in MARKERS), off, strict=True)
    ]
    fit = fit_frame(MARKERS, touched)
    assert fit.frame.quarter_turns == turns
    expected = np.array(frame.origin_mm[:2]) + off.mean(axis=0)
    assert fit.frame.origin_mm[:2] == pytest.approx(tuple(expected))
    assert fit.distances_mm == pytest.approx(tuple(np.linalg.norm(off - off.mean(axis=0), axis=1)))


def touched(turn_deg: float = 0.0, stretch: float = 1.0) -> list[Point]:
    a = math.radians(turn_deg)
    return [
        (
            50.0 + stretch * (math.cos(a) * x - math.sin(a) * y),
            60.0 + stretch * (math.sin(a) * x + math.cos(a) * y),
            -5.0,
        )
        for x, y in MARKERS
    ]


@pytest.mark.parametrize(
    ("places", "message"),
    [
        (touched(turn_deg=8.0), "rotated by 8 degrees.*Align it"),
        (touched(stretch=1.3), "1.3 times as far apart.*steps per mm"),
        ([touched()[i] for i in (1, 0, 2, 3)], "the right markers"),
    ],
)
def test_a_bad_fit_is_refused_with_a_likely_reason(places: list[Point], message: str) -> None:
    fit = fit_frame(MARKERS, places)
    with pytest.raises(CheckFailedError, match=rf"more than the tolerance of 0.3 mm; nothing is stored: .*{message}"):
        fit.require_within(0.3)


@pytest.mark.parametrize("texture", ["1", "2", "3", "4", "5", "6"])
@pytest.mark.parametrize("key_mm", [None, 2.0])
def test_the_highest_point_is_the_highest_and_on_the_block(texture: str, key_mm: float | None) -> None:
    block = Block.of(texture, "paper", key_mm=key_mm)
    x, y = highest_point_mm(block)
    assert block.formula_datum_mm + float(block.surface(x, y)) == pytest.approx(7.0, abs=0.02)
    width, depth = block.size_mm
    assert 0.0 <= x <= width and 0.0 <= y <= depth
    if key_mm is not None:
        assert x - y <= width - key_mm


# --- typed steps ---


@pytest.mark.parametrize(
    ("line", "step"),
    [
        ("x 1", (1.0, 0.0, 0.0)),
        ("x1.5 y -0.2", (1.5, -0.2, 0.0)),
        ("z -.05", (0.0, 0.0, -0.05)),
        ("z 20", (0.0, 0.0, 20.0)),
        ("x 1 x 1", (2.0, 0.0, 0.0)),
    ],
)
def test_steps_are_read(line: str, step: Point) -> None:
    assert parse_step(line.split()) == step


@given(st.text(max_size=20))
def test_any_line_is_a_short_step_or_is_refused(line: str) -> None:
    try:
        step = parse_step(line.split())
    except InputError:
        return
    assert max(abs(axis_step) for axis_step in step) <= 20.0 and step[2] >= -2.0


# --- the dialogue ---


class Person:
    """A person who types the steps to each marker of a frame and then to the highest point."""

    def __init__(self, stage: FakeStage, frame: WorkFrame, block: Block, off_mm: float = 0.0) -> None:
        x, y = highest_point_mm(block)
        self.stage = stage
        self.goals = [frame.to_stage((mx, my, 3.0)) for mx, my in MARKERS]
        self.goals[0] = (self.goals[0][0] + off_mm, *self.goals[0][1:])
        self.goals.append(frame.to_stage((x, y, 0.0)))
        self.messages: list[str] = []
        self.prompts: list[str] = []
        self.lines: Iterator[str] = self._lines()

    def _lines(self) -> Iterator[str]:
        for i, goal in enumerate(self.goals):
            if i == len(self.goals) - 1:
                yield "what?"
                yield "ok"
            yield "hello"
            while math.dist(goal, self.stage.here) > 1e-9:
                step = [max(-2.0, min(20.0, g - h)) for g, h in zip(goal, self.stage.here, strict=True)]
                # A careful person moves sideways first.
                if any(step[:2]):
                    yield f"x {max(-20.0, step[0]):.6f} y {max(-20.0, step[1]):.6f}"
                    if math.dist(goal[:2], self.stage.here[:2]) > 1e-5:
                        continue
                    self.stage.here = (goal[0], goal[1], self.stage.here[2])
                else:
                    yield f"z {step[2]:.6f}"
                    if abs(goal[2] - self.stage.here[2]) < 1e-5:
                        self.stage.here = goal
            yield "ok"

    def ask(self, prompt: str) -> str:
        self.prompts.append(prompt)
        return next(self.lines)

    def say(self, line: str) -> None:
        self.messages.append(line)


def teaching(stage: FakeStage, person: Person) -> Teaching:
    return Teaching(
        stage=LimitedStage(stage, LIMITS),
        limits_mm=LIMITS,
        ask=person.ask,
        say=person.say,
        travel_mm_s=20.0,
        approach_mm_s=2.0,
    )


def taught(frame: WorkFrame, off_mm: float = 0.0) -> tuple[FittedFrame, FakeStage, Person]:
    stage, block = FakeStage(), Block.of("1", "paper")
    stage.here = (60.0, 60.0, -30.0)
    person = Person(stage, frame, block, off_mm)
    return teaching(stage, person).frame(Protocol(), block, 0.3), stage, person


@pytest.mark.parametrize("turns", range(4))
def test_a_person_teaches_the_frame(turns: int) -> None:
    frame = WorkFrame(origin_mm=(80.5, 79.25, -61.125), quarter_turns=turns)
    fit, stage, person = taught(frame)
    assert fit.frame.quarter_turns == turns
    assert fit.frame.origin_mm == pytest.approx(frame.origin_mm, abs=1e-4)
    assert stage.here[2] == 0.0, "the stage is lifted at the end"
    assert sum("away from its fitted position" in line for line in person.messages) == 4
    assert sum("must be x, y or z" in line for line in person.messages) == 5, "invalid lines are answered"


def test_the_stage_is_lifted_after_an_interruption() -> None:
    stage = FakeStage()
    stage.here = (60.0, 60.0, -30.0)

    def interrupt(prompt: str) -> str:
        raise KeyboardInterrupt

    person = Person(stage, WorkFrame(origin_mm=(80.0, 80.0, -60.0)), Block.of("1", "paper"))
    person.ask = interrupt  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        teaching(stage, person).frame(Protocol(), Block.of("1", "paper"), 0.3)
    assert stage.here == (60.0, 60.0, 0.0)


def test_the_stage_is_homed_if_it_cannot_be_lifted_otherwise() -> None:
    class Lost(FakeStage):
        homed = 0

        def home(self) -> None:
            self.homed += 1

        def position(self) -> Point:
            raise PositionLostError("the position is unknown")

    for may_home in (False, True):
        stage = Lost()
        person = Person(stage, WorkFrame(origin_mm=(80.0, 80.0, -60.0)), Block.of("1", "paper"))
        dialogue = teaching(stage, person)
        dialogue.may_home = may_home
        with pytest.raises(PositionLostError):
            dialogue.frame(Protocol(), Block.of("1", "paper"), 0.3)
        assert stage.homed == may_home
        assert bool(dialogue.not_lifted) != may_home


def test_a_step_beyond_the_limits_is_refused_and_the_dialogue_continues() -> None:
    stage = FakeStage()
    person = Person(stage, WorkFrame(origin_mm=(80.0, 80.0, -60.0)), Block.of("1", "paper"))
    person.lines = iter(["x -5", "quit"])
    with pytest.raises(InputError, match="stopped"):
        teaching(stage, person).frame(Protocol(), Block.of("1", "paper"), 0.3)
    assert stage.path == [(0.0, 0.0, 0.0)] and any("its limits; nothing was sent" in line for line in person.messages)


def test_a_step_that_presses_too_hard_is_undone() -> None:
    stage = FakeStage()
    stage.here = (50.0, 50.0, -10.0)
    messages: list[str] = []
    lines = iter(["z -0.5", "", "", "", "z -2", "quit"])
    with pytest.raises(InputError, match="stopped"):
        Teaching(
            stage=LimitedStage(stage, LIMITS),
            limits_mm=LIMITS,
            ask=lambda prompt: next(lines),
            say=messages.append,
            travel_mm_s=20.0,
            approach_mm_s=2.0,
            force_n=lambda: max(0.0, -12.0 - stage.here[2]) * 0.9,
        ).frame(Protocol(), Block.of("1", "paper"), 0.3)
    heights = [-10.5, -11.0, -11.5, -12.0, -12.5, -13.0, -13.5, -12.0, 0.0]
    assert [place[2] for place in stage.path] == heights, "the step ends at the first piece above 1 N"
    assert any("was undone" in line for line in messages)


# --- the file ---

FRAME = WorkFrame(origin_mm=(80.5, -79.12345, 1.0), quarter_turns=3)


def stored(tmp_path: Path, text: str) -> str:
    path = tmp_path / "study.toml"
    path.write_bytes(text.encode())
    store_frame(path, FRAME)
    return path.read_bytes().decode()


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_missing_keys_are_added_to_the_table(tmp_path: Path, end: str) -> None:
    text = end.join(["# study", "[stage] # it", 'driver = "virtual-grbl"', "", "[sensor]", "a = 1", ""])
    result = stored(tmp_path, text)
    document = tomllib.loads(result)
    assert document["stage"]["origin_mm"][0] == 80.5 and document["stage"]["quarter_turns"] == 3
    assert document["stage"]["driver"] == "virtual-grbl" and document["sensor"] == {"a": 1}
    assert result.count("\n") == text.count("\n") + 2 and result.count("\r") == (
        result.count("\n") if end == "\r\n" else 0
    )


@pytest.mark.parametrize(
    "text",
    [
        'stage = {driver = "grbl", origin_mm = [1, 2, 3]}\n',
        'stage.driver = "grbl"\n',
        'note = """\n[stage]\n"""\n[stage]\ndriver = "grbl"\n',
        '[stage]\ndriver = "grbl"\n[sensor]\na = 1\n[stage.options]\nspeed = 2\n',
    ],
)
def test_a_table_may_be_written_in_any_way(tmp_path: Path, text: str) -> None:
    before = tomllib.loads(text)
    after = tomllib.loads(stored(tmp_path, text))
    assert after["stage"]["origin_mm"][0] == 80.5 and after["stage"]["quarter_turns"] == 3
    before["stage"] |= {key: after["stage"][key] for key in ("origin_mm", "quarter_turns")}
    assert after == before


@pytest.mark.parametrize("text", ["no toml [", "[other]\n", "stage = 3\n"])
def test_a_file_that_cannot_be_edited_safely_is_not_changed(tmp_path: Path, text: str) -> None:
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(
        InputError, match=r"cannot be edited safely; write these lines by hand: origin_mm = \[80.5, .*quarter_turns = 3"
    ):
        store_frame(path, FRAME)
    assert path.read_text() == text


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no named pipes in folders")
def test_only_small_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    with (tmp_path / "large.toml").open("wb") as stream:
        stream.truncate(9_000_000)
    (tmp_path / "deep.toml").write_text("[stage]\nlimits_mm = " + 50 * "[" + 50 * "]" + "\n")
    for name in ("pipe.toml", "large.toml", "deep.toml"):
        with pytest.raises(InputError, match=f"{name}: cannot be edited safely; write these lines by hand"):
            store_frame(tmp_path / name, WorkFrame(origin_mm=(1.0, 2.0, 3.0)))
    assert (tmp_path / "large.toml").stat().st_size == 9_000_000
