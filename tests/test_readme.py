"""The README does what it says: its Python blocks run, its commands exist, its pictures and links are there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
#: A command, with its group's name where it has one, and what follows.
_COMMAND = re.compile(r"^tacbench ((?:runs|rig) [\w-]+|[\w-]+)(.*)$", re.MULTILINE)


def blocks(page: Path, language: str) -> list[str]:
    """The fenced blocks of one language."""
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


PYTHON = [
    pytest.param(page, code, id=f"{page.name}-{i}") for page in PAGES for i, code in enumerate(blocks(page, "python"))
]


@pytest.mark.parametrize(("page", "code"), PYTHON)
def test_python_blocks_run(page: Path, code: str, tmp_path: Path) -> None:
    finished = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert finished.returncode == 0, f"{page.name}:\n{code}\n{finished.stderr}"


def test_there_are_python_blocks_in_the_readme() -> None:
    assert len(blocks(ROOT / "README.md", "python")) >= 2


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_pictures_and_links_are_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_option_named_in_the_pages_exists() -> None:
    named = set()
    for page in PAGES:
        for command, rest in _COMMAND.findall("\n".join(blocks(page, "(?:bash|sh)?"))):
            named |= {(command, option) for option in re.findall(r"--[a-z][a-z-]*", rest)}
    assert named
    for command in {command for command, _ in named}:
        text = subprocess.run(
            [sys.executable, "-m", "tacbench_cad", *command.split(), "--help"],
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
            env={"COLUMNS": "200", "PATH": "/usr/bin:/bin"},
        ).stdout
        for option in {option for name, option in named if name == command}:
            assert option in text, f"tacbench {command} {option}"


def test_the_hexagonal_example_is_the_file_beside_it() -> None:
    assert blocks(ROOT / "docs" / "textures.md", "toml")[0] == (ROOT / "docs" / "hex.toml").read_text(encoding="utf-8")
