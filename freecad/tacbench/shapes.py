"""Get shapes from the worker, a process in the Python environment of tacbench-cad, and keep the last ones."""

from __future__ import annotations

import hashlib
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
from collections import OrderedDict
from pathlib import Path

import FreeCAD
import Part

#: Where FreeCAD keeps the preferences of the workbench.
PREFERENCES = "User parameter:BaseApp/Preferences/Mod/Tacbench"
#: How many shapes are kept for the next recompute.
MAX_KEPT = 64
#: How long a shape may take, in seconds.
MAX_SECONDS = 600
#: Variables by which FreeCAD's own bundle finds its files. Another Python must not see them.
BUNDLE_VARIABLES = ("PYTHONHOME", "PYTHONPATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")

_WHAT_TO_DO = (
    'Install tacbench-cad with the extra "cad", and choose its Python or its program tacbench in '
    "Edit > Preferences > Tacbench."
)


class WorkerError(RuntimeError):
    """A shape cannot be made. The message has one line and is meant for the user."""


def python_of_tacbench() -> str:
    """Return the Python interpreter of the environment of tacbench-cad.

    This is the program of the preference ``Python``, or the interpreter of the command ``tacbench`` on the PATH.

    Raises:
        WorkerError: There is no such program.
    """
    named = FreeCAD.ParamGet(PREFERENCES).GetString("Python")
    found = shutil.which(named or "tacbench")
    if found is None:
        what = f"the program {named} of the preferences does not exist" if named else "tacbench is not on the PATH"
        raise WorkerError(f"{what}. {_WHAT_TO_DO}")
    program = Path(found)
    return str(program) if program.stem.startswith("python") else interpreter_beside(program)


def interpreter_beside(program: Path) -> str:
    """Return the interpreter of the environment in which a console script is installed.

    Args:
        program: The script, for example ``.venv/bin/tacbench``, or a link to it.

    Raises:
        WorkerError: The interpreter is not beside the script, and the script does not name it.
    """
    script = program.resolve()
    for folder in (script.parent, script.parent.parent):
        for name in ("python", "python.exe"):
            if (folder / name).is_file():
                return str(folder / name)
    with script.open("rb") as file:
        first = file.readline(1000)
    interpreter = first[2:].decode(errors="replace").strip() if first.startswith(b"#!") else ""
    if not Path(interpreter).is_file():
        raise WorkerError(f"{program} does not name its Python. {_WHAT_TO_DO}")
    return interpreter


def environment() -> dict[str, str]:
    """Return the variables for the worker: without those of FreeCAD's own bundle, if FreeCAD runs from one."""
    bundled = "PYTHONHOME" in os.environ or "APPDIR" in os.environ
    return {name: value for name, value in os.environ.items() if not (bundled and name in BUNDLE_VARIABLES)}


class Worker:
    """A running worker. It ends when FreeCAD ends, because its standard input is closed then."""

    def __init__(self, python: str) -> None:
        self.python = python
        self._messages = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as the process
        hidden = {"creationflags": subprocess.CREATE_NO_WINDOW} if sys.platform == "win32" else {}
        try:
            self._process = subprocess.Popen(
                [python, "-P", str(Path(__file__).with_name("worker.py"))],  # -P: the modules beside it are FreeCAD's
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._messages,
                env=environment(),
                encoding="utf-8",
                **hidden,
            )
        except OSError as error:
            raise WorkerError(f"{python} cannot be started ({error.strerror}). {_WHAT_TO_DO}") from None
        self._answers: queue.Queue[str] = queue.Queue()
        threading.Thread(target=self._receive, daemon=True).start()

    def _receive(self) -> None:
        """Read the answers in a thread of its own, so that the wait for them can be limited."""
        for line in self._process.stdout:
            self._answers.put(line)
        self._answers.put("")

    @property
    def is_alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def ask(self, request: dict) -> dict:
        """Send a request and wait for its answer.

        Raises:
            WorkerError: The request was refused, or the process ended or takes too long.
        """
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
            line = self._answers.get(timeout=MAX_SECONDS)
        except queue.Empty:
            self._process.kill()
            raise WorkerError(f"{self.python} gave no answer within {MAX_SECONDS} s") from None
        except OSError:
            line = ""
        if not line:
            raise WorkerError(self._last_words())
        answer = json.loads(line)
        if "error" in answer:
            raise WorkerError(" ".join(answer["error"].split()))
        return answer

    def _last_words(self) -> str:
        """Say why the process ended, by the last line that it printed."""
        self._process.wait(10)
        self._messages.seek(0)
        lines = self._messages.read().decode("utf-8", errors="replace").split("\n")
        reason = ([line.strip() for line in lines if line.strip()] or ["without a message"])[-1]
        return f"{self.python} ended: {reason}. {_WHAT_TO_DO}"


_worker: Worker | None = None
_kept: OrderedDict[str, tuple[Part.Shape, dict]] = OrderedDict()


def ask(request: dict) -> dict:
    """Send a request to the worker, which is started if it does not run or if the preference has changed."""
    global _worker
    python = python_of_tacbench()
    if _worker is None or not _worker.is_alive or _worker.python != python:
        _worker = Worker(python)
    return _worker.ask(request)


def shape_of(request: dict) -> tuple[Part.Shape, dict]:
    """Return the shape of a request and the facts about it.

    The last shapes are kept, but not those of a texture in a file: the file, or an image that it names, may change.

    Args:
        request: What the worker needs.

    Raises:
        WorkerError: The shape cannot be made. The message says why.
    """
    source = request.get("block") or request["texturing"]
    key = hashlib.sha256(json.dumps(request, sort_keys=True).encode()).hexdigest()
    if key in _kept:
        _kept.move_to_end(key)
        return _kept[key]
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "shape.brep")
        facts = ask({**request, "action": "shape", "brep": path})
        shape = Part.Shape()
        shape.importBrep(path)
    if source["file"] is None:
        _kept[key] = shape, facts
        while len(_kept) > MAX_KEPT:
            _kept.popitem(last=False)
    return shape, facts
