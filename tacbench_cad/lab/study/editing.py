"""Editing of a study's TOML file: keys get new values, and the rest of the text, also its comments, stays as it is."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tacbench_cad.util import door
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_text
from tacbench_cad.util.text import toml_of

#: The value of a key: a list, which may span several lines and contain comments; a text; or another word.
_VALUE = r'\[(?:[^\]#]|#[^\n]*\n)*\]|"(?:[^"\\\n]|\\.)*"|\{[^}\n]*\}|[^\s#\[{"]+'


def store_keys(path: Path, table: str, values: Mapping[str, Any]) -> None:
    """Write keys of a table.

    The new text is parsed before it is stored. Only these keys may differ from the old text.

    Args:
        path: The file.
        table: The name of the table.
        values: The new values: texts, numbers, lists, and tables of them. None turns the key into a comment.

    Raises:
        InputError: The file cannot be edited safely. The message contains the lines to write by hand.
    """
    lines = {key: toml_of(value) for key, value in values.items() if value is not None}
    by_hand = "write these lines by hand: " + "; ".join(f"{key} = {value}" for key, value in lines.items())
    target = path.resolve()
    try:
        text = door.read_bytes(target, "study", "toml").decode("utf-8")
        expected = door.parse_toml(text, "study", str(path))
        expected[table] = {key: value for key, value in (expected[table] | values).items() if value is not None}
        for key in values:
            text = _with_key(text, table, key, lines.get(key))
        same = door.parse_toml(text, "study", str(path)) == expected
    except (InputError, ValueError, KeyError, TypeError):
        same = False
    if not same:
        raise InputError(str(path), None, f"cannot be edited safely; {by_hand}")
    write_text(target, text)


def _with_key(text: str, table: str, key: str, value: str | None) -> str:
    """Return the text with a new value for a key of a table, or without the key. Comments are kept.

    Raises:
        ValueError: The text has no line with the table's header.
    """
    header = re.search(rf"^[ \t]*\[[ \t]*{table}[ \t]*\][ \t]*(?:#[^\r\n]*)?\r?$", text, re.MULTILINE)
    if header is None:
        raise ValueError(table)
    following = re.compile(r"^[ \t]*\[", re.MULTILINE).search(text, header.end())
    end = following.start() if following else len(text)
    match = re.compile(rf"^([ \t]*{key}[ \t]*=[ \t]*)(?:{_VALUE})", re.MULTILINE).search(text, header.end(), end)
    if value is None:
        return text if match is None else f"{text[: match.start()]}# {text[match.start() :]}"
    if match is not None:
        return text[: match.start()] + match[1] + value + text[match.end() :]
    line_end = "\r\n" if header[0].endswith("\r") else "\n"
    at = header.end() if not header[0].endswith("\r") else header.end() - 1
    return text[:at] + f"{line_end}{key} = {value}" + text[at:]
