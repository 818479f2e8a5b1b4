"""Options and fixtures for all tests, with the option for the long tests."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

# A process that a shell without job control starts in the background ignores interruptions, and so do its children. The
# tests that interrupt a command would then wait forever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="also run the long tests (make test-long)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--long"):
        return
    full = [item for item in items if "long" in item.keywords]
    config.hook.pytest_deselected(items=full)
    items[:] = [item for item in items if "long" not in item.keywords]


@pytest.fixture(scope="session", autouse=True)
def one_processor() -> Iterator[None]:
    """Let commands start only one child process by default, because each child loads its packages again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHON_CPU_COUNT", os.environ.get("PYTHON_CPU_COUNT", "1"))
        yield


@pytest.fixture
def two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands use two child processes."""
    monkeypatch.setenv("PYTHON_CPU_COUNT", "2")


@pytest.fixture
def rig_time(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run virtual rigs in this process on a fake clock, and return the clock (:mod:`helpers.rig_here`)."""
    pytest.importorskip("serial")
    from helpers.rig_here import fake_time

    return fake_time(monkeypatch)


@pytest.fixture
def no_preview(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write an empty preview in ``make``, for tests of other results."""
    pictures = "tacbench_cad.render.pictures.preview_sheet"
    monkeypatch.setattr(pictures, lambda items, path: path.write_bytes(b"") and None)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write empty figures in an analysis, for tests of other results, because drawing takes most of the time."""
    from PIL import Image

    def save(figure: object, path: Path, box: object = None, about: str = "") -> None:
        if path.suffix == ".png":
            Image.new("1", (640, 480)).save(path)
        else:
            path.write_bytes(b"%PDF")

    monkeypatch.setattr("tacbench_cad.util.plotting.save_figure", save)
