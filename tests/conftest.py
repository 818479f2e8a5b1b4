"""Options and fixtures for all tests, with the option for the long tests."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import struct
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

# A process that a shell without job control starts in the background ignores interruptions, and so do its children. The
# tests that interrupt a command would then wait forever.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# glibc returns freed memory of large arrays to the system at once and requests it again for the next array. To keep it
# instead saves a tenth of the processor time. The variables set the limits in child processes, in bytes.
KEPT_BYTES = 1 << 28
if sys.platform == "linux" and (mallopt := getattr(ctypes.CDLL(None), "mallopt", None)):
    for number, name in ((-1, "MALLOC_TRIM_THRESHOLD_"), (-3, "MALLOC_MMAP_THRESHOLD_")):
        mallopt(number, KEPT_BYTES)
        os.environ.setdefault(name, str(KEPT_BYTES))


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="also run the long tests (make test-long)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--long"):
        return
    full = [item for item in items if "long" in item.keywords]
    config.hook.pytest_deselected(items=full)
    items[:] = [item for item in items if "long" not in item.keywords]


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    gc.disable()  # the imports create almost no garbage


def pytest_collection_finish() -> None:
    gc.freeze()  # imported objects stay in use, so the collector need not search them again and again
    gc.enable()


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


@pytest.fixture(scope="session", autouse=True)
def light_pdf_fonts() -> Iterator[list[tuple[dict[str, Any], Any]]]:
    """Embed letters in PDF files as shapes (type 3), because reducing TrueType fonts takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        styles = []
        if find_spec("matplotlib"):
            from tacbench_cad.extensions.drawings import ink
            from tacbench_cad.lab.analysis import figures
            from tacbench_cad.util import plotting

            for style in (plotting._STYLE, figures._STYLE, ink._STYLE):
                styles.append((style, style["pdf.fonttype"]))
                patch.setitem(style, "pdf.fonttype", 3)
        yield styles


@pytest.fixture
def own_pdf_fonts(light_pdf_fonts: list[tuple[dict[str, Any], Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Embed fonts in PDF files with the default setting, as for a user."""
    for style, kind in light_pdf_fonts:
        monkeypatch.setitem(style, "pdf.fonttype", kind)


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
    head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 640, 480)

    def save(figure: object, path: Path, box: object = None, about: str = "") -> None:
        path.write_bytes(head if path.suffix == ".png" else b"%PDF")

    monkeypatch.setattr("tacbench_cad.util.plotting.save_figure", save)
