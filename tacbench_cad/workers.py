"""Child processes that run the slow CAD work.

The Open CASCADE kernel keeps Python's lock while it computes and takes seconds to import, so parts are built side by
side in processes of their own, and the command itself never loads it. A child can be ended at any time, in the middle
of a computation too, which is what makes an interruption quick. Children are plain ``python`` processes that speak
pickles over their pipes: unlike ``multiprocessing`` they never import the caller's ``__main__`` again.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any

from tacbench_cad.errors import CheckFailedError, TacbenchError


class RefusedError(TacbenchError):
    """A :class:`TacbenchError` raised in a child, with its message and exit code."""

    def __init__(self, message: str, exit_code: int) -> None:
        self.exit_code = exit_code
        super().__init__(message)


def cpu_count() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class Workers:
    """A set of child processes. Use it as a context manager: leaving it ends them, whatever they do.

    Args:
        count: Most children at a time; each starts when there is work for it.
    """

    def __init__(self, count: int) -> None:
        self._threads = ThreadPoolExecutor(max_workers=max(1, count), thread_name_prefix="tacbench")
        self._own = threading.local()
        self._lock = threading.Lock()
        self._children: list[subprocess.Popen[bytes]] = []
        self._closed = False

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the children, whatever they do. Can be called twice."""
        with self._lock:
            self._closed = True
            children = list(self._children)
        for child in children:
            child.kill()
        self._threads.shutdown(wait=True, cancel_futures=True)
        for child in children:
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Run a module-level function in a child.

        Args:
            function: Found in the child by its module and name.
            arguments: Anything that pickles, as must the result.

        Returns:
            A future. Its exception is a :class:`RefusedError` for a message meant for the user, the ``OSError`` that
            the function raised, or a :class:`CheckFailedError` where the child was lost.
        """
        call = (function.__module__, function.__name__, arguments)
        return self._threads.submit(self._ask, call)

    def _ask(self, call: tuple[str, str, tuple[Any, ...]]) -> Any:
        child = getattr(self._own, "child", None)
        if child is None:
            child = self._own.child = self._start()
        assert child.stdin is not None and child.stdout is not None, "both are pipes"
        try:
            pickle.dump(call, child.stdin)
            child.stdin.flush()
            outcome, value = pickle.load(child.stdout)
        except (EOFError, BrokenPipeError, pickle.UnpicklingError):
            self._own.child = None
            code = child.wait()
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
            hint = "; was the memory full?" if code == -int(getattr(signal, "SIGKILL", 9)) else ""
            raise CheckFailedError(f"the process at work on {call[1]} {how}{hint}") from None
        if outcome == "done":
            return value
        if outcome == "refused":
            raise RefusedError(*value)
        if outcome == "os":
            raise value
        raise RuntimeError(f"in a child process:\n{value}")

    def _start(self) -> subprocess.Popen[bytes]:
        # The child gets exactly our module path: -P keeps a stray numpy.py of the current folder out of it.
        code = f"import sys; sys.path[:] = {sys.path!r}; from tacbench_cad.workers import serve; serve()"
        with self._lock:
            if self._closed:
                raise EOFError
            child = subprocess.Popen([sys.executable, "-P", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            self._children.append(child)
        return child


def serve() -> None:
    """What a child does: read a call, run it, write its outcome, until the pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interruption is the parent's to handle: it ends us
    answers = os.fdopen(os.dup(1), "wb")
    # The kernel prints to the standard output at will; that must reach neither our answers nor the user's JSON.
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    while True:
        try:
            module, name, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            outcome = ("done", getattr(importlib.import_module(module), name)(*arguments))
        except TacbenchError as error:
            outcome = ("refused", (str(error), error.exit_code))
        except OSError as error:
            outcome = ("os", error)
        except Exception:
            outcome = ("failed", traceback.format_exc())
        pickle.dump(outcome, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


def why_not_importable(modules: tuple[str, ...]) -> str | None:
    """Import modules, to find out whether that works here; meant to be run in a child.

    Returns:
        The reason why one of them cannot be imported, or None.
    """
    for name in modules:
        try:
            importlib.import_module(name)
        except ImportError as error:
            return f"{name}: {' '.join(str(error).split())}"
    return None
