"""Child processes for slow work: CAD parts, and the blocks of a simulated study.

The Open CASCADE kernel takes seconds to import and holds Python's global lock while it computes. Parts are therefore
built in parallel child processes, and the main process never loads the kernel. A child can be ended at any time, even
during a computation, so that an interruption is quick. Children are plain ``python`` processes that exchange pickles
through pipes. Unlike the children of ``multiprocessing``, they do not import the caller's ``__main__`` module.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import math
import os
import pickle
import select
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from tacbench_cad.util.door import LIMITS_VARIABLE, limits_factor
from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError, one_line

#: The memory limit of a child of :func:`isolated`, in MB. The user's factor for all limits multiplies it.
MAX_ISOLATED_MB = 8000
#: The processor time, in s, that a child may use beyond its time limit before the system ends it.
PROCESSOR_MARGIN_S = 10


class LostProcessError(CheckFailedError):
    """A child process ended during a call.

    Attributes:
        seconds: The time limit that the call exceeded; None if the process ended for another reason.
        max_mb: The memory limit that the call exceeded, in MB; None for another reason.
    """

    def __init__(self, message: str, seconds: float | None = None, max_mb: float | None = None) -> None:
        self.seconds = seconds
        self.max_mb = max_mb
        super().__init__(message)


def child_environment() -> dict[str, str]:
    """Return environment variables for a child process that keep it from importing from the current folder."""
    return {**os.environ, "PYTHONSAFEPATH": "1"}


@contextlib.contextmanager
def safe_children() -> Iterator[None]:
    """Set the same variable in the body, for child processes that a library starts there."""
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
    """Return the number of processors to use: ``PYTHON_CPU_COUNT`` (as in Python 3.13), else those available here."""
    limit = os.environ.get("PYTHON_CPU_COUNT", "")
    if limit.isdecimal() and int(limit):
        return int(limit)
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@dataclass(frozen=True, eq=False)
class _Call:
    """A function call to be run in a child process."""

    module: str
    function: str
    arguments: tuple[Any, ...]
    first_child: bool
    seconds: float | None
    max_mb: float | None
    future: Future[Any]


def _can_copy() -> bool:
    """Return whether the system has what copies of processes need: ``fork``, and handles of processes (Linux)."""
    try:
        os.close(os.pidfd_open(os.getpid()))
    except (AttributeError, OSError):
        return False
    return hasattr(os, "fork")


class _Copy:
    """A copy of a child process, made by the child itself. It has the methods of ``subprocess.Popen`` that we need.

    Args:
        pid: The number of the process.
        stdin: The pipe to the copy.
        stdout: The pipe from the copy.
    """

    def __init__(self, pid: int, stdin: IO[bytes], stdout: IO[bytes]) -> None:
        self.stdin, self.stdout = stdin, stdout
        self._handle = os.pidfd_open(pid)  # unlike a number, a handle never means another process

    def poll(self) -> int | None:
        """Return None while the process runs. Its exit code is unknown, because it is not our own child."""
        return 0 if select.select([self._handle], [], [], 0.0)[0] else None

    def wait(self) -> int:
        """Wait until the process has ended."""
        select.select([self._handle], [], [])
        return 0

    def kill(self) -> None:
        """End the process at once."""
        with contextlib.suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._handle, signal.SIGKILL)

    def close(self) -> None:
        """Give the handle of the process back."""
        os.close(self._handle)


class Workers:
    """A set of child processes. Use it as a context manager: at its end all children are killed.

    Args:
        count: The largest number of children. A new child starts only if there is work and all others are busy.
        max_mb: The memory limit of each child, in MB; None for no limit. Systems without such limits ignore it.
        copies: The number of copies of the first child that :meth:`copy_first` makes, on systems that can copy.
    """

    def __init__(self, count: int, max_mb: float | None = None, copies: int = 0) -> None:
        self._count = max(1, count)
        self._max_mb = max_mb
        # The two ends of the pipes from and to each copy: ours, and those of the copy.
        self._pipes = [(os.pipe(), os.pipe()) for _ in range(copies if _can_copy() else 0)]
        self._copies: list[_Copy] = []
        self._changed = threading.Condition()
        self._calls: list[_Call] = []
        self._threads: list[threading.Thread] = []
        self._busy = 0
        self._children: list[subprocess.Popen[bytes] | _Copy] = []
        self._closed = False

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Kill all children. May be called more than once."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
            # The copies end before the first child, whose children they are, so that the system removes them.
            children = sorted(self._children, key=lambda child: not isinstance(child, _Copy))
            self._children = []
        for child in children:
            child.kill()
            if isinstance(child, _Copy):
                child.wait()
        for thread in self._threads:
            thread.join()
        for child in children:
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with contextlib.suppress(OSError):
                        pipe.close()
            if isinstance(child, _Copy):
                child.close()
        self._close_pipes()

    def _close_pipes(self, ours: bool = True) -> None:
        """Close pipes that no copy uses, or only the ends that belong to the copies."""
        for (theirs_in, ours_out), (ours_in, theirs_out) in self._pipes:
            for end in (theirs_in, theirs_out, *((ours_out, ours_in) if ours else ())):
                os.close(end)
        self._pipes = []

    @property
    def can_copy(self) -> bool:
        """Whether :meth:`copy_first` makes copies."""
        return bool(self._pipes)

    def copy_first(self) -> None:
        """Let the first child copy itself, with all modules that it has imported, and wait for the copies.

        A copy starts in a few milliseconds. The import of a large library can take a second. Without copies, the other
        children start in the usual way.
        """
        if not self.can_copy:
            return
        theirs = [(theirs_in, theirs_out) for (theirs_in, _), (_, theirs_out) in self._pipes]
        try:
            numbers = self.submit(copy_process, theirs, first_child=True).result()
        except LostProcessError:  # for example because of a limit on the number of processes
            self._close_pipes()
            return
        with self._changed:
            for number, ((_, ours_out), (ours_in, _)) in zip(numbers, self._pipes, strict=True):
                self._copies.append(_Copy(number, os.fdopen(ours_out, "wb"), os.fdopen(ours_in, "rb")))
            self._children += self._copies
            self._close_pipes(ours=False)

    def submit(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        first_child: bool = False,
        seconds: float | None = None,
        max_mb: float | None = None,
    ) -> Future[Any]:
        """Run a module-level function in a child.

        Args:
            function: The function. The child imports it by its module and name.
            arguments: The arguments. They and the result must be picklable.
            first_child: Run it only in the first child, before any other call. This is for work that needs a package
                that only the first child has imported.
            seconds: The time limit of the call; afterwards the child is killed. None for no limit.
            max_mb: The memory limit of the call, in MB; None for that of the children.

        Returns:
            A future, which can be cancelled until the call starts. Its exception is the ``TacbenchError`` or
            ``OSError`` that the function raised, or a :class:`LostProcessError` if the child ended.
        """
        future: Future[Any] = Future()
        with self._changed:
            limit_mb = self._max_mb if max_mb is None else max_mb
            call = _Call(function.__module__, function.__name__, arguments, first_child, seconds, limit_mb, future)
            self._calls.append(call)
            if len(self._calls) > len(self._threads) - self._busy and len(self._threads) < self._count:
                number = len(self._threads)
                thread = threading.Thread(target=self._attend, args=(number,), name=f"tacbench-{number}", daemon=True)
                self._threads.append(thread)
                thread.start()
            self._changed.notify_all()
        return future

    def _attend(self, number: int) -> None:
        """Pass calls to a child, one after another. Each child has a thread that runs this method."""
        child: subprocess.Popen[bytes] | _Copy | None = None
        while True:
            call = self._next(number)
            if call is None:
                return
            if not call.future.set_running_or_notify_cancel():
                self._free()
                continue
            try:
                if child is not None and child.poll() is not None:  # it has ended since its last call
                    child = None
                child = child or self._start()
                result = self._ask(child, call)
            except BaseException as error:
                self._free()
                call.future.set_exception(error)
            else:
                self._free()
                call.future.set_result(result)

    def _free(self) -> None:
        """Count a thread as free. This happens before its result is set, so that the next call needs no new child."""
        with self._changed:
            self._busy -= 1

    def _next(self, number: int) -> _Call | None:
        """Wait for the next call of a thread and return it; None after :meth:`close`."""

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

    def _ask(self, child: subprocess.Popen[bytes] | _Copy, call: _Call) -> Any:
        assert child.stdin is not None and child.stdout is not None, "both are pipes"
        late, answered, deciding = threading.Event(), threading.Event(), threading.Lock()

        def end() -> None:
            with deciding:  # a child that has just answered belongs to the next call
                if not answered.is_set():
                    late.set()
                    child.kill()

        timer = None if call.seconds is None else threading.Timer(call.seconds, end)
        try:
            if timer is not None:
                timer.start()
            pickle.dump((call.module, call.function, call.arguments, call.seconds, call.max_mb), child.stdin)
            child.stdin.flush()
            outcome, value = pickle.load(child.stdout)
            with deciding:
                answered.set()
            if late.is_set():
                child.wait()  # killed while its answer was read, so that the next call must start another child
        except (EOFError, BrokenPipeError, pickle.UnpicklingError):
            code = child.wait()
            if late.is_set():
                raise LostProcessError(f"{call.function} took longer than {call.seconds:g} s", call.seconds) from None
            how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
            how = "ended" if isinstance(child, _Copy) else how
            hint = "; maybe the memory was full" if code == -int(getattr(signal, "SIGKILL", 9)) else ""
            raise LostProcessError(f"the process that ran {call.function} {how}{hint}") from None
        finally:
            if timer is not None:
                timer.cancel()
        if outcome == "done":
            return value
        if outcome == "raised":
            raise value
        if outcome == "full":
            raise LostProcessError(f"{call.function} needs more than {call.max_mb:g} MB of memory", None, call.max_mb)
        raise RuntimeError(f"in a child process:\n{value}")

    def _start(self) -> subprocess.Popen[bytes] | _Copy:
        # The child gets our own sys.path; -P keeps it from importing, say, a numpy.py in the current folder.
        code = f"import sys; sys.path[:] = {sys.path!r}; from tacbench_cad.util.processes import serve; serve()"
        with self._changed:
            if self._closed:
                raise EOFError
            if self._copies:
                return self._copies.pop()
            # Only the first child gets the pipes, because a pipe ends when the last process has closed it.
            pipes = self._pipes if not self._children else []
            child = subprocess.Popen(
                [sys.executable, "-P", "-c", code],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=child_environment(),
                pass_fds=[end for (theirs_in, _), (_, theirs_out) in pipes for end in (theirs_in, theirs_out)],
            )
            self._children.append(child)
        return child


def serve() -> None:
    """Run in a child: read a call, run it and write the result, until the pipe is closed."""
    own_limit = _memory_limit()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles an interruption and kills this process
    calls: IO[bytes] = sys.stdin.buffer
    answers: IO[bytes] = os.fdopen(os.dup(1), "wb")
    # The kernel prints to the standard output. That must not get into our results or the user's JSON.
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    while True:
        try:
            module, name, arguments, seconds, max_mb = pickle.load(calls)
        except EOFError:
            return
        if name == copy_process.__name__:
            own = copy_process(*arguments)
            if isinstance(own, tuple):
                calls.close()
                answers.close()
                calls, answers = own
                continue
            pickle.dump(("done", own), answers)
            answers.flush()
            continue
        _limit_processor_time(seconds)
        _limit_memory(max_mb, own_limit)
        outcome: tuple[str, Any]
        try:
            outcome = ("done", getattr(importlib.import_module(module), name)(*arguments))
        except (TacbenchError, OSError) as error:
            outcome = ("raised", _portable(error))
        except MemoryError:
            outcome = ("full" if max_mb is not None else "failed", traceback.format_exc())
        except Exception:
            outcome = ("failed", traceback.format_exc())
        _limit_memory(None, own_limit)
        pickle.dump(outcome, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


def copy_process(pipes: Sequence[tuple[int, int]]) -> list[int] | tuple[IO[bytes], IO[bytes]]:
    """Copy this process.

    Args:
        pipes: For each copy, the end of a pipe to read from, and the end of a pipe to write to.

    Returns:
        The numbers of the copies; in a copy, its own two pipes.
    """
    numbers = []
    for place, (read, write) in enumerate(pipes):
        number = os.fork()
        if number == 0:
            for end in (end for pair in pipes[place + 1 :] for end in pair):
                os.close(end)
            return os.fdopen(read, "rb"), os.fdopen(write, "wb")
        os.close(read)
        os.close(write)
        numbers.append(number)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # the system removes copies that have ended
    return numbers


def _memory_limit() -> float:
    """Return the memory limit that this process already has, in MB; infinity if it has none."""
    try:
        import resource
    except ImportError:  # Windows
        return math.inf
    soft = resource.getrlimit(resource.RLIMIT_DATA)[0]
    return math.inf if soft == resource.RLIM_INFINITY else soft / 1e6


def _limit_memory(max_mb: float | None, own_mb: float) -> None:
    """Limit the memory of this process, in MB.

    Args:
        max_mb: The limit; None for no limit.
        own_mb: The limit that the process had at its start, which is kept if it is lower.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    limit = min(math.inf if max_mb is None else max_mb, own_mb)
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_DATA, (int(limit * 1e6) if limit < math.inf else hard, hard))


def _limit_processor_time(seconds: float | None) -> None:
    """Limit the processor time of this child, so that an endless computation ends even if the parent was killed."""
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
    """Return the error if it can be pickled, otherwise a ``TacbenchError`` with the same message."""
    try:
        same: Exception = pickle.loads(pickle.dumps(error))
    except Exception:
        plain = TacbenchError(str(error))
        plain.exit_code = getattr(error, "exit_code", plain.exit_code)
        return plain
    return same


_kept: Workers | None = None


def isolated(
    function: Callable[..., Any], *arguments: Any, seconds: float | None = None, max_mb: float | None = None
) -> Any:
    """Run a module-level function in a child process and wait for its result.

    This is for libraries that may crash or hang on damaged data. The child is kept for the next call.

    Args:
        function: Same as for :meth:`Workers.submit`.
        arguments: Same as for :meth:`Workers.submit`.
        seconds: Same as for :meth:`Workers.submit`.
        max_mb: Same as for :meth:`Workers.submit`.

    Raises:
        LostProcessError: The child ended, or the call took too long or too much memory. Errors of the function are
            raised as they are.
    """
    global _kept
    if _kept is None:
        _kept = Workers(1, MAX_ISOLATED_MB * limits_factor())
        atexit.register(_kept.close)
    workers = _kept
    try:
        return workers.submit(function, *arguments, seconds=seconds, max_mb=max_mb).result()
    except KeyboardInterrupt:
        _kept = None
        workers.close()
        raise


def read_isolated(
    path: Path,
    library: str,
    limits_s: tuple[float, float],
    function: Callable[..., Any],
    *arguments: Any,
    limits_mb: tuple[float, float] | None = None,
) -> Any:
    """Call a function that reads an untrusted file in a child process. A damaged file can crash or block its library.

    Args:
        path: The file, for its size and for error messages.
        library: The name of the library, for error messages: ``the CAD kernel``.
        limits_s: The time limit in s, and the additional time for each MB of the file.
        function: Same as for :meth:`Workers.submit`.
        arguments: Same as for :meth:`Workers.submit`.
        limits_mb: The memory limit in MB, and the additional memory for each MB of the file; None for
            :data:`MAX_ISOLATED_MB`.

    Raises:
        InputError: The file crashes the library, or the library takes too much time or memory to read it.
    """
    megabytes = path.stat().st_size / 1e6 if path.is_file() else 0.0
    seconds = limits_factor() * (limits_s[0] + limits_s[1] * megabytes)
    max_mb = None if limits_mb is None else limits_factor() * (limits_mb[0] + limits_mb[1] * megabytes)
    try:
        return isolated(function, *arguments, seconds=seconds, max_mb=max_mb)
    except LostProcessError as error:
        advice = f"export it again, or set the environment variable {LIMITS_VARIABLE}=2 to double this limit"
        what = f"crashes {library}, because it is damaged or malicious; export it again"
        if error.seconds is not None:
            what = f"takes {library} longer than {seconds:.0f} s; {advice}"
        elif error.max_mb is not None:
            what = f"needs more than {error.max_mb:,.0f} MB of memory to be read; {advice}"
        raise InputError("file", str(path), what) from None


def why_not_importable(modules: tuple[str, ...]) -> str | None:
    """Try to import modules; meant to be run in a child.

    Returns:
        The error of the first module that cannot be imported, or None.
    """
    collects = gc.isenabled()
    gc.disable()  # it would examine the many objects of a large library again and again
    try:
        for name in modules:
            try:
                importlib.import_module(name)
            except ImportError as error:
                return f"{name}: {one_line(error)}"
        return None
    finally:
        if collects:
            gc.freeze()
            gc.enable()
