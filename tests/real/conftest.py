"""Other people's programs and the files that they are given, shared by a whole session."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from outsiders import Run, Written, part_named, program
from resting import Exported

from tacbench_cad.assets.folder import export
from tacbench_cad.block import Block
from tacbench_cad.export import FORMATS


@pytest.fixture(scope="session")
def prusa_slicer() -> Run:
    return program("prusa-slicer", "prusa-slicer")


@pytest.fixture(scope="session")
def admesh() -> Run:
    return program("admesh", "admesh")


@pytest.fixture(scope="session")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    """Writes a part in a format, once a session, and gives the file's path."""
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
    """Exports a texture to a target, once a session, and gives the texture's folder."""
    out = tmp_path_factory.mktemp("assets")

    @cache
    def folder(texture: str, target: str) -> Path:
        return export([Block.of(texture)], [target], out / target)[0].folder

    return folder
