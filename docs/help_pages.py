"""The reference of the commands in ``commands.md``, written from the commands' own help by ``renew.py``."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Iterator

import rich_click as click

from tacbench_cad import cli
from tacbench_cad.cli.options import ARGUMENTS, PANELS

#: The first line of the examples in a help text.
EXAMPLES = "\b\nExamples:\n"
#: The context of the program itself.
ROOT = click.Context(cli.tacbench)


def walk(name: str, command: click.Command) -> Iterator[tuple[str, click.Command]]:
    """A command and its subcommands, each with the words that call it."""
    yield name, command
    if isinstance(command, click.Group):
        for word in command.list_commands(ROOT):
            yield from walk(f"{name} {word}", command.get_command(ROOT, word))


COMMANDS = dict(walk("tacbench", cli.tacbench))
#: The names in a text, the longer ones first.
NAMES = "|".join(sorted(list(COMMANDS)[1:], key=len, reverse=True))


def prose(text: str, *, cell: bool = False) -> str:
    """A text of the help as Markdown: options and quoted words are code, commands links, nothing else is markup."""
    parts = re.split(r"\"(tacbench\s[^\"]+)\"", text.replace("|", r"\|") if cell else text)
    # Every second part was a command in quotation marks.
    return "".join(
        linked(part) if i % 2 and part in COMMANDS else f"`{part}`" if i % 2 else plain(part)
        for i, part in enumerate(parts)
    )


def plain(text: str) -> str:
    """A text without quoted commands as Markdown."""
    words = []
    for word in re.split(r"(\s+)", text):
        escaped = re.sub(r"([\\`*_\[\]<>$])", r"\\\1", word).replace(r"\\|", r"\|")
        words.append(re.sub(r"^(.*\".*\".*?)([.,:;]?)$", r"`\1`\2", word) if word.count('"') > 1 else escaped)
    text = re.sub(rf"\b({NAMES})\b", lambda match: linked(match[0]), "".join(words))
    return re.sub(r"(?<![\w-])(--?[a-z][a-z-]*)", r"`\1`", text)


def linked(name: str) -> str:
    """A command's name as a link to its section."""
    return f"[`{name}`](#{name.replace(' ', '-')})"


def row(parameter: click.Parameter) -> str:
    """An option's or argument's row: how it is written, its meaning, and its default."""
    option = isinstance(parameter, click.Option)
    written = sorted(parameter.opts, key=len) if option else []
    if not (option and parameter.is_flag):
        written.append(parameter.make_metavar(ROOT))
    shown = parameter.show_default if option else False
    default = shown if isinstance(shown, str) else parameter.default
    meaning = parameter.help
    if parameter.required:
        meaning += " Required."
    elif shown and isinstance(default, str) and "Default: " not in meaning:
        meaning += f" Default: {default}."
    return "| {} | {} |".format(
        " ".join(f"`{word}`" for word in written).replace("|", r"\|"), prose(meaning, cell=True)
    )


def section(name: str, command: click.Command) -> Iterator[str]:
    """A command's section."""
    yield f"{'#' * len(name.split())} {name}\n"
    for paragraph in inspect.cleandoc(command.help).split("\n\n"):
        if paragraph.startswith(EXAMPLES):
            yield f"```sh\n{inspect.cleandoc(paragraph.removeprefix(EXAMPLES))}\n```\n"
        else:
            yield f"{prose(paragraph)}\n"
    if isinstance(command, click.Group):
        yield overview("Command", (f"{name} {word}" for word in command.list_commands(ROOT)))
        return
    usage = [parameter.make_metavar(ROOT) for parameter in command.params if isinstance(parameter, click.Argument)]
    yield f"Usage: `{' '.join((name, '[OPTIONS]', *usage))}`\n"
    panels: dict[str, list[str]] = {}
    for parameter in command.params:
        panels.setdefault(parameter.panel or ARGUMENTS, []).append(row(parameter))
    for panel in sorted(panels, key=PANELS.index):
        yield table(panel, "Meaning", panels[panel])


def overview(title: str, names: Iterable[str]) -> str:
    """A table of commands, each with the first line of its help."""
    rows = [f"| {prose(name)} | {prose(COMMANDS[name].help.partition(chr(10))[0], cell=True)} |" for name in names]
    return table(title, "What it does", rows)


def table(left: str, right: str, rows: list[str]) -> str:
    """A table of two columns in the style of the reference."""
    return "\n".join([f"| {left} | {right} |", "| --- | --- |", *rows]) + "\n"


def reference() -> str:
    """The tables of all commands by group, then a section for each command."""
    words = cli.tacbench.list_commands(ROOT)
    parts = [
        overview(title, (f"tacbench {word}" for word in words if COMMANDS[f"tacbench {word}"].panel == title))
        for title in cli.PANELS
    ]
    parts += [part for words, command in list(COMMANDS.items())[1:] for part in section(words, command)]
    return "\n".join(parts).strip()
