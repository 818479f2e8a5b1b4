"""Child processes: results, refusals and crashes are reported; the output of a child is discarded."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tacbench_cad.util import processes
from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.processes import LostProcessError, Workers, cpu_count, isolated, why_not_importable


def double(value: int) -> int:
    return 2 * value


def process() -> int:
    return os.getpid()


def refuse() -> None:
    raise InputError("scale", -1, "must be positive")


def fill_disk() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def fail() -> None:
    raise ZeroDivisionError("a bug in the child")


def crash() -> None:
    os._exit(7)


def chatter() -> str:
    os.write(1, b"output of a C++ library\n")
    print("output of Python")
    return "heard"


def allocate(megabytes: int) -> int:
    return len(bytearray(megabytes * 10**6)) // 10**6


def sleep() -> None:
    time.sleep(600)


@pytest.fixture(autouse=True)
def tests_are_importable_in_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    for function in (double, process, refuse, fill_disk, fail, crash, chatter, allocate, sleep):
        monkeypatch.setattr(function, "__module__", "test_processes")


def test_results_are_returned_from_other_processes() -> None:
    with Workers(2) as workers:
        assert [job.result() for job in [workers.submit(double, i) for i in range(8)]] == [0, 2, 4, 6, 8, 10, 12, 14]
        assert workers.submit(process).result() != os.getpid()


def test_a_refusal_keeps_its_message_and_exit_code() -> None:
    with Workers(1) as workers:
        with pytest.raises(InputError, match="scale = -1: must be positive") as caught:
            workers.submit(refuse).result()
        assert caught.value.exit_code == 2 and caught.value.field == "scale"
        assert workers.submit(double, 4).result() == 8, "the child must still work"


def test_an_error_of_the_file_system_keeps_its_number() -> None:
    with Workers(1) as workers, pytest.raises(OSError) as caught:
        workers.submit(fill_disk).result()
    assert caught.value.errno == errno.ENOSPC


def test_a_lost_child_is_a_failed_check_and_is_replaced() -> None:
    with Workers(1) as workers:
        with pytest.raises(CheckFailedError, match="crash ended with code 7"):
            workers.submit(crash).result()
        assert workers.submit(double, 3).result() == 6


def test_a_call_that_takes_too_long_ends_only_its_child() -> None:
    begin = time.monotonic()
    with Workers(1) as workers:
        with pytest.raises(LostProcessError, match="sleep took longer than 1 s") as caught:
            workers.submit(sleep, seconds=1.0).result()
        assert caught.value.seconds == 1.0
        assert workers.submit(double, 3, seconds=60.0).result() == 6
    assert time.monotonic() - begin < 20.0


def test_an_isolated_call_keeps_its_child_and_survives_a_crash(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_kept", None)  # a child of an earlier test would not know this module
    first = isolated(process)
    assert isolated(process) == first != os.getpid()
    with pytest.raises(LostProcessError, match="code 7") as caught:
        isolated(crash)
    assert caught.value.seconds is None
    assert isolated(double, 2) == 4


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux enforces a memory limit")
def test_a_child_can_have_a_memory_limit() -> None:
    with Workers(1, max_mb=900) as workers:
        assert workers.submit(allocate, 100).result() == 100
        with pytest.raises(LostProcessError, match="allocate needs more than 900 MB of memory"):
            workers.submit(allocate, 1000).result()
        with pytest.raises(LostProcessError, match="more than 500 MB"):
            workers.submit(allocate, 600, max_mb=500).result()
        assert workers.submit(allocate, 600).result() == 600, "the limit of a call ends with it"


def test_stray_modules_of_the_current_folder_are_not_imported(tmp_path: Path) -> None:
    for name in ("joblib", "tacbench_cad", "numpy", "pip", "json"):
        (tmp_path / f"{name}.py").write_text("import os, sys; os.write(2, b'HOSTILE'); sys.exit(9)")
    code = (
        "from tacbench_cad.lab.parallel import workers; from tacbench_cad.util.processes import isolated;"
        "from operator import neg;"
        "ok = isolated(neg, 2) == -2;"
        "context = workers(2, None, ()); executor = context.__enter__();"
        "assert ok and list(executor.map(neg, [1, 2])) == [-1, -2]; context.__exit__(None, None, None)"
    )
    completed = subprocess.run(
        [sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert (completed.returncode, completed.stdout, "HOSTILE" in completed.stderr) == (0, "", False), completed.stderr


def test_closing_ends_a_child_during_its_work() -> None:
    workers = Workers(1)
    child = workers.submit(process).result()
    workers.submit(sleep)
    workers.close()  # would take ten minutes if it waited for the child
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_the_reason_why_a_module_does_not_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "half_a_kernel.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')")
    assert why_not_importable(("sys", "half_a_kernel")) == "half_a_kernel: libGL.so.1: cannot open shared object file"
    assert why_not_importable(("sys", "json")) is None
    assert "half_a_kernel" not in sys.modules


@pytest.mark.parametrize(("text", "obeyed"), [("3", True), ("1", True), ("0", False), ("default", False), ("", False)])
def test_the_number_of_processors_is_read_from_the_environment(
    text: str, obeyed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    available = cpu_count()
    assert available >= 1
    monkeypatch.setenv("PYTHON_CPU_COUNT", text)
    assert cpu_count() == (int(text) if obeyed else available)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of processor time")
def test_the_system_ends_a_child_whose_parent_was_killed() -> None:
    script = (
        "from tacbench_cad.util import processes\n"
        "processes.PROCESSOR_MARGIN_S, processes.cpu_count = 0, lambda: 1\n"
        "with processes._limits(0.9, None):\n"
        "    while True: pass"
    )
    completed = subprocess.run([sys.executable, "-c", script], timeout=60, check=False)
    assert completed.returncode == -signal.SIGXCPU


def test_a_script_without_a_guard_is_not_run_again_in_a_child(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from operator import neg\nfrom tacbench_cad.util.processes import isolated\nprint(isolated(neg, 2))\n"
    )
    completed = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120, check=False)
    assert (completed.returncode, completed.stdout, completed.stderr) == (0, "-2\n", "")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interruption_ends_the_children_at_once_without_a_message(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import os, time\nfrom tacbench_cad.util.processes import Workers\n"
        "with Workers(2) as workers:\n"
        "    print(workers.submit(os.getpid).result(), flush=True)\n"
        "    jobs = [workers.submit(time.sleep, 600) for _ in range(3)]\n"
        "    try:\n        jobs[2].result()\n    except KeyboardInterrupt:\n        print('interrupted', flush=True)\n"
    )
    command = [sys.executable, script]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        time.sleep(0.5)
        begin = time.monotonic()
        os.killpg(parent.pid, signal.SIGINT)  # as a terminal does
        out, err = parent.communicate(timeout=60)
    assert (out, err, parent.returncode) == ("interrupted\n", "", 0)
    assert time.monotonic() - begin < 20.0
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
