"""Child processes: results, refusals and losses come back; nothing a child prints reaches our output."""

from __future__ import annotations

import errno
import os
import sys
import time
from pathlib import Path

import pytest

from tacbench_cad.util.errors import CheckFailedError, InputError
from tacbench_cad.util.processes import RefusedError, Workers, cpu_count, why_not_importable


def double(value: int) -> int:
    return 2 * value


def process() -> int:
    return os.getpid()


def refuse() -> None:
    raise InputError("scale", -1, "must be positive")


def fill_disk() -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def fail() -> None:
    raise ZeroDivisionError("a mistake of ours")


def crash() -> None:
    os._exit(7)


def chatter() -> str:
    os.write(1, b"what a C++ library prints\n")
    print("what Python prints")
    return "heard"


def sleep() -> None:
    time.sleep(600)


@pytest.fixture(autouse=True)
def tests_are_importable_in_children(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    for function in (double, process, refuse, fill_disk, fail, crash, chatter, sleep):
        monkeypatch.setattr(function, "__module__", "test_processes")


def test_results_come_back_from_other_processes() -> None:
    with Workers(2) as workers:
        assert [job.result() for job in [workers.submit(double, i) for i in range(8)]] == [0, 2, 4, 6, 8, 10, 12, 14]
        assert workers.submit(process).result() != os.getpid()


def test_work_for_the_first_child_is_done_by_the_first_child() -> None:
    with Workers(3) as workers:
        first = workers.submit(process, first_child=True).result()
        everyone = {workers.submit(process).result() for _ in range(12)} | {first}
        assert {workers.submit(process, first_child=True).result() for _ in range(6)} == {first}
        assert len(everyone) <= 3


def test_a_refusal_keeps_its_message_and_exit_code() -> None:
    with Workers(1) as workers:
        with pytest.raises(RefusedError, match="scale = -1: must be positive") as caught:
            workers.submit(refuse).result()
        assert caught.value.exit_code == 2
        assert workers.submit(double, 4).result() == 8, "the child must still be of use"


def test_an_error_of_the_file_system_keeps_its_number() -> None:
    with Workers(1) as workers, pytest.raises(OSError) as caught:
        workers.submit(fill_disk).result()
    assert caught.value.errno == errno.ENOSPC


def test_a_mistake_of_ours_shows_where_it_happened() -> None:
    with Workers(1) as workers, pytest.raises(RuntimeError, match="a mistake of ours"):
        workers.submit(fail).result()


def test_a_lost_child_is_a_failed_check_and_is_replaced() -> None:
    with Workers(1) as workers:
        with pytest.raises(CheckFailedError, match="crash ended with code 7"):
            workers.submit(crash).result()
        assert workers.submit(double, 3).result() == 6


def test_what_a_child_prints_goes_nowhere(capfd: pytest.CaptureFixture[str]) -> None:
    with Workers(1) as workers:
        assert workers.submit(chatter).result() == "heard"
    assert capfd.readouterr().out == ""


def test_closing_ends_a_child_in_the_middle_of_its_work() -> None:
    workers = Workers(1)
    child = workers.submit(process).result()
    workers.submit(sleep)
    workers.close()  # would hang for ten minutes if it waited
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


def test_a_call_that_no_child_has_taken_can_be_cancelled() -> None:
    with Workers(1) as workers:
        workers.submit(sleep)
        waiting = workers.submit(double, 1)
        assert waiting.cancel() and waiting.cancelled()


def test_the_reason_why_a_module_does_not_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "half_a_kernel.py").write_text("raise ImportError('libGL.so.1: cannot open shared object file')")
    assert why_not_importable(("sys", "half_a_kernel")) == "half_a_kernel: libGL.so.1: cannot open shared object file"
    assert why_not_importable(("sys", "json")) is None
    assert "half_a_kernel" not in sys.modules


@pytest.mark.parametrize(("told", "obeyed"), [("3", True), ("1", True), ("0", False), ("default", False), ("", False)])
def test_a_count_of_processors_is_taken_from_the_environment(
    told: str, obeyed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHON_CPU_COUNT", raising=False)
    own = cpu_count()
    assert own >= 1
    monkeypatch.setenv("PYTHON_CPU_COUNT", told)
    assert cpu_count() == (int(told) if obeyed else own)
