"""The reference of the commands, made from the commands' own help where ``commands.md`` has ``{commands}``."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

import typer
from sphinx.application import Sphinx

from tacbench_cad import cli

PLACE = "```{commands}\n```\n"
#: What begins a program's examples in its help.
EXAMPLES = "Examples:\n"
COMMANDS: dict[str, Any] = typer.main.get_command(cli.app).commands  # type: ignore[attr-defined]
#: Names of all commands, the longer ones first.
NAMES = sorted(
    [*COMMANDS, *(f"{name} {inner}" for name, one in COMMANDS.items() for inner in getattr(one, "commands", {}))],
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


def row(one: Any) -> str:
    """An option's or argument's row: how it is written, what it means, and what holds without it."""
    meaning = one.help or ""
    if one.required:
        meaning += " Required."
    elif "Default: " not in meaning and one.show_default and one.default not in (None, False, ()):
        meaning += f" Default: {one.default}."
    written = [f"`{name}`" for name in sorted((*one.opts, *one.secondary_opts), key=len)]
    if one.param_type_name == "argument":
        written = []
    if one.metavar:
        written.append(f"`{one.metavar}`")
    return "| {} | {} |".format(" ".join(written).replace("|", r"\|"), prose(meaning, cell=True))


def argument(one: Any) -> str:
    """An argument as it stands in a line of use: in brackets if it may be left out, with dots if it may be repeated."""
    return (one.metavar if one.required else f"[{one.metavar}]") + ("..." if one.nargs == -1 else "")


def section(name: str, command: Any, level: int) -> Iterator[str]:
    """A command's section, and below it those of its own commands."""
    yield f"{'#' * level} {name}\n"
    for paragraph in inspect.cleandoc(command.help or "").split("\n\n"):
        if paragraph.startswith(EXAMPLES):
            yield f"```sh\n{examples(paragraph.removeprefix(EXAMPLES))}\n```\n"
        else:
            yield f"{prose(paragraph)}\n"
    inside = getattr(command, "commands", {})
    if inside:
        yield overview(name, inside)
    else:
        usage = [argument(one) for one in command.params if one.param_type_name == "argument"]
        yield f"Usage: `{' '.join((name, '[OPTIONS]', *usage))}`\n"
        shown = [one for one in command.params if not one.hidden]
        for panel, ones in groupby(shown, key=lambda one: one.rich_help_panel or ""):
            rows = [row(one) for one in ones]
            yield table(
                panel or ("Options" if rows[0].startswith("| `-") else "Arguments and options"), "Meaning", rows
            )
    for word, one in inside.items():
        yield from section(f"{name} {word}", one, level + 1)


def overview(name: str, inside: dict[str, Any]) -> str:
    """A table of the commands in a group, each with the first line of its help."""
    rows = []
    for word, one in inside.items():
        rows.append(f"| {prose(f'{name} {word}')} | {prose(one.help.partition(chr(10))[0], cell=True)} |")
    return table("Command", "What it does", rows)


def table(left: str, right: str, rows: list[str]) -> str:
    """A table of two columns in the style of the reference."""
    return "\n".join(["```{rst-class} reference\n```\n", f"| {left} | {right} |", "| --- | --- |", *rows]) + "\n"


def write_commands(app: Sphinx, name: str, source: list[str]) -> None:
    """Put the reference in its place."""
    if PLACE in source[0]:
        sections = (part for word, one in COMMANDS.items() for part in section(f"tacbench {word}", one, 2))
        source[0] = source[0].replace(PLACE, "\n".join([overview("tacbench", COMMANDS), *sections]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect it."""
    app.connect("source-read", write_commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
