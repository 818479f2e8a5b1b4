"""The progress file of a session, for programs that show what happens at the rig.

The file has a line of JSON for each event. Writing a line takes some microseconds, because nothing is forced to the
disk: the file only helps to watch a run, and the run folders contain everything that is kept.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.safety import RunInterruptedError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.study.presses import Press
from tacbench_cad.lab.study.spec import PrintedBlock, Study
from tacbench_cad.spec.label import engrave
from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError, one_line

#: The name of the progress file, in the folder of the runs.
PROGRESS_FILE = "progress.jsonl"


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

    def ask(self, printed: PrintedBlock, label: str, slot: int | None) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("ask", run=printed.name, label=label, slot=slot, picture=label_picture(printed))

    def answered(self) -> None:
        """See :class:`~tacbench_cad.lab.acquire.progress.PressProgress`."""
        self.write("answered")

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

    @contextmanager
    def finishing(self, done: str) -> Iterator[None]:
        """Write the outcome of the body, with a message if it has no error."""
        try:
            yield
        except BaseException as error:
            self.ended(error)
            raise
        self.write("over", outcome="done", message=done)

    def ended(self, error: BaseException) -> None:
        """Write the outcome of a session that ended with an error.

        It is ``faults`` (all presses are made, but a run has faults); ``failed`` (a device failed, and the run was
        stopped safely); ``interrupted``; ``refused`` (wrong input); or ``error`` (an unexpected error).
        """
        message = one_line("; ".join([str(error), *getattr(error, "__notes__", ())]))
        if isinstance(error, KeyboardInterrupt):
            outcome, message = "interrupted", message if isinstance(error, RunInterruptedError) else "interrupted"
        elif isinstance(error, CheckFailedError):
            outcome = "faults"
        elif isinstance(error, TacbenchError):
            outcome = "refused" if error.exit_code == InputError.exit_code else "failed"
        else:
            outcome, message = "error", f"{type(error).__name__}: {message}"
        self.write("over", outcome=outcome, message=message)

    def close(self) -> None:
        """Close the file."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None


def label_picture(printed: PrintedBlock) -> dict[str, Any] | None:
    """Return the underside of a block with its label, as the person sees it.

    Returns:
        The width and height of the underside in mm (``size``), and the outlines of the glyphs as a path of SVG
        (``path``); None if the label does not fit on the block.
    """
    block = replace(printed.in_file, copy=printed.copy)
    try:
        label = engrave(block.label_words, block.size_mm, block.region)
    except (InputError, ImportError):  # the library that joins the strokes is not part of the light installation
        return None
    size, contours = label.as_read(block.size_mm)
    path = "".join("M" + "L".join(f"{x:.2f},{y:.2f}" for x, y in contour) + "Z" for contour in contours)
    return {"size": list(size), "path": path}
