"""The help of the package and of every command: it shows what there is, and its code gives what it says."""

from __future__ import annotations

import doctest
import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import rich_click as click

import tacbench_cad
from tacbench_cad import cli
from tacbench_cad.cli.options import RENAMED


def test_its_code_gives_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    finished = doctest.testmod(tacbench_cad, raise_on_error=False)
    assert finished.attempted >= 8
    assert finished.failed == 0


def test_what_it_names_exists() -> None:
    text = tacbench_cad.__doc__ or ""
    modules = set(re.findall(r":mod:`([\w.]+)`", text))
    assert len(modules) >= 4
    for name in modules:
        assert importlib.util.find_spec(name), name
    for name in re.findall(r":(?:func|class):`([\w.]+)`", text):
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name


def command_lines(words: list[str], group: click.Group) -> Iterator[tuple[list[str], click.Command]]:
    """The commands of a group and of the groups in it, each with the words that call it."""
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


@pytest.mark.parametrize("words", [words for words, _ in COMMANDS], ids=" ".join)
def test_the_help_of_a_command_doubles_nothing(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*words, "--help"]) == 0
    text = capsys.readouterr().out
    assert " ".join(["Usage: tacbench", *words]) in text
    assert not re.search(r"\[\[|\]\]|\.{4}|\.\.\.\}|default: default", text)
    assert not re.search(r"<(bool|str|int|float|list|Path)|\b(BOOLEAN|TEXT|INTEGER|PATH)\b", text), (
        "a type of the code stands in the help"
    )


def test_the_same_thing_has_the_same_short_option_everywhere() -> None:
    long_names: dict[str, set[str]] = {}
    for words, command in COMMANDS:
        for parameter in command.params:
            names = set(parameter.opts)
            if "--out" in names:
                assert "-o" in names, words
            for short in (name for name in names if re.fullmatch(r"-\w", name)):
                long_names.setdefault(short, set()).update(names - {short})
    assert long_names == {"-o": {"--out"}}


@pytest.mark.parametrize(
    ("words", "command"), COMMANDS, ids=lambda value: " ".join(value) if isinstance(value, list) else ""
)
def test_a_help_names_only_options_that_there_are(words: list[str], command: click.Command) -> None:
    """In prose and examples: an option that is shown is one of this command, or of the command of the example."""
    options = {" ".join(words): {name for one in command.params for name in one.opts} for words, command in COMMANDS}
    everything = {name for names in options.values() for name in names} | {"--help", "--version"}
    text = command.help or ""
    assert set(re.findall(r"(?<![\w-])--[a-z-]+", text)) <= everything
    for line in re.findall(r"^  tacbench (.+)$", text, re.MULTILINE):
        called = next(name for name in sorted(options, key=len, reverse=True) if f"{line} ".startswith(f"{name} "))
        assert set(re.findall(r"(?<![\w-])--?[a-z][a-z-]*", line)) <= options[called], line


@pytest.mark.parametrize(("old", "new"), RENAMED.items())
def test_an_old_name_of_a_command_names_the_new_name(old: str, new: str, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (old.split(), [*old.split(), "--help"], [*old.split(), "a.stl", "--texture", "1"]):
        assert cli.main(words) == 2
        assert capsys.readouterr() == ("", f'error: the command "{old}" is now "{new}"\n')
    assert cli.main([*new.split(), "--help"]) == 0
