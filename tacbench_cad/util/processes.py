"""Child processes for slow work (CAD parts, simulated blocks) and for libraries that can crash on damaged files.

The children belong to a ``pebble.ProcessPool``. They start as new Python processes, and unlike those of
``multiprocessing`` they do not import the caller's ``__main__`` module: a user's script needs no guard.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import math
import os
import signal
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacbench_cad.util.errors import CheckFailedError, InputError, TacbenchError, one_line
from tacbench_cad.util.untrusted import LIMITS_VARIABLE, limits_factor

if TYPE_CHECKING:
    from pebble import ProcessPool

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


@contextlib.contextmanager
def safe_children() -> Iterator[None]:
    """Keep child processes that a library starts in the body from importing modules of the current folder."""
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


class Workers:
    """A set of child processes. Use it as a context manager: at its end all children are killed.

    Args:
        count: The number of children, which start with the first call.
        max_mb: The memory limit of each call, in MB; None for no limit. Systems without such limits ignore it.
    """

    def __init__(self, count: int, max_mb: float | None = None) -> None:
        self._count, self._max_mb = max(1, count), max_mb
        self._pool: ProcessPool | None = None

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Kill all children. May be called more than once."""
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()
            self._pool = None

    def submit(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        seconds: float | None = None,
        max_mb: float | None = None,
    ) -> Future[Any]:
        """Run a module-level function in a child.

        Args:
            function: The function. The child imports it by its module and name.
            arguments: The arguments. They and the result must be picklable.
            seconds: The time limit of the call; afterwards the child is killed. None for no limit.
            max_mb: The memory limit of the call, in MB; None for that of the children.

        Returns:
            A future. Its exception is the ``TacbenchError`` or ``OSError`` that the function raised, or a
            :class:`LostProcessError` if the child ended.
        """
        limit_mb = self._max_mb if max_mb is None else max_mb
        call = (function.__module__, function.__name__, arguments, seconds, limit_mb)
        future: Future[Any] = Future()
        with safe_children(), _without_interruptions():
            if self._pool is not None and not self._pool.active:  # a child has ended between two calls
                self.close()
            pool = self._pool = self._pool or _new_pool(self._count)
            pool.schedule(run_call, call, timeout=seconds).add_done_callback(
                partial(_settle, future, function.__name__, seconds)
            )
        return future


def _new_pool(count: int) -> ProcessPool:
    """Return a pool whose children do not import the caller's main module, nor modules of the current folder."""
    from joblib.externals.loky.backend.context import LokyContext  # imported here, because few commands need children
    from joblib.externals.loky.backend.process import LokyProcess
    from pebble import ProcessPool

    context = LokyContext()
    context.Process = partial(LokyProcess, env={"PYTHONSAFEPATH": "1"})
    return ProcessPool(max_workers=count, initializer=prepare_child, context=context)


@contextlib.contextmanager
def _without_interruptions() -> Iterator[None]:
    """Block SIGINT for the threads and processes that start in the body: only the main thread handles Ctrl-C."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _settle(future: Future[Any], name: str, seconds: float | None, ended: Future[Any]) -> None:
    """Give a future the result of a call that has ended, or the error that describes what went wrong."""
    from pebble import ProcessExpired

    result: Any = None
    error: BaseException | None = None
    try:
        result = ended.result()
    except ProcessExpired as expired:
        code = expired.exitcode or 0
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        hint = "; maybe the memory was full" if code == -int(getattr(signal, "SIGKILL", 9)) else ""
        error = LostProcessError(f"the process that ran {name} {how}{hint}")
    except BrokenProcessPool:
        error = LostProcessError(f"the process that should run {name} had ended before")
    except BaseException as other:  # of the function, or the pool was closed, or an argument cannot be sent
        is_late = isinstance(other, TimeoutError) and seconds is not None
        error = LostProcessError(f"{name} took longer than {seconds:g} s", seconds) if is_late else other
    with contextlib.suppress(InvalidStateError):
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)


def prepare_child() -> None:
    """Prepare a child: a kill ends it during a computation too, and its output is discarded."""
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # The kernel prints to the standard output. That must not get into the user's JSON.
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)


def run_call(module: str, name: str, arguments: tuple[Any, ...], seconds: float | None, max_mb: float | None) -> Any:
    """Run a function in a child, within its limits.

    Raises:
        LostProcessError: The function needs more memory than its limit.
        RuntimeError: The function has raised an error that is not for the user. The message is its traceback.
    """
    try:
        with _limits(seconds, max_mb):
            return getattr(importlib.import_module(module), name)(*arguments)
    except (TacbenchError, OSError):
        raise
    except Exception as error:
        if isinstance(error, MemoryError) and max_mb is not None:
            raise LostProcessError(f"{name} needs more than {max_mb:g} MB of memory", None, max_mb) from None
        raise RuntimeError(f"in a child process:\n{traceback.format_exc()}") from None


@contextlib.contextmanager
def _limits(seconds: float | None, max_mb: float | None) -> Iterator[None]:
    """Limit the processor time and the memory of this process in the body. Systems without such limits ignore them.

    The limit of processor time ends an endless computation even if the parent was killed.
    """
    try:
        import resource
    except ImportError:  # Windows
        yield
        return
    before = {which: resource.getrlimit(which) for which in (resource.RLIMIT_CPU, resource.RLIMIT_DATA)}
    limits: dict[int, float] = {}
    if seconds is not None:
        used = resource.getrusage(resource.RUSAGE_SELF)
        own_s = used.ru_utime + used.ru_stime
        limits[resource.RLIMIT_CPU] = math.ceil(own_s + cpu_count() * seconds) + PROCESSOR_MARGIN_S
    if max_mb is not None:
        limits[resource.RLIMIT_DATA] = max_mb * 1e6
    try:
        for which, limit in limits.items():
            lowest = limit if before[which][0] == resource.RLIM_INFINITY else min(limit, before[which][0])
            with contextlib.suppress(OSError, ValueError):
                resource.setrlimit(which, (int(lowest), before[which][1]))
        yield
    finally:
        for which, pair in before.items():
            with contextlib.suppress(OSError, ValueError):
                resource.setrlimit(which, pair)


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
    for name in modules:
        try:
            importlib.import_module(name)
        except ImportError as error:
            return f"{name}: {one_line(error)}"
    return None
