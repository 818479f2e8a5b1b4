"""Work on many processes: of this machine (joblib's loky), or of a Dask cluster that is there already.

Needs joblib, and for a cluster the extra ``dask``. The functions that are handed out read run folders themselves, so
every worker of a cluster must have this version of tacbench-cad and see the folders under the same paths, as on a
shared file system; :func:`workers` makes sure of both before any work is sent.
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

#: Seconds within which a scheduler, and then its workers, must answer.
ANSWER_S = 10.0


@dataclass(frozen=True, eq=False)
class Executor:
    """Processes that take calls.

    Args:
        jobs: Calls that run at once.
        parallel: A ``joblib.Parallel`` that gives results one after another, in the order of the calls.
        lost: What it raises where processes are lost.
        what: What was lost then, as the beginning of a sentence.
    """

    jobs: int
    parallel: Any
    lost: tuple[type[Exception], ...]
    what: str

    def __call__(self, calls: Iterable[Any]) -> Iterator[Any]:
        """Results of ``joblib.delayed`` calls, in their order, each as soon as those before it are there.

        Raises:
            CheckFailedError: A process was lost. What the calls themselves raise comes through as it is.
        """
        try:
            with _closing(self.parallel(calls)) as results:
                # "yield from" would end them itself, and the warning would be out.
                for result in results:  # noqa: UP028
                    yield result
        except self.lost as error:
            reason = str(error).strip().splitlines()
            raise CheckFailedError(f"{self.what}: {reason[0] if reason else type(error).__name__}") from error

    def map(self, function: Callable[[T], R], items: Iterable[T]) -> Iterator[R]:
        """Results of a function that can be pickled, in the order of its arguments."""
        from joblib import delayed

        yield from self(delayed(function)(one) for one in items)


@contextlib.contextmanager
def _closing(results: Any) -> Iterator[Any]:
    """Results that end with the block. Where an interruption leaves some untaken, joblib warns of calls given up."""
    try:
        yield results
    finally:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", r".*You could benefit from adjusting the input task", UserWarning)
            results.close()


@contextlib.contextmanager
def workers(jobs: int = 1, dask: str | None = None, folders: Sequence[Path] = ()) -> Iterator[Executor]:
    """Have processes that take calls; leaving ends what still runs.

    Args:
        jobs: Processes of this machine; 1 stays in this process. A cluster has its own number, and this one is then
            not used. With a cluster of one thread joblib stays in this process as well.
        dask: Address of a Dask scheduler: ``tcp://10.0.0.5:8786``. None for this machine.
        folders: Folders that every worker of the cluster must see.

    Raises:
        InputError: ``jobs`` is below 1, nothing answers at the address, the scheduler has no worker, or a worker has
            another version of tacbench-cad or lacks a folder.
        MissingToolError: Dask is not installed.
    """
    if jobs < 1:
        raise InputError("jobs", jobs, "must be at least 1")
    from joblib import Parallel, parallel_config

    if dask is None:
        from joblib.externals.loky.process_executor import BrokenProcessPool

        what = "a process was lost; was the memory full? fewer --jobs need less"
        # loky starts "python -m joblib...": a joblib.py in the current folder must not be taken for it.
        with safe_children(), parallel_config(backend="loky"):
            yield Executor(jobs, Parallel(n_jobs=jobs, return_as="generator"), (BrokenProcessPool,), what)
        return
    with _connected(dask) as client:
        count = _ready(client, dask, folders)
        with parallel_config(backend="dask", client=client, wait_for_workers_timeout=ANSWER_S):
            from distributed import CancelledError, KilledWorker
            from distributed.comm import CommClosedError

            lost = (CancelledError, KilledWorker, CommClosedError)
            what = f"the Dask cluster at {dask} was lost; what was finished is kept"
            yield Executor(count, Parallel(n_jobs=count, return_as="generator"), lost, what)


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """A client of a scheduler that answers.

    Raises:
        InputError: None does within :data:`ANSWER_S`.
        MissingToolError: Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise MissingToolError('--dask needs Dask: pip install "tacbench-cad[dask]"') from None
    how = f"no Dask scheduler answers there within {ANSWER_S:g} s; start one with `dask scheduler`, as tcp://HOST:8786"
    try:
        # A thread of its own: a notebook has a running event loop in this one.
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
    """Shake hands with a scheduler and leave; ``Client`` waits for ever where something listens and never answers."""
    from distributed.core import connect

    comm = await asyncio.wait_for(connect(address, timeout=ANSWER_S), ANSWER_S)
    await comm.close()


def _ready(client: Client, address: str, folders: Sequence[Path]) -> int:
    """Threads of a cluster whose every worker can do our work.

    Raises:
        InputError: There is none, or one cannot.
    """
    try:
        client.wait_for_workers(1, timeout=ANSWER_S)
    except TimeoutError:
        how = f"the scheduler has no worker after {ANSWER_S:g} s; start some with `dask worker {address}`"
        raise InputError("dask", address, how) from None
    wanted = [str(one.absolute()) for one in folders]
    for worker, found in client.run(_look, wanted, on_error="return").items():
        if isinstance(found, Exception):
            raise InputError(
                "dask", address, f"worker {worker} cannot run tacbench-cad {__version__}; install it there: {found}"
            )
        version, missing = found
        if version != __version__:
            how = f"worker {worker} has tacbench-cad {version}; install {__version__} there"
            raise InputError("dask", address, how)
        if missing:
            raise InputError(
                "dask", address, f"worker {worker} does not see {missing}; every worker needs the folder at this path"
            )
    return sum(client.ncores().values())


def _look(folders: Sequence[str]) -> tuple[str, str | None]:
    """What a worker has: its version of tacbench-cad, and the first folder that it does not see."""
    return __version__, next((one for one in folders if not Path(one).is_dir()), None)
