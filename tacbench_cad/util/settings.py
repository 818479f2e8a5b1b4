"""Reading TOML files strictly: every error names the file, the key, its value and what is allowed."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from tacbench_cad.util.errors import InputError, nearest, one_of

T = TypeVar("T")


@dataclass(frozen=True)
class Required:
    """Stands in a default's place where a key may not be left out."""


#: Stands for a default where there is none: the key has to be there.
REQUIRED = Required()


def read_toml(path: Path, field: str, read: Callable[[Table], T]) -> T:
    """Read a file; the errors of its reader come out with the file's name in front.

    Args:
        path: The TOML file.
        field: What the file is, for the messages: ``texture``.
        read: Makes the result from the whole document.

    Raises:
        InputError: The file cannot be read, or ``read`` refused something in it.
    """
    if path.is_dir():
        raise InputError(field, str(path), "is a folder; name a TOML file")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(field, str(path), f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(field, str(path), "is not UTF-8 text") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(field, str(path), f"is not valid TOML: {error}") from None
    try:
        return read(Table(document))
    except InputError as error:
        raise InputError(f"{path}: {error.field}", error.value, error.allowed) from None


@dataclass(frozen=True)
class Table:
    """One table of a TOML document.

    Args:
        values: Its keys and values.
        where: What stands before a key in a message: ``"[protocol] "``; empty for the whole document.
    """

    values: Mapping[str, Any]
    where: str = ""

    def __contains__(self, key: str) -> bool:
        return key in self.values

    def only(self, *names: str) -> Table:
        """This table, if it has no other keys.

        Raises:
            InputError: A key is unknown; the message names the nearest known one.
        """
        for key in self.values:
            if key not in names:
                raise InputError(f"{self.where}{key}", None, f"unknown key; {nearest(key, names)}")
        return self

    def table(self, key: str, required: bool = True) -> Table:
        """The table under a key.

        Args:
            key: The key.
            required: Whether it must be there; else an empty one stands for it.

        Raises:
            InputError: There is none, or it is no table.
        """
        found = self.values.get(key, None if required else {})
        if not isinstance(found, Mapping):
            raise InputError(f"[{key}]", None, "such a table is needed" if found is None else "must be a table")
        return Table(found, f"[{key}] ")

    def tables(self, key: str) -> list[Table]:
        """The tables of ``[[key]]``, at least one."""
        found = self.values.get(key)
        if not isinstance(found, list) or not found or not all(isinstance(one, Mapping) for one in found):
            raise InputError(f"{self.where}[[{key}]]", None, "at least one such table is needed")
        return [Table(one, f"{self.where}[[{key}]] {i}: ") for i, one in enumerate(found, start=1)]

    def text(self, key: str, default: str | Required | None = REQUIRED, allowed: Iterable[str] = ()) -> Any:
        """A text.

        Args:
            key: The key.
            default: What holds where the key is left out; without one it is needed.
            allowed: The texts that are allowed; none for any.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "a text")
        if value is default:
            return value
        if not isinstance(value, str):
            raise InputError(f"{self.where}{key}", value, "must be a text")
        names = tuple(allowed)
        return one_of(f"{self.where}{key}", value, names) if names else value

    def number(
        self,
        key: str,
        default: float | Required | None = REQUIRED,
        least: float = -math.inf,
        most: float = math.inf,
    ) -> Any:
        """A finite number between two bounds.

        Args:
            key: The key.
            default: What holds where the key is left out; without one it is needed.
            least: The lower bound, itself allowed.
            most: The upper bound, itself allowed.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "a finite number")
        return value if value is default else self._finite(key, value, least, most)

    def whole(self, key: str, default: int | Required | None = REQUIRED, least: int = 0, most: int = 2**31) -> Any:
        """A whole number between two bounds.

        Args:
            key: The key.
            default: What holds where the key is left out; without one it is needed.
            least: The lower bound, itself allowed.
            most: The upper bound, itself allowed.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "a whole number")
        if value is default:
            return value
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            allowed = f"from {least} to {most}" if most < 2**31 else f"of at least {least}"
            raise InputError(f"{self.where}{key}", value, f"must be a whole number {allowed}")
        return value

    def flag(self, key: str, default: bool | Required | None = REQUIRED) -> Any:
        """True or false.

        Args:
            key: The key.
            default: What holds where the key is left out; without one it is needed.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "true or false")
        if value is not default and not isinstance(value, bool):
            raise InputError(f"{self.where}{key}", value, "must be true or false")
        return value

    def numbers(self, key: str, count: int | None, default: tuple[float, ...] | Required | None = REQUIRED) -> Any:
        """A list of finite numbers as a tuple.

        Args:
            key: The key.
            count: How many; None for one or more.
            default: What holds where the key is left out; without one it is needed.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "a list of numbers")
        if value is default:
            return value
        return self._list(key, value, count)

    def rows(self, key: str, count: int | None, width: int, default: Any = REQUIRED) -> Any:
        """A list of lists of finite numbers, as tuples.

        Args:
            key: The key.
            count: How many lists; None for one or more.
            width: Numbers in each.
            default: What holds where the key is left out; without one it is needed.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "a list of lists of numbers")
        if value is default:
            return value
        if not isinstance(value, list) or not value or (count is not None and len(value) != count):
            many = "some" if count is None else f"{count}"
            raise InputError(f"{self.where}{key}", value, f"must be a list of {many} lists of {width} numbers")
        return tuple(self._list(key, row, width) for row in value)

    def texts(self, key: str, default: tuple[str, ...] | Required | None = REQUIRED) -> Any:
        """A list of texts as a tuple; whole numbers count as texts.

        Args:
            key: The key.
            default: What holds where the key is left out; without one it is needed.

        Raises:
            InputError: The value is missing or not of this kind.
        """
        value = self._get(key, default, "a list of texts")
        if value is default:
            return value
        if not isinstance(value, list) or not value or not all(type(one) in (str, int) for one in value):
            raise InputError(f"{self.where}{key}", value, "must be a list of texts")
        return tuple(str(one) for one in value)

    def named(self, where: str) -> Table:
        """The same table with another name in its messages."""
        return replace(self, where=where)

    def _get(self, key: str, default: Any, kind: str) -> Any:
        if key not in self.values and isinstance(default, Required):
            raise InputError(f"{self.where}{key}", None, f"is missing; {kind}")
        return self.values.get(key, default)

    def _list(self, key: str, value: object, count: int | None) -> tuple[float, ...]:
        if not isinstance(value, list) or (len(value) != count if count is not None else not value):
            many = "" if count is None else f"{count} "
            raise InputError(f"{self.where}{key}", value, f"must be a list of {many}numbers")
        return tuple(self._finite(key, one, -math.inf, math.inf) for one in value)

    def _finite(self, key: str, value: object, least: float, most: float) -> float:
        name = f"{self.where}{key}"
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise InputError(name, value, "must be a finite number")
        if not least <= value <= most:
            if math.isinf(most):
                raise InputError(name, value, f"must be at least {least:g}")
            raise InputError(name, value, f"must be from {least:g} to {most:g}")
        return float(value)
