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

pytest.importorskip("joblib")

from tacbench_cad.lab import parallel
from tacbench_cad.lab.parallel import workers
from tacbench_cad.util.errors import CheckFailedError, InputError


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
def test_a_server_that_never_answers(address: str, impatient: None) -> None:
    pytest.importorskip("distributed")
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        start = time.monotonic()
        message = "no Dask scheduler answered within 1 s"
        with pytest.raises(InputError, match=message), workers(1, address.format(silent.getsockname()[1])):
            pass
        assert time.monotonic() - start < 20.0


def test_a_worker_with_another_tacbench_is_named(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    other = tmp_path / "tacbench_cad"
    other.mkdir()
    (other / "__init__.py").write_text('__version__ = "0.0.1"\n')
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
            with (
                pytest.raises(InputError, match=r"has tacbench-cad 0\.0\.1; install"),
                workers(1, cluster.scheduler_address),
            ):
                pass
        finally:
            worker.kill()
            worker.wait()


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

    from tacbench_cad import lab
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
    assert [run.folder.name for run in simulated] == [block.printed.name for block in study.blocks]
    assert len(progress) == 8 and progress[-1] == sum(images_there(run.folder) for run in simulated)
    presses = lab.read("runs")
    assert lab.variance(presses, dask=elsewhere).table.equals(lab.variance(presses).table)
    how = {"settings": lab.ClassificationSettings(hold_out=("copy",), components=5), "trials": 2}
    assert lab.classify(presses, dask=elsewhere, **how).predictions.equals(lab.classify(presses, **how).predictions)


def test_a_scheduler_without_workers(impatient: None) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None, silence_logs=50) as empty,
        pytest.raises(InputError, match="no worker after 1 s"),
        workers(1, empty.scheduler_address),
    ):
        pass
