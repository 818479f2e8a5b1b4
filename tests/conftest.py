"""Shared by all tests: the switch between small and full counts."""

from __future__ import annotations

import gc
import os
import signal
import struct
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

# Started in the background of a shell without job control, a process ignores interruptions, and so does all that it
# starts: the tests that interrupt a command would wait for nothing.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="run the full counts too (make test-long)")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--long"):
        return
    full = [item for item in items if "long" in item.keywords]
    config.hook.pytest_deselected(items=full)
    items[:] = [item for item in items if "long" not in item.keywords]


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    gc.disable()  # next to nothing of what the imports make is garbage


def pytest_collection_finish() -> None:
    gc.freeze()  # nor does it become garbage during the tests: no need to look through it again and again
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def one_processor() -> Iterator[None]:
    """Commands start one child process unless a test asks for more: each loads its packages again."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHON_CPU_COUNT", os.environ.get("PYTHON_CPU_COUNT", "1"))
        yield


@pytest.fixture
def two_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands share their work among two child processes."""
    monkeypatch.setenv("PYTHON_CPU_COUNT", "2")


@pytest.fixture(scope="session", autouse=True)
def light_pdf_fonts() -> Iterator[list[tuple[dict[str, Any], Any]]]:
    """Embed letters in PDF files as shapes (type 3): cutting TrueType fonts to size takes longer than all the rest."""
    with pytest.MonkeyPatch.context() as patch:
        styles = []
        if find_spec("matplotlib"):
            from tacbench_cad.lab.analysis import figures
            from tacbench_cad.render.drawing import ink
            from tacbench_cad.util import plotting

            for style in (plotting._STYLE, figures._STYLE, ink._STYLE):
                styles.append((style, style["pdf.fonttype"]))
                patch.setitem(style, "pdf.fonttype", 3)
        yield styles


@pytest.fixture
def own_pdf_fonts(light_pdf_fonts: list[tuple[dict[str, Any], Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Embed fonts in PDF files as a user's own process does."""
    for style, kind in light_pdf_fonts:
        monkeypatch.setitem(style, "pdf.fonttype", kind)


@pytest.fixture
def no_preview(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the sheet of pictures empty that ``make`` draws of its parts, where a test is not about it."""
    pictures = "tacbench_cad.render.pictures.preview_sheet"
    monkeypatch.setattr(pictures, lambda items, path: path.write_bytes(b"") and None)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave figures of an analysis empty where a test is not about them: drawing takes longer than all the rest."""
    head = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 640, 480)

    def save(figure: object, path: Path, box: object = None, about: str = "") -> None:
        path.write_bytes(head if path.suffix == ".png" else b"%PDF")

    monkeypatch.setattr("tacbench_cad.util.plotting.save_figure", save)
