"""Test folders that cannot be written: exit code 2, a one-line message, and no change of the recorded data."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from helpers.rigs import FakeRig, printed, rig_settings, small_protocol, study_of

from tacbench_cad.cli import main
from tacbench_cad.lab.acquire.person import Typing
from tacbench_cad.lab.acquire.progress import PressProgress
from tacbench_cad.lab.acquire.session import acquire_study
from tacbench_cad.lab.rig.errors import NoAnswerError
from tacbench_cad.lab.rig.gauge import Force
from tacbench_cad.lab.runs.reading import Run
from tacbench_cad.util.errors import InputError

pytestmark = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0,
    reason="root may write everywhere, and Windows has other permissions",
)


class ThreePresses(PressProgress):
    """A progress report that raises an error of the gauge after the third press."""

    def pressed(self, done: int, force: Force | None, in_band: bool | None, reading: Path) -> None:
        if done == 3:
            raise NoAnswerError("gauge: sends no data")


def session(out: Path, progress: PressProgress) -> None:
    study = study_of(small_protocol(repeats=1, stationary_frames=1), 1)
    rig = FakeRig()
    acquire_study(
        study,
        rig_settings(),
        out,
        person=Typing(lambda _: "t1 paper x1 01", lambda _: None),
        progress=progress,
        durable=False,
        opener=rig.opener,
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    """Return an output folder with a run that was interrupted after three presses."""
    with pytest.raises(NoAnswerError):
        session(tmp_path, ThreePresses())
    return tmp_path


@contextmanager
def read_only(folder: Path) -> Iterator[None]:
    folder.chmod(0o500)
    try:
        yield
    finally:
        folder.chmod(0o700)


def test_a_read_only_output_folder_is_refused(interrupted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(interrupted)
    with read_only(interrupted):
        for out in (interrupted, interrupted / "inner"):
            assert main(["acquire", "--virtual", "--out", str(out)]) == 2
            output, error = capsys.readouterr()
            assert output == ""
            assert error.count("\n") == 1 and error.startswith("error: ")
            assert "not writable" in error and str(interrupted) in error
        assert contents(interrupted) == before


@pytest.mark.parametrize("inner", ["", "sensor_images"])
def test_a_run_is_resumed_when_its_folder_is_writable_again(interrupted: Path, inner: str) -> None:
    run = interrupted / printed().name
    before = contents(run)
    assert len(Run.open(run).rows) == 3
    with read_only(run / inner), pytest.raises(InputError, match="not writable") as caught:
        session(interrupted, PressProgress())
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    after = contents(run)
    # Tables may have grown, but their old rows and all images are unchanged.
    assert all(after[name].startswith(content) for name, content in before.items())
    session(interrupted, PressProgress())
    assert [row.number for row in Run.open(run).rows] == list(range(1, 9))
