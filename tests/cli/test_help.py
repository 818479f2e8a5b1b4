"""The help of the package and of every command: it fits the terminal, is complete, and its examples are right."""

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
from tacbench_cad.cli import options


def test_the_code_in_the_package_help_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    finished = doctest.testmod(tacbench_cad, raise_on_error=False)
    assert finished.attempted >= 8
    assert finished.failed == 0


def test_names_in_the_package_help_exist() -> None:
    text = tacbench_cad.__doc__ or ""
    modules = set(re.findall(r":mod:`([\w.]+)`", text))
    assert len(modules) >= 4
    for name in modules:
        assert importlib.util.find_spec(name), name
    for name in re.findall(r":(?:func|class):`([\w.]+)`", text):
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name


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


#: The last line of the frame of a panel, and the characters of frames.
FRAME = "╭╮╰╯─│"


def shown_help(words: list[str], columns: int, capsys: pytest.CaptureFixture[str], patch: pytest.MonkeyPatch) -> str:
    patch.setenv("COLUMNS", str(columns))
    assert cli.main([*words, "--help"]) == 0
    return capsys.readouterr().out


@each_command
def test_a_help_fits_its_terminal(
    words: list[str], command: click.Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for columns in (80, 120, 200):
        text = shown_help(words, columns, capsys, monkeypatch)
        lines = [line.strip().strip(FRAME).strip() for line in text.splitlines()]
        assert max(map(len, text.splitlines())) <= min(columns, 100)
        # Each example and each item of a list has its own line, as in the source.
        for line in re.findall(r"^(?:  |- ).+$", command.help or "", re.MULTILINE):
            assert line.strip() in lines, line
    assert " ".join(["Usage: tacbench", *words]) in text
    assert not re.search(r"\[\[|\]\]|\.{4}|\.\.\.\}|[Dd]efault: default|\[(default|required)", text)
    assert not re.search(r"<(bool|str|int|float|list|Path)|\b(BOOLEAN|TEXT|INTEGER|PATH)\b", text), (
        "the help contains a type name of the code"
    )


@each_command
def test_a_summary_fits_one_line_of_the_list(
    words: list[str], command: click.Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if words:
        summary = (command.help or "").split("\n")[0]
        listed = shown_help(words[:-1], 80, capsys, monkeypatch)
        assert summary.endswith(".") and summary[0].isupper()
        assert re.search(rf"│ {words[-1]} +{re.escape(summary)} +│", listed)


@each_command
def test_every_option_is_described_in_a_panel_and_help_is_last(
    words: list[str], command: click.Command, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for parameter in command.params:
        text = getattr(parameter, "help", None)
        assert text and text.endswith("."), parameter.name
        assert isinstance(parameter, click.Argument) or parameter.name == "version" or parameter.panel in options.PANELS
        assert text.count("Default:") <= 1 and "default:" not in text
    lines = shown_help(words, 80, capsys, monkeypatch).rstrip().splitlines()
    assert "--help  Show this message" in lines[-2]
    assert sum("--help  Show" in line for line in lines) == 1


def test_each_command_is_under_a_heading() -> None:
    names = cli.tacbench.list_commands(click.Context(cli.tacbench))
    assert len(names) == len(set(names)) > 25
    for name in names:
        assert {words[0]: command.panel for words, command in COMMANDS if len(words) == 1}[name] in cli.PANELS
    files = {path.stem for path in Path(cli.__file__).parent.glob("*.py")}
    assert {name.replace("-", "_") for name in cli.CORE} <= files


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
