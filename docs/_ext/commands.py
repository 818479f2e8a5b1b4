"""The reference of the commands, made from the commands' own help where ``commands.md`` has ``{commands}``."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator

import rich_click as click
from sphinx.application import Sphinx

from tacbench_cad import cli

PLACE = "```{commands}\n```\n"
#: What begins a program's examples in its help.
EXAMPLES = "\b\nExamples:\n"
#: The context of the program itself.
ROOT = click.Context(cli.tacbench)


def inside(command: click.Command) -> dict[str, click.Command]:
    """The commands of a group by their names."""
    names = command.list_commands(ROOT) if isinstance(command, click.Group) else ()
    return {name: command.get_command(ROOT, name) for name in names}


COMMANDS = inside(cli.tacbench)
#: Names of all commands, the longer ones first.
NAMES = sorted(
    [*COMMANDS, *(f"{name} {inner}" for name, command in COMMANDS.items() for inner in inside(command))],
    key=len,
    reverse=True,
)


def prose(text: str, *, cell: bool = False) -> str:
    """A text of the help as Markdown: options and quoted words are code, commands links, nothing else is markup."""
    words = []
    for word in re.split(r"(\s+)", text):
        plain = re.sub(r"([\\`*_\[\]<>$])", r"\\\1", word)
        words.append(re.sub(r"^(.*\".*?)([.,:;]?)$", r"`\1`\2", word) if '"' in word else plain)
    text = "".join(words).replace("|", r"\|") if cell else "".join(words)
    text = re.sub(rf"\btacbench ({'|'.join(NAMES)})\b", _link, text)
    return re.sub(r"(?<![\w-])(--?[a-z][a-z-]*)", r"`\1`", text)


def _link(found: re.Match[str]) -> str:
    return f"[`{found[0]}`](#{found[0].replace(' ', '-')})"


def examples(text: str) -> str:
    """Examples as they are typed, what is said behind one as its comment."""
    lines = inspect.cleandoc(text).splitlines()
    return "\n".join(re.sub(r"^(\S.*?)\s{2,}\(?(.*?)\)?$", r"\1  # \2", line) for line in lines)


def row(parameter: click.Parameter) -> str:
    """An option's or argument's row: how it is written, what it means, and what holds without it."""
    meaning = parameter.help or ""
    shown = getattr(parameter, "show_default", False)
    default = shown if isinstance(shown, str) else parameter.default
    if parameter.required:
        meaning += " Required."
    elif shown and isinstance(default, str) and "Default: " not in meaning:
        meaning += f" Default: {default}."
    option = isinstance(parameter, click.Option)
    written = [f"`{name}`" for name in sorted(parameter.opts, key=len)] if option else []
    if not (option and parameter.is_flag):
        written.append(f"`{parameter.make_metavar(ROOT)}`")
    return "| {} | {} |".format(" ".join(written).replace("|", r"\|"), prose(meaning, cell=True))


def section(name: str, command: click.Command, level: int) -> Iterator[str]:
    """A command's section, and below it those of its own commands."""
    yield f"{'#' * level} {name}\n"
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith(EXAMPLES):
            yield f"```sh\n{examples(paragraph.removeprefix(EXAMPLES))}\n```\n"
        else:
            yield f"{prose(paragraph)}\n"
    if isinstance(command, click.Group):
        yield overview(name, inside(command))
    else:
        usage = [one.make_metavar(ROOT) for one in command.params if isinstance(one, click.Argument)]
        yield f"Usage: `{' '.join((name, '[OPTIONS]', *usage))}`\n"
        panels: dict[str, list[str]] = {}
        for one in command.params:
            panels.setdefault(one.panel or "Arguments and options", []).append(row(one))
        for panel, rows in panels.items():
            yield table(panel, "Meaning", rows)
    for word, inner in inside(command).items():
        yield from section(f"{name} {word}", inner, level + 1)


def overview(name: str, commands: dict[str, click.Command], title: str = "Command") -> str:
    """A table of commands, each with the first line of its help."""
    rows = []
    for word, one in commands.items():
        rows.append(f"| {prose(f'{name} {word}')} | {prose(one.help.partition(chr(10))[0], cell=True)} |")
    return table(title, "What it does", rows)


def table(left: str, right: str, rows: list[str]) -> str:
    """A table of two columns in the style of the reference."""
    return "\n".join(["```{rst-class} reference\n```\n", f"| {left} | {right} |", "| --- | --- |", *rows]) + "\n"


def write_commands(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the reference in its place."""
    if PLACE in source[0]:
        sections = (part for word, one in COMMANDS.items() for part in section(f"tacbench {word}", one, 2))
        overviews = (
            overview("tacbench", {name: COMMANDS[name] for name in names}, title) for title, names in cli.GROUPS.items()
        )
        source[0] = source[0].replace(PLACE, "\n".join([*overviews, *sections]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect it."""
    app.connect("source-read", write_commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
