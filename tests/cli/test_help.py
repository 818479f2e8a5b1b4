"""The help of the package and of every command is complete, and its examples are right."""

from __future__ import annotations

import doctest
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import rich_click as click

import tacbench_cad
from tacbench_cad import cli


def test_the_code_in_the_package_help_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    finished = doctest.testmod(tacbench_cad, raise_on_error=False)
    assert finished.attempted >= 8
    assert finished.failed == 0


def command_lines(words: list[str], group: click.Group) -> Iterator[tuple[list[str], click.Command]]:
    """Yield the commands of a group and of its subgroups, each with the words that call it."""
    context = click.Context(group)
    yield words, group
    for name in group.list_commands(context):
        inner = group.get_command(context, name)
        assert inner is not None
        if isinstance(inner, click.Group):
            yield from command_lines([*words, name], inner)
        else:
            yield [*words, name], inner


COMMANDS = list(command_lines([], cli.tacbench))
each_command = pytest.mark.parametrize(
    ("words", "command"), COMMANDS, ids=lambda value: " ".join(value) if isinstance(value, list) else ""
)


def test_short_options_have_the_same_meaning_everywhere() -> None:
    long_names: dict[str, set[str]] = {}
    for words, command in COMMANDS:
        for parameter in command.params:
            names = set(parameter.opts)
            if "--out" in names:
                assert "-o" in names, words
            for short in (name for name in names if re.fullmatch(r"-\w", name)):
                long_names.setdefault(short, set()).update(names - {short})
    assert long_names == {"-o": {"--out"}}


@each_command
def test_a_help_names_only_existing_options(words: list[str], command: click.Command) -> None:
    """Every option in the text or an example must be an option of this command or of the command in the example."""
    known = {
        " ".join(words): {name for parameter in command.params for name in parameter.opts}
        for words, command in COMMANDS
    }
    everything = {name for names in known.values() for name in names} | {"--help", "--version"}
    text = command.help or ""
    assert set(re.findall(r"(?<![\w-])--[a-z-]+", text)) <= everything
    for line in re.findall(r"^  tacbench (.+?)(?: +# .*)?$", text, re.MULTILINE):
        called = next(name for name in sorted(known, key=len, reverse=True) if f"{line} ".startswith(f"{name} "))
        assert set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", line)) <= known[called], line


@each_command
def test_every_command_prints_its_help(
    words: list[str], command: click.Command, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main([*words, "--help"]) == 0
    text = capsys.readouterr().out
    assert " ".join(["Usage: tacbench", *words]) in text
    for parameter in command.params:
        assert getattr(parameter, "help", None), parameter.name
        assert isinstance(parameter, click.Argument) or parameter.opts[0] in text
