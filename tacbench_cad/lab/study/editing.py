"""A new study file, and editing of one: keys get new values, and the rest of the text, also its comments, stays."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tacbench_cad.util import untrusted
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.files import write_text
from tacbench_cad.util.text import toml_item

#: The file that ``tacbench acquire --init`` writes: the usual keys with their meaning and default.
TEMPLATE_FILE = Path(__file__).with_name("template.toml")


def write_template(path: Path) -> None:
    """Write :data:`TEMPLATE_FILE` to a new file.

    Raises:
        InputError: The path already exists or cannot be written.
    """
    if path.exists() or path.is_symlink():
        raise InputError("init", str(path), "already exists; name a new file")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, TEMPLATE_FILE.read_text("utf-8"))


def store_keys(path: Path, table: str, values: Mapping[str, Any]) -> None:
    """Write keys of a table.

    The new text is parsed before it is stored. Only these keys may differ from the old text.

    Args:
        path: The file.
        table: The name of the table: ``stage``, ``protocol.targets``.
        values: The new values: texts, numbers, lists, and tables of them. None turns the key into a comment.

    Raises:
        InputError: The file cannot be edited safely. The message contains the lines to write by hand.
    """
    import tomlkit  # imported here, because most commands edit no file
    from tomlkit.exceptions import TOMLKitError

    target = path.resolve()
    try:
        text = untrusted.read_bytes(target, "study", "toml").decode("utf-8")
        expected = untrusted.parse_toml(text, "study", str(path))
        document = tomlkit.parse(text.replace("\r\n", "\n"))
        for key, value in values.items():
            _store_key(_table(document, table), key, value)
            _table(expected, table)[key] = value
            if value is None:
                del _table(expected, table)[key]
        text = document.as_string().replace("\n", "\r\n" if "\r\n" in text else "\n")
        same = untrusted.parse_toml(text, "study", str(path)) == expected
    except (InputError, ValueError, KeyError, TypeError, TOMLKitError):
        same = False
    if not same:
        lines = (f"{key} = {toml_item(value).as_string()}" for key, value in values.items() if value is not None)
        by_hand = f"write these lines by hand: {'; '.join(lines)}"
        raise InputError(str(path), None, f"cannot be edited safely; {by_hand}")
    write_text(target, text)


def _table(document: Any, name: str) -> Any:
    """Return a table of a document."""
    for part in name.split("."):
        document = document[part]
    return document


def _store_key(section: Any, key: str, value: Any) -> None:
    """Set a key of a table, or turn it into a comment if the value is None."""
    import tomlkit

    if value is not None:
        section[key] = toml_item(value)
    elif key in section:
        place = [each for each, _ in section.value.body].index(key)
        comment = tomlkit.comment(f"{key} = {toml_item(section[key].unwrap()).as_string()}")
        section.remove(key)
        section.value.body[place] = (None, comment)
