"""Worker processes on this machine and on a real local Dask cluster."""

from __future__ import annotations

import gc
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

joblib = pytest.importorskip("joblib")


from tacbench_cad.lab import parallel
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.errors import CheckFailedError, InputError

ROOT = Path(__file__).parent.parent.parent


def free_port() -> int:
    # The scheduler imports this file, and cannot import the helpers of the tests.
    from helpers import outsiders

    return outsiders.free_port()


def square_and_process(number: int) -> tuple[int, int]:
    return number * number, os.getpid()


def refuse(number: int) -> int:
    if number == 3:
        raise InputError("number", number, "must not be three")
    return number


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Return the address of a scheduler with two worker processes."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "ANSWER_S", 1.0)


@pytest.mark.parametrize("jobs", [1, 2])
def test_results_are_in_the_order_of_the_calls(jobs: int) -> None:
    with workers(jobs) as executor:
        results = list(executor.map(square_and_process, range(6)))
    assert [square for square, _ in results] == [0, 1, 4, 9, 16, 25]
    assert ({process for _, process in results} == {os.getpid()}) == (jobs == 1)


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_error_of_a_call_is_raised_unchanged(jobs: int) -> None:
    with workers(jobs) as executor, pytest.raises(InputError) as caught:
        list(executor.map(refuse, range(6)))
    assert (caught.value.field, caught.value.value, caught.value.allowed) == ("number", 3, "must not be three")


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interruption_cancels_the_other_calls_without_a_warning(jobs: int, recwarn: pytest.WarningsRecorder) -> None:
    with pytest.raises(KeyboardInterrupt), workers(jobs) as executor:
        for square, _ in executor.map(square_and_process, range(400)):
            if square == 4:
                raise KeyboardInterrupt
    gc.collect()
    assert [str(warning.message) for warning in recwarn] == []


def end_the_process(number: int) -> int:
    os._exit(3)


def test_a_lost_process_is_reported_in_one_line() -> None:
    with workers(2) as executor, pytest.raises(CheckFailedError, match=r"^a worker process ended unexpectedly"):
        list(executor.map(end_the_process, range(4)))


def slowly(number: int) -> int:
    time.sleep(0.2)
    return number


def test_a_lost_scheduler_is_reported_in_one_line() -> None:
    pytest.importorskip("distributed")
    port = free_port()
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    module = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*module, "distributed.cli.dask_scheduler", "--port", str(port), "--no-dashboard"], **quiet
    )
    address = f"tcp://127.0.0.1:{port}"
    words = [*module, "distributed.cli.dask_worker", address, "--no-nanny", "--nthreads", "2", "--no-dashboard"]
    worker = subprocess.Popen(words, **quiet)
    try:
        with (
            workers(1, address) as executor,
            pytest.raises(CheckFailedError, match=f"^the connection to the Dask cluster at {address} was"),
        ):
            for _ in executor.map(slowly, range(50)):
                scheduler.kill()
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()


def test_the_processes_of_a_cluster_do_the_work(cluster: str, tmp_path: Path) -> None:
    with workers(1, cluster, [tmp_path]) as executor:
        results = list(executor.map(square_and_process, range(8)))
    assert executor.jobs == 2
    assert [square for square, _ in results] == [number * number for number in range(8)]
    assert os.getpid() not in {process for _, process in results}


def test_a_cluster_raises_an_error_unchanged_and_stays_usable(cluster: str) -> None:
    with workers(1, cluster) as executor, pytest.raises(InputError, match="number = 3: must not be three"):
        list(executor.map(refuse, range(6)))
    with workers(1, cluster) as executor:
        assert list(executor.map(refuse, [1, 2])) == [1, 2]


def test_a_folder_that_a_worker_cannot_see_is_named(cluster: str, tmp_path: Path) -> None:
    folder = tmp_path / "elsewhere"
    with pytest.raises(InputError, match=f"does not see {folder}"), workers(1, cluster, [folder]):
        pass


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:{}", "nonsense"])
def test_no_dask_at_the_address(address: str, impatient: None) -> None:
    pytest.importorskip("distributed")
    start = time.monotonic()
    message = "no Dask scheduler answered within 1 s"
    with pytest.raises(InputError, match=message), workers(1, address.format(free_port())):
        pass
    assert time.monotonic() - start < 20.0


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ("", "has tacbench-cad 0.0.1; install"),
        ("import sys\nsys.modules['tacbench_cad.lab'] = None\n", "cannot run tacbench-cad"),
    ],
)
def test_a_worker_with_another_tacbench_is_named(tmp_path: Path, rest: str, words: str) -> None:
    """The Python of the worker imports another tacbench-cad, with or without the modules of this version."""
    distributed = pytest.importorskip("distributed")
    other = tmp_path / "tacbench_cad"
    other.mkdir()
    (other / "__init__.py").write_text('__version__ = "0.0.1"\n' + rest)
    with distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None, silence_logs=50) as cluster:
        command = [sys.executable, "-m", "distributed.cli.dask_worker", cluster.scheduler_address, "--no-dashboard"]
        worker = subprocess.Popen(
            [*command, "--no-nanny", "--local-directory", str(tmp_path)],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            with pytest.raises(InputError, match=words), workers(1, cluster.scheduler_address):
                pass
        finally:
            worker.kill()
            worker.wait()


def test_a_scheduler_without_tacbench_is_named(tmp_path: Path) -> None:
    """Otherwise the scheduler would discard every call, and the calls would be awaited for ever."""
    pytest.importorskip("distributed")
    package = parallel.__name__.partition(".")[0]
    (tmp_path / f"{package}.py").write_text("raise ImportError('no tacbench-cad on this machine')\n")
    port = free_port()
    module = [sys.executable, "-m"]
    started = [
        subprocess.Popen(
            [*module, *words, "--no-dashboard"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(path)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for words, path in (
            (["distributed.cli.dask_scheduler", "--port", str(port)], tmp_path),
            (["distributed.cli.dask_worker", f"tcp://127.0.0.1:{port}", "--no-nanny"], ROOT),
        )
    ]
    message = "the scheduler cannot run tacbench-cad .*: no tacbench-cad on this machine"
    try:
        with pytest.raises(InputError, match=message), workers(1, f"tcp://127.0.0.1:{port}"):
            pass
    finally:
        for process in started:
            process.kill()
            process.wait()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Iterator[str]:
    """Return the address of a scheduler with two worker processes that run in another folder, as on another machine."""
    distributed = pytest.importorskip("distributed")
    folder = tmp_path / "worker"
    folder.mkdir()
    command = [sys.executable, "-m", "distributed.cli.dask_worker", "--no-dashboard", "--no-nanny", "--nthreads", "1"]
    with distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None, silence_logs=50) as cluster:
        started = [
            subprocess.Popen(
                [*command, "--local-directory", str(folder), cluster.scheduler_address],
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            for _ in range(2)
        ]
        try:
            with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
                client.wait_for_workers(2, timeout=30)
            yield cluster.scheduler_address
        finally:
            for worker in started:
                worker.kill()
                worker.wait()


def test_a_study_is_simulated_and_analysed_on_a_cluster(
    elsewhere: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run simulation, variance and classification with paths relative to a folder in which no worker runs."""
    pytest.importorskip("cv2")
    pytest.importorskip("sklearn")
    from dataclasses import replace

    from tacbench_cad.lab.analysis.classification.classify import classify
    from tacbench_cad.lab.analysis.classification.settings import ClassificationSettings
    from tacbench_cad.lab.analysis.collection import Collection
    from tacbench_cad.lab.analysis.variance.table import variance_table
    from tacbench_cad.lab.simulate.study import images_there, quick_study, simulate_study
    from tacbench_cad.spec.protocol import PressGrid

    monkeypatch.chdir(tmp_path)
    study = quick_study()
    protocol = study.protocol.changed(grid=PressGrid(x_mm=(4.0, 9.0), y_mm=(18.0, 23.0)), stationary_frames=2)
    selected = [block for block in study.blocks if block.printed.texture in ("texture-1", "texture-4")]
    blocks = [replace(block, levels=(2,)) for block in selected]
    study = replace(study, blocks=tuple(blocks), protocol=protocol)
    progress: list[int] = []
    with workers(1, elsewhere, [tmp_path]) as executor:
        simulated = simulate_study(study, Path("runs"), progress=progress.append, cluster=executor)
    assert [run.name for run in simulated] == [block.printed.name for block in study.blocks]
    assert len(progress) == 8 and progress[-1] == sum(images_there(run.folder) for run in simulated)
    collection = Collection.open([Path("runs")])
    assert variance_table(collection, dask=elsewhere).cells == variance_table(collection).cells
    settings = ClassificationSettings(hold_out=("copy",), components=5)
    for name in ("far", "near"):
        (tmp_path / name).mkdir()
    with workers(1, elsewhere) as executor:
        far = classify(collection, settings, 2, Path("far"), executor)
    with workers(1) as executor:
        near = classify(collection, settings, 2, Path("near"), executor)
    assert far.outcomes.equals(near.outcomes)


def test_a_server_that_never_answers(impatient: None) -> None:
    pytest.importorskip("distributed")
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        start = time.monotonic()
        with pytest.raises(InputError, match="no Dask scheduler answered"), workers(1, address):
            pass
        assert time.monotonic() - start < 20.0


def test_a_scheduler_without_workers(impatient: None) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None, silence_logs=50) as empty,
        pytest.raises(InputError, match="no worker after 1 s"),
        workers(1, empty.scheduler_address),
    ):
        pass
