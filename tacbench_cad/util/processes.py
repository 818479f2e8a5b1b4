"""Child processes that run slow work: CAD, and the blocks of a simulated study.

The Open CASCADE kernel keeps Python's lock while it computes and takes seconds to import, so parts are built side by
side in processes of their own, and the command itself never loads it. A child can be ended at any time, in the middle
of a computation too, which is what makes an interruption quick. Children are plain ``python`` processes that speak
pickles over their pipes: unlike ``multiprocessing`` they never import the caller's ``__main__`` again.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from tacbench_cad.util.door import limits_factor
from tacbench_cad.util.errors import CheckFailedError, TacbenchError, one_line

#: A child of :func:`isolated` may use this much memory, in MB, times the user's factor of all limits.
MAX_ISOLATED_MB = 8000


#: Processor time, in s, that a child may use beyond its time limit before the system ends it.
PROCESSOR_MARGIN_S = 10


class LostProcessError(CheckFailedError):
    """A child ended in the middle of a call.

    Attributes:
        seconds: The time limit that it exceeded; None where it ended by itself.
    """

    def __init__(self, message: str, seconds: float | None = None) -> None:
        self.seconds = seconds
        super().__init__(message)


def child_environment() -> dict[str, str]:
    """The environment of a Python child: it never imports from the folder that a command happens to be started in."""
    return {**os.environ, "PYTHONSAFEPATH": "1"}


@contextlib.contextmanager
def safe_children() -> Iterator[None]:
    """The same for children that a library starts while the body runs."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


def cpu_count() -> int:
    """Processors that this process may use, or what ``PYTHON_CPU_COUNT`` says, which Python 3.13 and later obey too."""
    limit = os.environ.get("PYTHON_CPU_COUNT", "")
    if limit.isdecimal() and int(limit):
        return int(limit)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True, eq=False)
class _Call:
    """A call on its way to a child."""

    module: str
    function: str
    arguments: tuple[Any, ...]
    first_child: bool
    seconds: float | None
    future: Future[Any]


class Workers:
    """A set of child processes. Use it as a context manager: leaving it ends them, whatever they do.

    Args:
        count: Most children at a time; each starts when there is work for it that no other child is free for.
        max_mb: The memory that each may use, in MB; None for any. Without effect where the system has no such limit.
    """

    def __init__(self, count: int, max_mb: float | None = None) -> None:
        self._count = max(1, count)
        self._max_mb = max_mb
        self._changed = threading.Condition()
        self._calls: list[_Call] = []
        self._threads: list[threading.Thread] = []
        self._busy = 0
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
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            children = list(self._children)
        for child in children:
            child.kill()
        for thread in self._threads:
            thread.join()
        for child in children:
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()

    def submit(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        first_child: bool = False,
        seconds: float | None = None,
    ) -> Future[Any]:
        """Run a module-level function in a child.

        Args:
            function: Found in the child by its module and name.
            arguments: Anything that pickles, as must the result.
            first_child: Only the first child may take it, before any other call: for work that needs what only that
                one has imported.
            seconds: How long it may take once a child has begun; then the child is ended. None for any time.

        Returns:
            A future, which can be cancelled until a child takes it. Its exception is the ``TacbenchError`` or the
            ``OSError`` that the function raised, or a :class:`LostProcessError` where the child was lost.
        """
        future: Future[Any] = Future()
        with self._changed:
            call = _Call(function.__module__, function.__name__, arguments, first_child, seconds, future)
            self._calls.append(call)
            if len(self._calls) > len(self._threads) - self._busy and len(self._threads) < self._count:
                number = len(self._threads)
                thread = threading.Thread(target=self._attend, args=(number,), name=f"tacbench-{number}", daemon=True)
                self._threads.append(thread)
                thread.start()
            self._changed.notify_all()
        return future

    def _attend(self, number: int) -> None:
        """What a thread does: hand one call after another to its own child."""
        child: subprocess.Popen[bytes] | None = None
        while True:
            call = self._next(number)
            if call is None:
                return
            if not call.future.set_running_or_notify_cancel():
                self._free()
                continue
            try:
                child = child or self._start()
                result = self._ask(child, call)
            except BaseException as error:
                if child is not None and child.poll() is not None:
                    child = None
                self._free()
                call.future.set_exception(error)
            else:
                self._free()
                call.future.set_result(result)

    def _free(self) -> None:
        """Count a thread as free, before its call's result is known: what is submitted then needs no other child."""
        with self._changed:
            self._busy -= 1

    def _next(self, number: int) -> _Call | None:
        """The next call for a thread; waits for one. None when all is over."""

        def mine() -> _Call | None:
            own = [call for call in self._calls if number == 0 or not call.first_child]
            return min(own, key=lambda call: not call.first_child, default=None)

        with self._changed:
            self._changed.wait_for(lambda: self._closed or mine() is not None)
            call = None if self._closed else mine()
            if call is not None:
                self._calls.remove(call)
                self._busy += 1
            return call

    def _ask(self, child: subprocess.Popen[bytes], call: _Call) -> Any:
        assert child.stdin is not None and child.stdout is not None, "both are pipes"
        late = threading.Event()

        def end() -> None:
            late.set()
            child.kill()

        timer = None if call.seconds is None else threading.Timer(call.seconds, end)
        try:
            if timer is not None:
                timer.start()
            pickle.dump((call.module, call.function, call.arguments, call.seconds), child.stdin)
            child.stdin.flush()
            outcome, value = pickle.load(child.stdout)
        except (EOFError, BrokenPipeError, pickle.UnpicklingError):
            code = child.wait()
            if late.is_set():
                raise LostProcessError(f"{call.function} took longer than {call.seconds:g} s", call.seconds) from None
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
            hint = "; was the memory full?" if code == -int(getattr(signal, "SIGKILL", 9)) else ""
            raise LostProcessError(f"the process at work on {call.function} {how}{hint}") from None
        finally:
            if timer is not None:
                timer.cancel()
        if outcome == "done":
            return value
        if outcome == "raised":
            raise value
        raise RuntimeError(f"in a child process:\n{value}")

    def _start(self) -> subprocess.Popen[bytes]:
        # The child gets exactly our module path: -P keeps a stray numpy.py of the current folder out of it.
        code = f"import sys; sys.path[:] = {sys.path!r}; from tacbench_cad.util.processes import serve; "
        code += f"serve({self._max_mb!r})"
        with self._changed:
            if self._closed:
                raise EOFError
            command = [sys.executable, "-P", "-c", code]
            child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=child_environment())
            self._children.append(child)
        return child


def serve(max_mb: float | None = None) -> None:
    """What a child does: read a call, run it, write its outcome, until the pipe closes.

    Args:
        max_mb: The memory that it may use, in MB; None for any.
    """
    if max_mb is not None:
        _limit_memory(max_mb)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interruption is the parent's to handle: it ends us
    answers = os.fdopen(os.dup(1), "wb")
    # The kernel prints to the standard output at will; that must reach neither our answers nor the user's JSON.
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    while True:
        try:
            module, name, arguments, seconds = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        _limit_processor_time(seconds)
        try:
            outcome = ("done", getattr(importlib.import_module(module), name)(*arguments))
        except (TacbenchError, OSError) as error:
            outcome = ("raised", _portable(error))
        except Exception:
            outcome = ("failed", traceback.format_exc())
        pickle.dump(outcome, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


def _limit_memory(max_mb: float) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    limit = int(max_mb * 1e6)
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if soft == resource.RLIM_INFINITY or limit < soft:  # a child of a limited process stays within its limit
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def _limit_processor_time(seconds: float | None) -> None:
    """Let the system end this child if its parent was killed and cannot do it: a kernel that loops hears nothing."""
    try:
        import resource
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    limit = hard
    if seconds is not None:
        limit = math.ceil(used.ru_utime + used.ru_stime + cpu_count() * seconds) + PROCESSOR_MARGIN_S
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_CPU, (limit, hard))


def _portable(error: TacbenchError | OSError) -> Exception:
    """An error that survives the way to the parent; one whose class does not becomes a plain one with its message."""
    try:
        same: Exception = pickle.loads(pickle.dumps(error))
    except Exception:
        plain = TacbenchError(str(error))
        plain.exit_code = getattr(error, "exit_code", plain.exit_code)
        return plain
    return same


_kept: Workers | None = None


def isolated(function: Callable[..., Any], *arguments: Any, seconds: float | None = None) -> Any:
    """Run a module-level function in a child, which is kept for the next call, and wait for its result.

    For libraries that end the whole process on damaged data, or that never come back.

    Args:
        function: As of :meth:`Workers.submit`.
        arguments: Likewise.
        seconds: Likewise.

    Raises:
        LostProcessError: The child was lost, or ended because it took too long. What the function raises comes through.
    """
    global _kept
    if _kept is None:
        _kept = Workers(1, MAX_ISOLATED_MB * limits_factor())
        atexit.register(_kept.close)
    workers = _kept
    try:
        return workers.submit(function, *arguments, seconds=seconds).result()
    except KeyboardInterrupt:
        _kept = None
        workers.close()
        raise


def why_not_importable(modules: tuple[str, ...]) -> str | None:
    """Import modules, to find out whether that works here; meant to be run in a child.

    Returns:
        The reason why one of them cannot be imported, or None.
    """
    for name in modules:
        try:
            importlib.import_module(name)
        except ImportError as error:
            return f"{name}: {one_line(error)}"
    return None
