"""The events of a session at a rig, read from the progress file that ``tacbench acquire`` writes."""

from __future__ import annotations

import contextlib
import json
import socket
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from tacbench_cad.util.files import is_running

#: The number of past presses, messages and intervals between presses that a reader keeps.
KEPT_PRESSES, KEPT_MESSAGES, KEPT_INTERVALS = 10, 20, 30
#: The largest part of the file that is read at once, in bytes, and the longest first line.
_MAX_READ, _MAX_LINE = 4_000_000, 100_000


@dataclass
class Progress:
    """The state of a session that follows from its events.

    Args:
        planned: The number of presses of the study.
        saved: The number of its presses that are saved.
        blocks: The number of blocks of the study.
        run: The name of the run that is being pressed, or was pressed last.
        pressing: Whether a block is being pressed.
        done: The number of saved presses of that run.
        total: The number of presses of that run.
        press: The number of the current press; 0 if there is none.
        curve: The heights in mm and the forces in N of the current press.
        curves: The numbers and curves of the last presses.
        question: The block that is to be put in: ``run``, ``label``, ``slot``, and ``picture``, see
            :func:`~tacbench_cad.lab.acquire.events.label_picture`.
        paused: Whether the person has paused the run.
        over: The outcome of the session; None until it ends.
        messages: The last messages.
        time_s: The time of the last event in seconds since 1970.
        temperature_c: The temperature of the room at the last press, if the gauge measures it.
        process: The number of the process of the session, and the name of its machine; None if they are unknown.
    """

    planned: int = 0
    saved: int = 0
    blocks: int = 0
    run: str = ""
    pressing: bool = False
    done: int = 0
    total: int = 0
    press: int = 0
    curve: list[tuple[float, float]] = field(default_factory=list)
    curves: deque[tuple[int, list[tuple[float, float]]]] = field(default_factory=lambda: deque(maxlen=KEPT_PRESSES))
    question: dict[str, Any] | None = None
    paused: bool = False
    over: dict[str, Any] | None = None
    messages: deque[str] = field(default_factory=lambda: deque(maxlen=KEPT_MESSAGES))
    time_s: float = 0.0
    temperature_c: float | None = None
    process: tuple[int, str] | None = None
    _intervals_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT_INTERVALS))
    _pressed_s: float | None = None

    @property
    def press_s(self) -> float | None:
        """The mean time from one press to the next, without pauses; None before the second press."""
        return sum(self._intervals_s) / len(self._intervals_s) if self._intervals_s else None

    @property
    def is_killed(self) -> bool:
        """Whether the process of the session is known to have ended without an outcome."""
        if self.over is not None or self.process is None or self.process[1] != socket.gethostname():
            return False
        return not is_running(self.process[0])

    def add(self, event: dict[str, Any]) -> None:
        """Apply an event."""
        name = event["event"]
        if name == "felt":
            self.curve.append((event["z"], event["n"]))
            return
        self.time_s = event["time"]
        if name in ("begin", "paused", "ask"):
            self._pressed_s = None
        if name == "start":
            self.planned, self.saved, self.blocks = event["planned"], event["saved"], event["blocks"]
            self.process = (int(event["process"]), event["host"])
        elif name == "begin":
            self.run, self.done, self.total, self.pressing = event["run"], event["done"], event["total"], True
            self.curves.clear()
            self._forget_press()
        elif name == "press":
            self._forget_press()
            self.press = event["number"]
        elif name == "pressed":
            self.saved += event["done"] - self.done
            self.done = event["done"]
            self.temperature_c = event.get("temperature_c")
            self.curves.append((self.press, self.curve))
            self._forget_press()
            if self._pressed_s is not None:
                self._intervals_s.append(self.time_s - self._pressed_s)
            self._pressed_s = self.time_s
        elif name == "end":
            self.pressing = self.paused = False
            self._forget_press()
        elif name == "say":
            self.messages.append(event["text"])
        elif name == "paused":
            self.paused = event["paused"]
        elif name in ("ask", "answered"):
            self.question = {key: event[key] for key in ("run", "label", "slot", "picture")} if name == "ask" else None
        elif name == "over":
            self.over = {key: event[key] for key in ("outcome", "message")}
            self.question, self.paused = None, False

    def _forget_press(self) -> None:
        self.press, self.curve = 0, []


class ProgressReader:
    """Follows a progress file that another process writes.

    Args:
        path: The file. It may be missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.progress: Progress | None = None
        self._first = b""
        self._at = 0

    def read(self) -> Progress | None:
        """Read the new events, and return the state; None if there is no progress file."""
        try:
            with self.path.open("rb") as stream:
                first = stream.readline(_MAX_LINE)
                if first != self._first or self.progress is None:
                    self._first, self._at, self.progress = first, 0, Progress()
                while lines := self._lines(stream):
                    for line in lines:
                        # Another program may have written to the file.
                        with contextlib.suppress(ValueError, KeyError, TypeError):
                            self.progress.add(json.loads(line))
        except FileNotFoundError:
            self.progress = None
        except OSError:
            pass
        return self.progress

    def _lines(self, stream: BinaryIO) -> list[bytes]:
        """Return the next complete lines."""
        stream.seek(self._at)
        complete, newline, _ = stream.read(_MAX_READ).rpartition(b"\n")
        self._at += len(complete) + len(newline)
        return complete.splitlines()
