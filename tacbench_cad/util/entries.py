"""What extensions and other packages add to the program, by Python entry points.

A package names its own object in its ``pyproject.toml``, in one of the groups ``tacbench.commands``,
``tacbench.stages`` and so on. Our own extensions use the same way, so a folder of an extension may be deleted.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from tacbench_cad.util.errors import MissingToolError, one_of

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


@cache
def groups() -> dict[str, dict[str, EntryPoint]]:
    """Return the entry points of each group of this program by their names, ours first.

    No other package can replace ours. The metadata of all installed packages is read once, because that takes some ms.
    """
    from importlib.metadata import distributions

    every = [entry for package in distributions() for entry in package.entry_points]
    found: dict[str, dict[str, EntryPoint]] = {}
    for entry in sorted(every, key=lambda entry: (not is_own(entry), entry.name)):
        if entry.group.startswith("tacbench."):
            found.setdefault(entry.group, {}).setdefault(entry.name, entry)
    return found


def entries(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by their names."""
    return groups().get(group, {})


def is_own(entry: EntryPoint) -> bool:
    """Return whether an entry point names an object of this program."""
    return entry.module.startswith("tacbench_cad.")


def load(entry: EntryPoint) -> Any:
    """Return the object that an entry point names.

    Raises:
        MissingToolError: Its module does not exist, as after its extension was deleted.
    """
    try:
        return entry.load()
    except ModuleNotFoundError as error:
        if error.name is None or not f"{entry.module}.".startswith(f"{error.name}."):
            raise
        raise MissingToolError(f"{entry.name} needs {error.name}, which is not installed") from None


def load_named(group: str, field: str, name: str) -> Any:
    """Return the object of a group that a user's word names.

    Args:
        group: The group of entry points.
        field: The field or option with the word, for the error.
        name: The word.

    Raises:
        InputError: The group has no such name.
        MissingToolError: The module of the entry point does not exist.
    """
    found = entries(group)
    return load(found[one_of(field, name, found)])
