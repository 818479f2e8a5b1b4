"""``help(tacbench_cad)`` is right: its code gives what it says, what it names exists, and it costs no import."""

from __future__ import annotations

import doctest
import importlib.util
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
import typer

import tacbench_cad
from tacbench_cad import cli


def test_its_code_gives_what_it_says() -> None:
    finished = doctest.testmod(tacbench_cad, raise_on_error=False)
    assert finished.attempted >= 8
    assert finished.failed == 0


def test_what_it_names_exists() -> None:
    text = tacbench_cad.__doc__ or ""
    modules = set(re.findall(r":mod:`([\w.]+)`", text))
    assert len(modules) >= 15
    for name in modules:
        assert importlib.util.find_spec(name), name
    for name in re.findall(r":(?:func|class):`([\w.]+)`", text):
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name


def command_lines(words: list[str], one: Any) -> Iterator[list[str]]:
    """A command and those below it."""
    yield words
    for name, inner in getattr(one, "commands", {}).items():
        yield from command_lines([*words, name], inner)


@pytest.mark.parametrize("words", list(command_lines([], typer.main.get_command(cli.app))), ids=" ".join)
def test_the_help_of_a_command_doubles_nothing(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*words, "--help"]) == 0
    text = capsys.readouterr().out
    assert " ".join(["Usage: tacbench", *words]) in text
    assert not re.search(r"\[\[|\]\]|\.{4}|\.\.\.\}|default: default", text)


def test_importing_the_package_imports_nothing_else() -> None:
    code = "import sys; before = set(sys.modules); import tacbench_cad; print(*sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.split() == ["tacbench_cad"]
