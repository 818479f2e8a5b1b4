"""Fixtures for programs of other projects and for their input files, each made once per session."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from helpers.checkout import ROOT, Fill, Once, versioned_files
from helpers.outsiders import Run, Written, part_named, program
from helpers.resting import Exported

from tacbench_cad.extensions.simulators.folder import export_to_simulators
from tacbench_cad.formats import FORMATS
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import locked

#: Options for WebGL without a graphics card, as on a machine without a screen.
_FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return Chromium, controlled by Playwright."""
    api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: pip install playwright")
    path = shutil.which("chromium")
    if path is None:
        pytest.skip("chromium is not installed: apt-get install chromium")
    # Chromium's sandbox does not work for the superuser, and containers run as the superuser.
    flags = [*_FLAGS, "--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else _FLAGS
    with api.sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=path, args=flags)
        yield running
        running.close()


@pytest.fixture(scope="session")
def prusa_slicer() -> Run:
    return program("prusa-slicer", "prusa-slicer")


@pytest.fixture(scope="session")
def admesh() -> Run:
    return program("admesh", "admesh")


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Return a function that writes a part in a format, once per session, and returns the path of the file."""
    folder = tmp_path_factory.mktemp("parts")

    @cache
    def write(name: str, form: str) -> Path:
        reason = FORMATS[form].why_missing()
        if reason is not None:
            pytest.skip(f"{form} cannot be written here: {reason}")
        path = folder / f"{name}{FORMATS[form].suffix}"
        FORMATS[form].write(part_named(name), path)
        return path

    return write


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    """Return a function that exports a texture to a target, once per session, and returns the folder of the texture."""
    out = tmp_path_factory.mktemp("assets")

    @cache
    def folder(texture: str, target: str) -> Path:
        return export_to_simulators([Block.of(texture)], [target], out / target)[0].folder

    return folder


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """Return a function that fills a folder once. If several processes run the tests, the first one fills it, and the
    others wait.
    """
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def make(name: str, fill: Fill) -> Path:
        folder, complete = shared / name, shared / f"{name}-lock" / "complete"
        while True:
            try:
                with locked(complete.parent):
                    if not complete.exists():
                        shutil.rmtree(folder, ignore_errors=True)
                        folder.mkdir()
                        fill(folder)
                        complete.touch()
                    return folder
            except InputError as error:
                if "another tacbench" not in error.allowed:
                    raise
                time.sleep(0.5)

    return make


@pytest.fixture(scope="session")
def source(once: Once) -> Path:
    """Return a copy of the project with only the versioned files."""

    def fill(folder: Path) -> None:
        for name in versioned_files():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)

    return once("source", fill)
