"""Every kind of file, damaged at random: it is read or refused in one line, in 30 s and 2 GB, whatever is in it."""

from __future__ import annotations

import shutil
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers.file_kinds import KINDS, read
from helpers.mutations import Mutation, mutations
from hypothesis import HealthCheck, given, settings

from tacbench_cad.util.errors import TacbenchError
from tacbench_cad.util.processes import Workers

#: What one case may take.
MAX_SECONDS, MAX_MB = 30.0, 2000
#: Cases of each kind in ``make test``, and in ``make test-long``.
FEW, MANY = 6, 5000


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    """A child that reads; it is replaced when it dies."""
    with Workers(1, MAX_MB) as children:
        yield children


def _made(name: str, folder: Path) -> Path:
    for module in {"step": ("OCP",), "3mf": ("lib3mf",), "png": ("cv2",), "run": ("cv2",), "targets": ("cv2",)}.get(
        name, ()
    ):
        pytest.importorskip(module)
    folder.mkdir()
    KINDS[name].make(folder)
    return folder


def _storm(name: str, cases: int, workers: Workers, folder: Path) -> Counter[str]:
    """How many changed files were read as the whole one is, how many otherwise, and how many were refused."""
    kind = KINDS[name]
    outcomes: Counter[str] = Counter()
    whole = _made(name, folder)
    original = (whole / kind.file).read_bytes()
    expected = workers.submit(read, name, whole).result()

    @settings(
        max_examples=cases, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    @given(mutations())
    def storm(changes: list[Mutation]) -> None:
        content = original
        for change in changes:
            content = change(content)
        (whole / kind.file).write_bytes(content[: 4 << 20])
        try:
            result = workers.submit(read, name, whole, seconds=MAX_SECONDS).result()
            outcomes["read alike" if result == expected else "read otherwise"] += 1
        except (TacbenchError, OSError) as error:
            text = str(error)
            assert "took longer than" not in text and "was ended by" not in text and "ended with code" not in text, text
            assert isinstance(error, TacbenchError) and "\n" not in text and len(text) < 2000, text
            outcomes["refused"] += 1

    storm()
    (whole / kind.file).write_bytes(original)
    workers.submit(read, name, whole, seconds=MAX_SECONDS).result()  # and the child is still of use
    return outcomes


@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_read_or_refused(name: str, workers: Workers, tmp_path: Path) -> None:
    cases = 2 if name == "step" else FEW  # each needs a child of its own where the kernel crashes
    assert _storm(name, cases, workers, tmp_path / "whole").total() >= cases


@pytest.mark.long
@pytest.mark.parametrize("name", KINDS)
def test_thousands_of_damaged_files_are_read_or_refused(name: str, workers: Workers, tmp_path: Path) -> None:
    outcomes = _storm(name, MANY, workers, tmp_path / "whole")
    print(f"{name}: {dict(outcomes)}", file=sys.stderr)
    # Every binary STL file can be read: what is wrong with it is in its report.
    assert outcomes.total() >= MANY and outcomes["refused"] + outcomes["read otherwise"]


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.harmless])
def test_a_change_that_does_not_matter_is_read_alike(name: str, tmp_path: Path) -> None:
    kind, whole = KINDS[name], _made(name, tmp_path / "whole")
    expected = kind.read(whole)
    original = (whole / kind.file).read_bytes()
    for change in kind.harmless:
        (whole / kind.file).write_bytes(change(original))
        assert kind.read(whole) == expected, change.__name__
    shutil.rmtree(whole)
