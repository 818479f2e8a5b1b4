"""Parallel work in several processes of this machine (joblib's loky) or on a running Dask cluster.

This module needs joblib, and for a cluster the extra ``dask``. The worker processes read the run folders themselves.
Every worker of a cluster must therefore have this version of tacbench-cad, and must see the folders under the same
paths, for example on a shared file system. :func:`workers` checks both before it sends any work.
"""

from __future__ import annotations

import asyncio
import contextlib
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tacbench_cad import __version__
from tacbench_cad.util.errors import CheckFailedError, InputError, MissingToolError
from tacbench_cad.util.processes import safe_children

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")
R = TypeVar("R")

#: The time within which the scheduler, and then its workers, must answer, in s.
ANSWER_S = 10.0


@dataclass(frozen=True, eq=False)
class Executor:
    """Worker processes that run functions.

    Args:
        jobs: The number of calls that run at the same time.
        parallel: A ``joblib.Parallel`` that yields the results in the order of the calls.
        lost: The exceptions that ``parallel`` raises if it loses a process.
        what: The beginning of the error message for a lost process.
    """

    jobs: int
    parallel: Any
    lost: tuple[type[Exception], ...]
    what: str

    def __call__(self, calls: Iterable[Any]) -> Iterator[Any]:
        """Yield the results of ``joblib.delayed`` calls in the order of the calls, each as early as possible.

        Raises:
            CheckFailedError: A process was lost. Exceptions of the calls themselves are raised unchanged.
        """
        try:
            with _closing(self.parallel(calls)) as results:
                # "yield from" would close the results itself, and joblib would issue its warning.
                for result in results:  # noqa: UP028
                    yield result
        except self.lost as error:
            reason = str(error).strip().splitlines()
            raise CheckFailedError(f"{self.what}: {reason[0] if reason else type(error).__name__}") from error

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Yield the results of a function for each item, in order. The function must be picklable."""
        from joblib import delayed

        yield from self(delayed(function)(item) for item in items)


@contextlib.contextmanager
def _closing(results: Any) -> Iterator[Any]:
    """Close the results at the end of the block, without joblib's warning about calls that were not finished."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", r".*You could benefit from adjusting the input task", UserWarning)
            results.close()


@contextlib.contextmanager
def workers(jobs: int = 1, dask: str | None = None, folders: Sequence[Path] = ()) -> Iterator[Executor]:
    """Start worker processes. At the end of the ``with`` block, calls that still run are cancelled.

    Args:
        jobs: The number of processes of this machine; 1 runs everything in this process. It is not used with a
            cluster, which decides its own number. With a cluster of a single thread, joblib runs everything in this
            process too.
        dask: The address of a Dask scheduler, for example ``tcp://10.0.0.5:8786``; None for this machine.
        folders: The folders that every worker of the cluster must see.

    Raises:
        InputError: ``jobs`` is below 1, no scheduler answers at the address, the scheduler has no worker, or a worker
            has another version of tacbench-cad or does not see a folder.
        MissingToolError: Dask is not installed.
    """
    if jobs < 1:
        raise InputError("jobs", jobs, "must be at least 1")
    from joblib import Parallel, parallel_config

    if dask is None:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        what = "a worker process ended unexpectedly, perhaps because the memory was full; try fewer --jobs"
        # loky starts "python -m joblib...", which must not import a joblib.py of the current folder.
        with safe_children(), parallel_config(backend="loky"):
            yield Executor(jobs, Parallel(n_jobs=jobs, return_as="generator"), (BrokenProcessPool,), what)
        return
    with _connected(dask) as client:
        count = _ready(client, dask, folders)
        with parallel_config(backend="dask", client=client, wait_for_workers_timeout=ANSWER_S):
            from distributed import CancelledError, KilledWorker
            from distributed.comm import CommClosedError

            lost = (CancelledError, KilledWorker, CommClosedError)
            what = f"the connection to the Dask cluster at {dask} was lost; finished results are kept"
            yield Executor(count, Parallel(n_jobs=count, return_as="generator"), lost, what)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """Connect to a scheduler.

    Raises:
        InputError: No scheduler answers within :data:`ANSWER_S`.
        MissingToolError: Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingToolError('--dask needs Dask: pip install "tacbench-cad[dask]"') from None
    how = f"no Dask scheduler answered within {ANSWER_S:g} s; start `dask scheduler`, whose address is tcp://HOST:8786"
    try:
        # In another thread, because a notebook already runs an event loop in this one.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, _greet(address)).result()
        client = Client(address, timeout=f"{ANSWER_S}s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError("dask", address, how) from error
    try:
        yield client
    finally:
        client.close(timeout=ANSWER_S)


async def _greet(address: str) -> None:
    """Check that a scheduler answers. ``Client`` alone would wait for ever if another program listens at the port."""
    from distributed.core import connect

    comm = await asyncio.wait_for(connect(address, timeout=ANSWER_S), ANSWER_S)
    await comm.close()


def _ready(client: Client, address: str, folders: Sequence[Path]) -> int:
    """Check that the scheduler and the workers of a cluster can do the work, and return the number of its threads.

    Raises:
        InputError: There is no worker, one of them does not see a folder, or one of them or the scheduler has another
            version.
    """
    try:
        client.wait_for_workers(1, timeout=ANSWER_S)
    except TimeoutError:
        how = f"the scheduler has no worker after {ANSWER_S:g} s; start some with `dask worker {address}`"
        raise InputError("dask", address, how) from None
    paths = [str(folder.absolute()) for folder in folders]
    answers: dict[str, Any] = {"the scheduler": _look_on_scheduler(client)}
    answers |= {f"worker {name}": answer for name, answer in client.run(_look, paths, on_error="return").items()}
    for where, answer in answers.items():
        if isinstance(answer, Exception):
            raise InputError(
                "dask", address, f"{where} cannot run tacbench-cad {__version__}; install it there: {answer}"
            )
        version, missing = answer
        if version != __version__:
            how = f"{where} has tacbench-cad {version}; install {__version__} there"
            raise InputError("dask", address, how)
        if missing:
            raise InputError(
                "dask", address, f"{where} does not see {missing}; every worker needs the folder at this path"
            )
    return sum(client.ncores().values())


def _look_on_scheduler(client: Client) -> Any:
    """Return the answer of the scheduler, or its error.

    The scheduler reads the calls too. Calls that it cannot read would be awaited for ever. It needs no folder.
    """
    try:
        return client.run_on_scheduler(_look, [])
    except Exception as error:
        return error


def _look(folders: Sequence[str]) -> tuple[str, str | None]:
    """Return a worker's version of tacbench-cad, and the first folder that the worker does not see."""
    return __version__, next((folder for folder in folders if not Path(folder).is_dir()), None)
