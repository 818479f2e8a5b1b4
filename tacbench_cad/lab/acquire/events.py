"""The progress file of a session: its writer, and a reader for programs that show what happens at the rig.

The file has a line of JSON for each event. Writing a line takes some microseconds, because nothing is forced to the
disk: the file only helps to watch a run, and the run folders contain everything that is kept.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO

from tacbench_cad.lab.acquire.person import Person
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock, Study
from tacbench_cad.spec.label import engrave
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import is_running

#: The name of the progress file, in the folder of the runs.
PROGRESS_FILE = "progress.jsonl"
#: The number of past presses, messages and intervals between presses that a reader keeps.
KEPT_PRESSES, KEPT_MESSAGES, KEPT_INTERVALS = 10, 20, 30
#: The largest part of the file that is read at once, in bytes, and the longest first line.
_MAX_READ, _MAX_LINE = 4_000_000, 100_000


class ProgressFile(PressProgress):
    """Writes the events of a session to :data:`PROGRESS_FILE`. A failed write does not stop the run.

    Args:
        out: The folder of the runs.
        time_s: Returns the time in seconds since 1970.
    """

    def __init__(self, out: Path, *, time_s: Callable[[], float] = time.time) -> None:
        self.path = out / PROGRESS_FILE
        self._time_s = time_s
        self._stream: BinaryIO | None = None

    def start(self, study: Study, saved: int) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`. The file of the last session is replaced."""
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)
            self._stream = self.path.open("xb", buffering=0)
        process = {"process": os.getpid(), "host": socket.gethostname(), "session": os.urandom(8).hex()}
        self.write("start", blocks=len(study.blocks), planned=study.presses, saved=saved, **process)

    def begin(self, name: str, done: int, total: int) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("begin", run=name, done=done, total=total)

    def before(self, press: Press, check: Callable[[], None]) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("press", number=press.number, position=press.position, level=press.force_level)

    def felt(self, z_mm: float, force_n: float) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self._append(f'{{"event":"felt","z":{z_mm:.4f},"n":{force_n:.5f}}}\n'.encode())

    def pressed(self, done: int, force: Force | None, in_band: bool | None, image: Path) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("pressed", done=done, temperature_c=None if force is None else force.temperature_c)

    def end(self) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("end")

    def say(self, message: str) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("say", text=message)

    def write(self, event: str, **values: Any) -> None:
        """Write an event with its time.

        Args:
            event: The name of the event.
            **values: Plain values that describe it.
        """
        line = json.dumps({"event": event, "time": round(self._time_s(), 3), **values}, separators=(",", ":"))
        self._append(f"{line}\n".encode())

    def _append(self, line: bytes) -> None:
        if self._stream is not None:
            with contextlib.suppress(OSError):  # the disk is full
                self._stream.write(line)

    def close(self) -> None:
        """Close the file."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


class RecordedPerson:
    """A person whose questions are written to a progress file.

    Args:
        person: The person who is asked.
        file: The progress file.
    """

    def __init__(self, person: Person, file: ProgressFile) -> None:
        self.person, self.file = person, file

    @property
    def is_asked_always(self) -> bool:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`."""
        return self.person.is_asked_always

    def put_in(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`."""
        self.file.write("ask", run=printed.name, label=label, slot=slot, picture=label_picture(printed))
        self.person.put_in(printed, label, slot)
        self.file.write("answered")

    def first_touch(self, printed: PrintedBlock, positions: int) -> tuple[float, ...]:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`."""
        self.file.write("say", text=f"Type the height of first touch on {printed.name} in the terminal.")
        return self.person.first_touch(printed, positions)

    def press_anyway(self, problem: str) -> bool:
        """See :class:`~tacbench_cad.lab.acquire.person.Person`."""
        self.file.write("say", text=f"{problem}. Answer in the terminal.")
        return self.person.press_anyway(problem)


def label_picture(printed: PrintedBlock) -> dict[str, Any] | None:
    """Return the underside of a block with its label, as the person sees it.

    Returns:
        The width and height of the underside in mm (``size``), and the outlines of the glyphs as a path of SVG
        (``path``); None if the label does not fit on the block.
    """
    block = replace(printed.in_file, copy=printed.copy)
    try:
        label = engrave(block.label_words, block.size_mm, block.key_mm or 0.0, block.outline)
    except (InputError, ImportError):  # the library that joins the strokes is not part of the light installation
        return None
    size, contours = label.as_read(block.size_mm)
    path = "".join("M" + "L".join(f"{x:.2f},{y:.2f}" for x, y in contour) + "Z" for contour in contours)
    return {"size": list(size), "path": path}


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
        question: The block that is to be put in: ``run``, ``label``, ``slot``, and ``picture`` (:func:`label_picture`).
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
