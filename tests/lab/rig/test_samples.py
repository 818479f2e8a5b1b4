"""Test lines of numbers: for arbitrary bytes, each line is a sample or is skipped and counted."""

from __future__ import annotations

import math
import os
import sys
import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacbench_cad.lab.rig.errors import DeviceLostError, NoAnswerError, RigError
from tacbench_cad.lab.rig.line import Line
from tacbench_cad.lab.rig.samples import SampleStream, parse_numbers

pty_only = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")


class Script:
    """A source of given lines, and nothing after them."""

    def __init__(self, *lines: str) -> None:
        self.lines = list(lines)
        self.closed = 0

    def now_s(self) -> float:
        return time.monotonic()

    def read_line(self, timeout_s: float) -> str | None:
        return self.lines.pop(0) if self.lines else None

    def forget(self) -> None:
        self.lines.clear()

    def close(self) -> None:
        self.closed += 1


def stream(*lines: str, columns: int = 1) -> SampleStream:
    return SampleStream(lines=Script(*lines), name="cell", columns=columns, timeout_s=0.01)


@pytest.mark.parametrize(
    ("line", "numbers"),
    [
        ("1", (1.0,)),
        (" -12.5\r", (-12.5,)),
        ("+.5e-3", (0.0005,)),
        ("1,2,3", (1.0, 2.0, 3.0)),
        ("1, 2 ,3,", (1.0, 2.0, 3.0)),
        ("1;2\t3 4", (1.0, 2.0, 3.0, 4.0)),
        ("8388607", (8388607.0,)),
    ],
)
def test_samples_are_read(line: str, numbers: tuple[float, ...]) -> None:
    assert parse_numbers(line) == numbers


@pytest.mark.parametrize("line", ["", "1,,2", ",1", "abc", "nan", "1e999", "0x10", "1_000", "12N", "1\x002", "9" * 21])
def test_other_texts_are_not_samples(line: str) -> None:
    assert parse_numbers(line) is None


@given(st.text(max_size=60))
def test_any_text_is_a_sample_or_none(line: str) -> None:
    numbers = parse_numbers(line)
    assert numbers is None or (len(numbers) >= 1 and all(math.isfinite(number) for number in numbers))


@given(st.lists(st.text(max_size=8), min_size=1, max_size=60))
def test_every_line_is_a_sample_or_counted(lines: list[str]) -> None:
    sample_stream = stream(*lines)
    samples = 0
    try:
        while True:
            sample_stream.next()
            samples += 1
    except (RigError, NoAnswerError):
        left = len(sample_stream.lines.lines)  # type: ignore[attr-defined]
        assert samples + sample_stream.garbled + left == len(lines)


def test_garbled_lines_are_skipped_and_counted() -> None:
    samples = stream("1", "x", "2", "", "3,4", "5")
    assert [samples.next() for _ in range(3)] == [(1.0,), (2.0,), (5.0,)]
    assert samples.garbled == 3


def test_too_many_garbled_lines_cause_an_error() -> None:
    lines = [line for i in range(40) for line in (f"{i}", "?#")]
    samples = stream(*lines)
    with pytest.raises(RigError, match=r"cell: 10 of the last 20 lines are garbled, for example '\?#'"):
        for _ in range(40):
            samples.next()


def test_silence_causes_a_specific_error() -> None:
    with pytest.raises(NoAnswerError, match="sends no data"):
        stream().next()
    with pytest.raises(NoAnswerError):
        stream("1").start_fresh()


@pty_only
def test_only_samples_after_the_call_are_returned() -> None:
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    with Line(os.ttyname(slave), baud=115200, what="gauge") as line:
        samples = SampleStream(lines=line, name="cell", columns=1, timeout_s=2.0)
        os.write(master, b"1\n2\n3\n4")
        later = threading.Timer(0.05, lambda: os.write(master, b"4\n5\n6\n"))
        later.start()
        samples.start_fresh(latency_s=0.01)
        assert samples.next() == (5.0,), "44 began before the call"
        later.join()
        os.close(master)
        os.close(slave)
        with pytest.raises(DeviceLostError):
            samples.next()
            samples.next()
