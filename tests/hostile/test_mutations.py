"""Files of every kind with random damage are read, or refused in one line, within 30 s and 2 GB of memory."""

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

#: The time limit in s and the memory limit in MB of one case.
MAX_SECONDS, MAX_MB = 30.0, 2000
#: The number of cases of each kind in ``make test`` and in ``make test-long``.
FEW, MANY = 3, 5000


@pytest.fixture(scope="module")
def workers() -> Iterator[Workers]:
    """Return a child process that reads files. A new child replaces it if it crashes."""
    with Workers(1, MAX_MB) as children:
        yield children


def _make_sample(name: str, folder: Path) -> Path:
    needed = {"step": "OCP", "3mf": "lib3mf", "png": "cv2", "run": "cv2", "targets": "cv2"}
    needed |= {"scan ply": "trimesh"}
    if (module := needed.get(name)) is not None:
        pytest.importorskip(module)
    folder.mkdir()
    KINDS[name].make(folder)
    return folder


def _read_mutations(name: str, cases: int, workers: Workers, folder: Path) -> Counter[str]:
    """Count the damaged files that are read alike (as the original is), read otherwise, or refused."""
    kind = KINDS[name]
    outcomes: Counter[str] = Counter()
    sample = _make_sample(name, folder)
    original = (sample / kind.file).read_bytes()
    expected = workers.submit(read, name, sample).result()

    @settings(
        max_examples=cases, deadline=None, database=None, derandomize=True, suppress_health_check=list(HealthCheck)
    )
    @given(mutations())
    def read_mutation(changes: list[Mutation]) -> None:
        content = original
        for change in changes:
            content = change(content)
        (sample / kind.file).write_bytes(content[: 4 << 20])
        try:
            result = workers.submit(read, name, sample, seconds=MAX_SECONDS).result()
            outcomes["read alike" if result == expected else "read otherwise"] += 1
        except (TacbenchError, OSError) as error:
            text = str(error)
            assert "took longer than" not in text and "was ended by" not in text and "ended with code" not in text, text
            assert isinstance(error, TacbenchError) and "\n" not in text and len(text) < 2000, text
            outcomes["refused"] += 1

    read_mutation()
    (sample / kind.file).write_bytes(original)
    workers.submit(read, name, sample, seconds=MAX_SECONDS).result()  # the child still works
    return outcomes


@pytest.mark.parametrize("cases", [FEW, pytest.param(MANY, marks=pytest.mark.long)])
@pytest.mark.parametrize("name", KINDS)
def test_a_damaged_file_is_read_or_refused(name: str, cases: int, workers: Workers, tmp_path: Path) -> None:
    if name == "step" and cases == FEW:
        cases = 2  # a case that crashes the kernel needs a new child
    outcomes = _read_mutations(name, cases, workers, tmp_path / "sample")
    print(f"{name}: {dict(outcomes)}", file=sys.stderr)
    # Every binary STL file can be read. Its errors are in the report.
    assert outcomes.total() >= cases and (cases < MANY or outcomes["refused"] + outcomes["read otherwise"])


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.harmless])
def test_a_harmless_change_does_not_change_the_result(name: str, tmp_path: Path) -> None:
    kind, sample = KINDS[name], _make_sample(name, tmp_path / "sample")
    expected = kind.read(sample)
    original = (sample / kind.file).read_bytes()
    for change in kind.harmless:
        (sample / kind.file).write_bytes(change(original))
        assert kind.read(sample) == expected, change.__name__
    shutil.rmtree(sample)
